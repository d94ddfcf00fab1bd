"""What a step of an FMU in its own process costs: ``python benchmarks/isolated.py [--fmus 4]``.

The planar arm, whose step takes a fraction of a microsecond, in this process and isolated: alone,
and several whose steps do not need each other. The least and the median time of all turns; with
``--busy``, as many processes compute meanwhile as there are processors.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import time
from statistics import median

from cosim.engine.engine import Engine
from cosim.fmi import FmuComponent, FmuOptions
from cosim.schedule.parts import Slot, Step
from cosim.schedule.plan import Plan, compile_plan
from fmus.models import planar2r


def plan_of(count: int, *, isolate: bool) -> Plan:
    """Arms that nothing connects: their steps follow each other in a tick."""
    steps, at = [], 0
    for i in range(count):
        name = f"arm{i}"
        arm = FmuComponent(planar2r.fmu("2.0"), name, None, FmuOptions(isolate=isolate))
        sides: list[list[Slot]] = [[], []]
        for side, ports in zip(sides, (arm.inputs, arm.outputs), strict=True):
            for p in ports:
                side.append(Slot(f"{name}.{p.name}", name, p.name, at, p.shape, p.unit))
                at += p.size
        inputs, outputs = map(tuple, sides)
        steps.append(Step(name, arm, "continuous", 1, {}, inputs, outputs, {}))
    return compile_plan(1e-3, 10**9, steps, [], [])


def cost(count: int, ticks: int, turns: int, *, isolate: bool) -> tuple[float, float, float]:
    """Time of the start (s), least and median time of a tick (s)."""
    begin = time.perf_counter()
    with Engine(plan_of(count, isolate=isolate)) as engine:
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
    for isolate in (False, True):
        for count in (1, given.fmus):
            started, least, middle = cost(count, given.ticks, given.turns, isolate=isolate)
            where = "isolated       " if isolate else "in this process"
            print(
                f"{count} {where}: start {started:.3f} s, a tick {least * 1e6:.2f} µs, "
                f"median {middle * 1e6:.2f} µs"
            )
    for other in others:
        other.terminate()


if __name__ == "__main__":
    main()
