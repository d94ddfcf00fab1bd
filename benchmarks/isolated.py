"""The cost of a step of an FMU that runs apart: ``python benchmarks/isolated.py [--fmus 4]``.

The planar arm, whose step takes a fraction of a microsecond: in this process, in WebAssembly, and
in a process of its own; alone, and several whose steps do not need each other. The least and the
median time of all turns; with ``--busy``, as many processes compute meanwhile as there are
processors.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import shutil
import tempfile
import time
from pathlib import Path
from statistics import median

from cosim.engine.engine import Engine
from cosim.fmi import FmuComponent, FmuOptions
from cosim.schedule.parts import Slot, Step
from cosim.schedule.plan import Plan, compile_plan
from fmus.build.wasm_fmu import add_wasm
from fmus.models import planar2r

WAYS = {
    "in this process": FmuOptions(),
    "WebAssembly": FmuOptions(wasm=True),
    "a process of its own": FmuOptions(isolate=True),
}


def plan_of(path: Path, count: int, options: FmuOptions) -> Plan:
    """Arms that nothing connects: their steps follow each other in a tick."""
    steps, at = [], 0
    for i in range(count):
        name = f"arm{i}"
        arm = FmuComponent(path, name, None, options)
        sides: list[list[Slot]] = [[], []]
        for side, ports in zip(sides, (arm.inputs, arm.outputs), strict=True):
            for p in ports:
                side.append(Slot(f"{name}.{p.name}", name, p.name, at, p.shape, p.unit))
                at += p.size
        inputs, outputs = map(tuple, sides)
        steps.append(Step(name, arm, "continuous", 1, {}, inputs, outputs, {}))
    return compile_plan(1e-3, 10**9, steps, [], [])


def cost(plan: Plan, ticks: int, turns: int) -> tuple[float, float, float]:
    """Time of the start (s), least and median time of a tick (s)."""
    begin = time.perf_counter()
    with Engine(plan) as engine:
        engine.initialize()
        started, times = time.perf_counter() - begin, []
        for _ in range(turns):
            begin = time.perf_counter()
            engine.run(ticks)
            times.append((time.perf_counter() - begin) / ticks)
    return started, min(times), median(times)


def _compute() -> None:
    while True:
        sum(range(10_000))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fmus", type=int, default=4)
    parser.add_argument("--ticks", type=int, default=5000)
    parser.add_argument("--turns", type=int, default=20)
    parser.add_argument("--busy", action="store_true")
    given = parser.parse_args()
    processors = os.cpu_count() or 1
    others = [
        multiprocessing.Process(target=_compute, daemon=True)
        for _ in range(processors if given.busy else 0)
    ]
    for other in others:
        other.start()
    print(f"{processors} processors, load {os.getloadavg()[0]:.1f}")
    print("| FMUs | where | start, s | a tick, least, µs | median, µs |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        path = add_wasm(Path(shutil.copy(planar2r.fmu("3.0"), folder)))
        for where, options in WAYS.items():
            for count in (1, given.fmus):
                plan = plan_of(path, count, options)
                started, least, middle = cost(plan, given.ticks, given.turns)
                print(
                    f"| {count} | {where} | {started:.3f} | {least * 1e6:.2f} | "
                    f"{middle * 1e6:.2f} |"
                )
    for other in others:
        other.terminate()


if __name__ == "__main__":
    main()
