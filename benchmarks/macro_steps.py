"""Work and error of the master algorithms on two masses: ``python benchmarks/macro_steps.py``.

Two FMUs with force-displacement coupling (``benchmarks/models/sprung_mass.py``), soft and stiff.
The error is the largest of both positions over the run, next to the exact motion; the work is the
number of steps of the FMUs, repeated and short ones included, and the least processor time.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.tables import grid
from cosim.engine.engine import Engine
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build

#: Stiffness (N/m) and damping (N.s/m) of the coupling.
CASES = {"soft": (4.0, 0.2), "stiff": (1e4, 20.0)}
#: Positions (m) and velocities (m/s) at the start, and the end of the run (s).
START, STOP = (1.0, 0.0, 0.0, 0.5), 10.0
Row = tuple[str, str, float, int, int, float]


def document(k_c: float, d_c: float, step: float, run: Mapping[str, Any]) -> dict[str, Any]:
    """The scenario of both masses."""
    s1, v1, s2, v2 = START
    mass = {"model": "benchmarks.models.sprung_mass"}
    return {
        "run": {"step": step, "stop": STOP, **run},
        "components": {
            "first": {**mass, "start": {"s": s1, "v": v1}, "inputs": {"force": "second.reaction"}},
            "second": {**mass, "start": {"s": s2, "v": v2},
                       "parameters": {"k_c": k_c, "d_c": d_c},
                       "inputs": {"s_in": "first.s", "v_in": "first.v"}},
        },
    }  # fmt: skip


def exact(k_c: float, d_c: float, h: float) -> NDArray[np.float64]:
    """Both positions at the multiples of h (s) up to the end, (n, 2), m."""
    k, d = 1.0 + k_c, 0.1 + d_c
    a = np.array([[0, 1, 0, 0], [-k, -d, k_c, d_c], [0, 0, 0, 1], [k_c, d_c, -k, -d]])
    values, vectors = np.linalg.eig(a)
    weights = np.linalg.solve(vectors, np.array(START, complex))
    t = h * np.arange(round(STOP / h) + 1)
    found = (np.exp(np.outer(t, values)) * weights) @ vectors.T
    return np.ascontiguousarray(found.real[:, [0, 2]])


def measure(
    case: str, name: str, setting: str, step: float, run: Mapping[str, Any], turns: int
) -> Row:
    """One row: algorithm, setting, error (m), steps of the FMUs, those repeated, seconds."""
    k_c, d_c = CASES[case]
    least = float("inf")
    for _ in range(turns):
        plan = assemble(build(document(k_c, d_c, step, run), Path("two.toml").absolute()))
        rows = np.empty((plan.ticks + 1, plan.n_signals))
        with Engine(plan) as engine:
            engine.initialize()
            start = time.process_time()
            engine.run(plan.ticks, rows)
            least = min(least, time.process_time() - start)
            rows[plan.ticks] = engine.signals
            done = engine.macro_steps()
    slots = plan.slots()
    found = rows[:, [slots["first.s"].start, slots["second.s"].start]]
    with np.errstate(all="ignore"):
        error = float(np.abs(found - exact(k_c, d_c, step)).max())
    steps, repeated = 2 * plan.ticks, 0
    if done:
        repeated = 2 * done[0]["rejected"]
        steps = (
            3 * 2 * (done[0]["accepted"] + done[0]["rejected"])
        )  # three sweeps with feed-through
    return name, setting, error, steps, repeated, least


def rows(case: str, turns: int, quick: bool) -> Iterator[Row]:
    """Fixed steps by three algorithms, then tolerances."""
    sizes = (1e-2, 1e-3) if quick else (1e-2, 1e-3, 1e-4)
    for algorithm in ("jacobi", "gauss-seidel"):
        for h in sizes:
            try:
                yield measure(case, algorithm, f"{h:g} s", h, {"algorithm": algorithm}, turns)
            except Exception as error:  # it diverges
                yield algorithm, f"{h:g} s: {type(error).__name__}", float("inf"), 0, 0, 0.0
    for tolerance in (1e-2, 1e-4) if quick else (1e-2, 1e-3, 1e-4, 1e-5):
        run = {"algorithm": "adaptive", "adaptive": {"tolerance": tolerance}}
        yield measure(case, "adaptive", f"tolerance {tolerance:g}", 0.1, run, turns)


def table(found: Sequence[Row]) -> str:
    """The rows as Markdown."""
    return grid(
        ["algorithm", "setting", "largest error, m", "steps of FMUs", "time, ms"],
        [
            [name, setting, f"{error:.1e}", f"{steps}", f"{1e3 * seconds:.2f}"]
            for name, setting, error, steps, _, seconds in found
        ],
    )


def main() -> None:
    """Print a table for each case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--quick", action="store_true", help="only test that everything runs")
    asked = parser.parse_args()
    for case, (k_c, d_c) in CASES.items():
        print(f"\n{case}: {k_c:g} N/m, {d_c:g} N.s/m, {STOP:g} s\n")
        print(table(list(rows(case, 1 if asked.quick else asked.turns, asked.quick))))


if __name__ == "__main__":
    main()
