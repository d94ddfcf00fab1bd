"""Rings of FMUs for model exchange: the engine, a loop over FMPy, and the same by co-simulation.

``python -m benchmarks.exchange_ring``: van der Pol oscillators in a ring, each driven by the one
before, exchanged every 1/128 s. The engine integrates them with Euler's method, Heun's, RK4 and
CVODE; FMPy's user writes the loop, with Euler's method; for co-simulation the FMU itself makes
Euler's step. The table has microseconds a step and FMU, best of the rounds, and how far the last
output is from that of co-simulation, which makes the same steps as Euler's method here.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import fmpy

from benchmarks.models import vdp_exchange
from cosim.base.clock import stopwatch
from cosim.engine.engine import Engine
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build

H = 1.0 / 128.0
#: (title, keys of every component) of what the engine runs.
OURS: dict[str, Mapping[str, Any]] = {
    **{f"engine, {s}": {"solver": s} for s in ("euler", "heun", "rk4")},
    "engine, cvode": {"solver": "cvode", "tolerance": 1e-6},
    "engine, co-simulation": {},
}


def start(i: int) -> float:
    """Where oscillator `i` begins (no unit)."""
    return 2.0 - 0.1 * i


def ours(n: int, ticks: int, keys: Mapping[str, Any]) -> tuple[float, float]:
    """Seconds of the loop, and the last output of the last FMU."""
    model = str(vdp_exchange.fmu()) if keys else "benchmarks.models.vdp"
    components = {
        f"c{i}": {"model": model, **keys, "start": {"x": start(i)},
                  "inputs": {"u": f"c{(i - 1) % n}.x"}}
        for i in range(n)
    }  # fmt: skip
    run = {"step": H, "stop": ticks * H, "algorithm": "jacobi"}
    plan = assemble(build({"run": run, "components": components}, Path("ring.toml").absolute()))
    with Engine(plan) as engine:
        engine.initialize()
        watch = stopwatch()
        engine.run(plan.ticks)
        return watch(), float(engine.signals[plan.slots()[f"c{n - 1}.x"].start])


def theirs(n: int, ticks: int) -> tuple[float, float]:
    """The same by a loop over FMPy's instances, with Euler's method."""
    from fmpy.fmi2 import FMU2Model

    with tempfile.TemporaryDirectory() as folder:
        unpacked = fmpy.extract(str(vdp_exchange.fmu()), folder)
        same = {"guid": "vdp", "unzipDirectory": unpacked, "modelIdentifier": "vdp"}
        fmus = [FMU2Model(**same, instanceName=f"c{i}") for i in range(n)]
        for i, fmu in enumerate(fmus):
            fmu.instantiate()
            fmu.setReal([1], [start(i)])
            fmu.setupExperiment(startTime=0.0)
            fmu.enterInitializationMode()
            fmu.exitInitializationMode()
            fmu.newDiscreteStates()
            fmu.enterContinuousTimeMode()
        found = _loop(fmus, ticks)
        for fmu in fmus:
            fmu.terminate()
            fmu.freeInstance()
    return found


def _loop(fmus: list[Any], ticks: int) -> tuple[float, float]:
    import numpy as np

    x, dx = np.zeros((len(fmus), 2)), np.zeros((len(fmus), 2))
    pointers = [
        (fmu, x[i].ctypes.data_as(fmpy.fmi2.POINTER(fmpy.fmi2.c_double)),
         dx[i].ctypes.data_as(fmpy.fmi2.POINTER(fmpy.fmi2.c_double)))
        for i, fmu in enumerate(fmus)
    ]  # fmt: skip
    for fmu, at, _ in pointers:
        fmu.getContinuousStates(at, 2)
    watch = stopwatch()
    for k in range(ticks):
        y = [fmu.getReal([1])[0] for fmu in fmus]
        for i, (fmu, at, rate) in enumerate(pointers):
            fmu.setTime(k * H)
            fmu.setReal([0], [y[i - 1]])
            fmu.setContinuousStates(at, 2)
            fmu.getDerivatives(rate, 2)
        x += H * dx
        for fmu, at, _ in pointers:
            fmu.setContinuousStates(at, 2)
    return watch(), float(x[-1, 0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fmus", type=int, nargs="+", default=[2, 12])
    parser.add_argument("--ticks", type=int, default=20_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="only whether everything runs")
    asked = parser.parse_args()
    if asked.quick:
        asked.ticks, asked.rounds = 200, 1
    print("| | " + " | ".join(f"{n} FMUs, µs | difference" for n in asked.fmus) + " |")
    print("|---|" + "---:|---:|" * len(asked.fmus))
    reference = {n: ours(n, asked.ticks, {})[1] for n in asked.fmus}
    entrants: dict[str, Callable[[int, int], tuple[float, float]]] = {
        name: partial(_ours, keys) for name, keys in OURS.items()
    }
    entrants["FMPy, a loop with Euler's method"] = theirs
    for name, run in entrants.items():
        cells = []
        for n in asked.fmus:
            seconds, value = min(run(n, asked.ticks) for _ in range(asked.rounds))
            cells += [f"{1e6 * seconds / asked.ticks / n:.3f}", f"{abs(value - reference[n]):.1e}"]
        print(f"| {name} | {' | '.join(cells)} |")


def _ours(keys: Mapping[str, Any], n: int, ticks: int) -> tuple[float, float]:
    return ours(n, ticks, keys)


if __name__ == "__main__":
    main()
