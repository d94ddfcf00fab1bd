"""Growth with the number of robots: 6 to 10 000 in a small world, start, ticks and memory.

    python benchmarks/many.py [--robots 6,100,1000,10000] [--threads 1,2] [--rounds N] [--json FILE]

The network of configs/many.toml: arms at 1 kHz, controllers at 200 Hz, four links a robot whose
delays are drawn anew every 30 ms. Each row is a process of its own. "Tick" is the best of the
rounds of 1000 ticks (fewer for many robots), without recording, ticks run as one as if every 50th
were recorded, and with tables that are there.
"Run" is of a whole run as `cosim run` makes it, with its files, its links' tables and the records
of the configuration: simulated time over the time from the first tick to the last. "Bytes" is of
the signals at the end: they are the same for any number of threads. "Check" is the check before a
run, left out beyond 2000 robots.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import resource
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

from benchmarks import tables

ROOT = Path(__file__).resolve().parents[1]
CHECKED = 2000
#: Simulated time of a whole run, s: of up to 1000 robots, and of more.
WHOLE = 60, 20
HEADER = ("robots", "threads", "load and plan, s", "check, s", "start, s",
          "tick, us a robot", "x real time", "run, x real time", "memory, MB", "bytes")  # fmt: skip


def measure(robots: int, threads: int, rounds: int) -> dict[str, Any]:
    """One row, in this process."""
    from cosim.checks.preflight import check
    from cosim.engine.engine import Engine
    from cosim.engine.simulate import Execution, simulate
    from cosim.loading.files import load
    from cosim.scenario.assemble import assemble

    laps = [perf_counter()]

    def lap() -> float:
        laps.append(perf_counter())
        return laps[-1] - laps[-2]

    scenario = load(ROOT / "configs" / "many.toml", (f"graphs.net.n={robots}",))
    plan = assemble(scenario)
    row: dict[str, Any] = {"robots": robots, "threads": threads, "plan": lap()}
    if robots <= CHECKED:
        check(scenario, plan, notes=False)
        row["check"] = lap()
    ticks = max(50, min(1000, 1_000_000 // robots))
    with Engine(plan, threads=threads, every=scenario.run.record.every) as engine:
        engine.initialize()
        engine.run(1)
        row["start"] = lap()
        best = []
        for _ in range(rounds):
            engine.run(ticks)
            best.append(lap() / ticks)
        row["bytes"] = hashlib.sha256(engine.signals.tobytes()).hexdigest()[:8]
    row["tick"] = min(best)
    row["memory"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    whole = load(ROOT / "configs" / "many.toml",
                 (f"graphs.net.n={robots}", f"run.stop={WHOLE[robots > 1000]}"))  # fmt: skip
    with TemporaryDirectory() as folder:
        outcome = simulate(whole, Path(folder) / "run", execution=Execution(threads))
    row["run"] = outcome.seconds / outcome.wall
    return row


def apart(robots: int, threads: int, rounds: int) -> dict[str, Any]:
    """:func:`measure` in a process of its own."""
    words = [sys.executable, __file__, "--one", f"{robots},{threads},{rounds}"]
    done = subprocess.run(words, check=True, capture_output=True, text=True)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def line(row: dict[str, Any]) -> list[str]:
    """A row of the table."""
    n = row["robots"]
    return [
        str(n), str(row["threads"]), f"{row['plan']:.2f}",
        f"{row['check']:.2f}" if "check" in row else "–", f"{row['start']:.2f}",
        f"{1e6 * row['tick'] / n:.3f}", f"{1e-3 / row['tick']:.3g}", f"{row['run']:.3g}",
        f"{row['memory']:.0f}", row["bytes"],
    ]  # fmt: skip


def main() -> None:
    """Measure, print the table, write the numbers."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--robots", default="6,100,1000,10000")
    parser.add_argument("--threads", default="1,2")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers here")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        robots, threads, rounds = map(int, options.one.split(","))
        print(json.dumps(measure(robots, threads, rounds)))
        return
    rows = [
        apart(int(robots), int(threads), options.rounds)
        for robots in options.robots.split(",")
        for threads in options.threads.split(",")
    ]
    print(tables.grid(HEADER, [line(row) for row in rows]))
    if options.json:
        facts = {"machine": tables.machine(), "rows": rows}
        options.json.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
