"""Growth of the cost: 1 to 1000 FMUs in a ring, 1e3 to 1e7 ticks; linear time, constant memory.

    python benchmarks/scaling.py [--ticks 6] [--links]

`--ticks`: the greatest power of ten of ticks (7 takes a few seconds). Every row is measured in a
separate process, so that its memory is independent of the others.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.append(str(ROOT))

COMPONENTS = (1, 10, 100, 1000)
#: Ticks recorded at once, as a run does.
CHUNK = 1024


def document(components: int, *, links: bool) -> dict[str, Any]:
    """A ring of oscillators, wired or with a link on every connection."""
    from benchmarks.cases import delayed, vdp_ring

    ring = vdp_ring(components)
    for i, spec in enumerate(ring["components"].values()):
        spec["start"] = {"x": 2.0 - 0.1 * (i % 20)}  # far out, an explicit Euler step diverges
    return delayed(ring, "u", "x", 0) if links and components > 1 else ring


def measure(components: int, ticks: int, *, links: bool) -> dict[str, float]:
    """Seconds to a plan, to the first step and of the run; peak memory in MB.

    Recording goes into one buffer that is written over, as it does between engine and writer.
    """
    import numpy as np

    from benchmarks.cases import Case
    from benchmarks.stages import peak
    from cosim.engine.engine import Engine

    case = Case("ring", "", lambda: document(components, links=links), components, ticks)
    begin = time.perf_counter()
    plan = case.plan("fmi2", ticks)
    planned = time.perf_counter()
    with Engine(plan) as engine:
        engine.initialize()
        ready = time.perf_counter()
        buffer = np.empty((CHUNK, plan.n_signals))
        while engine.tick < ticks:
            engine.run(min(CHUNK, ticks - engine.tick), buffer)
        done = time.perf_counter()
    return {
        "plan": planned - begin,
        "start": ready - planned,
        "run": done - ready,
        "peak": peak(),
    }


def apart(components: int, ticks: int, *, links: bool) -> dict[str, float]:
    """:func:`measure` in a process of its own."""
    command = [sys.executable, __file__, "--one", str(components), str(ticks)]
    answer = subprocess.run(
        [*command, *(["--links"] if links else [])], check=True, capture_output=True, text=True
    )
    found: dict[str, float] = json.loads(answer.stdout)
    return found


def rows(most: int, *, links: bool) -> Iterator[tuple[int, int, dict[str, float]]]:
    """(components, ticks, what was measured), growing one at a time."""
    cases = [(n, 1000) for n in COMPONENTS]
    cases += [(2, 10**k) for k in range(3, most + 1)]
    for n, ticks in cases:
        yield n, ticks, apart(n, ticks, links=links)


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ticks", type=int, default=6)
    parser.add_argument("--links", action="store_true")
    parser.add_argument("--one", type=int, nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measure(*options.one, links=options.links)))
        return
    print("  FMUs      ticks   plan ms  start ms   ns/FMU/tick   peak MB")
    for n, ticks, found in rows(options.ticks, links=options.links):
        print(
            f"{n:6} {ticks:10} {1e3 * found['plan']:9.1f} {1e3 * found['start']:9.1f} "
            f"{1e9 * found['run'] / ticks / n:13.1f} {found['peak']:9.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
