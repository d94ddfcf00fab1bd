"""How late a loop wakes: ours in C and in Python, and cyclictest, in turns on the same machine.

    python benchmarks/lateness.py [--quick] [--json FILE] [--blocks N] [--seconds S]
                                  [--priority P] [--figure FILE.png]

Each block is a process of its own; all variants run a block, then all the next. Needs the rights
that docs/rehearsal.md describes, and Debian's rt-tests for cyclictest; what is not granted or not
there is said. Nothing else should run meanwhile.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

import numpy as np
from numpy.typing import NDArray

from benchmarks import tables
from bridge.native import pace
from bridge.realtime.lateness import Spread, draw, lateness
from bridge.realtime.requests import Realtime, enter
from cosim.base.clock import monotonic_ns, sleep

RATES = (200, 1000)  # Hz
SHOWN = ("p50", "p99", "p999", "maximum")
Woke = NDArray[np.int64]

# ---- one block -----------------------------------------------------------------------------------


def loop_c(start: int, period: int, n: int) -> Woke:
    return pace.run(start, period, n)


def loop_python(start: int, period: int, n: int) -> Woke:
    woke = np.zeros(n, np.int64)
    for k in range(n):
        sleep((start + k * period - monotonic_ns()) * 1e-9)
        woke[k] = monotonic_ns()
    return woke


@contextmanager
def busy() -> Iterator[None]:
    """Another thread of this process computes in Python all the time."""
    over = threading.Event()

    def compute() -> None:
        while not over.is_set():
            sum(range(1000))

    thread = threading.Thread(target=compute)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


#: Name -> the loop, whether it asks for real time, whether a busy thread runs beside it.
LOOPS: dict[str, tuple[Callable[[int, int, int], Woke], bool, bool]] = {
    "C, SCHED_FIFO": (loop_c, True, False),
    "C, SCHED_FIFO, busy Python thread": (loop_c, True, True),
    "Python, SCHED_FIFO": (loop_python, True, False),
    "Python, as it is": (loop_python, False, False),
}
PEER = "cyclictest"


def block(name: str, hz: int, seconds: float, priority: int) -> dict[str, Any]:
    """One block in this process: the report and what was granted."""
    loop, real_time, crowded = LOOPS[name]
    period, n = 10**9 // hz, max(1, round(hz * seconds))
    nothing = Realtime(priority=0, lock_memory=False, timer_slack_ns=0, cpu_latency_us=None,
                       freeze=False, switch_interval_s=0)  # fmt: skip
    with enter(Realtime(priority=priority) if real_time else nothing) as granted:
        if crowded:
            with busy():
                start, woke = timed(loop, period, n)
        else:
            start, woke = timed(loop, period, n)
    found = lateness(start + period * np.arange(n), woke, period)
    return {**found.facts(), "granted": granted.facts()}


def timed(loop: Callable[[int, int, int], Woke], period: int, n: int) -> tuple[int, Woke]:
    start = pace.now() + 20_000_000
    return start, loop(start, period, n)


def apart(name: str, hz: int, seconds: float, priority: int) -> dict[str, Any]:
    """The same in a new process."""
    command = [sys.executable, __file__, "--block", name, "--hz", str(hz)]
    command += ["--seconds", str(seconds), "--priority", str(priority)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def cyclictest(hz: int, seconds: float, priority: int) -> dict[str, Any]:
    """One block of cyclictest with memory locked and the same priority; whole us, rounded down."""
    program = shutil.which("cyclictest")
    if program is None:
        return {"absent": "cyclictest is not installed (Debian: rt-tests)"}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "found.json")
        command = [program, "-q", "-m", "-t1", f"-p{priority}", f"-i{10**6 // hz}", "-h100000"]
        command += [f"-l{max(1, round(hz * seconds))}", f"--json={file}"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode or not file.is_file():
            return {"absent": f"cyclictest: {(done.stderr or done.stdout).strip()[-200:]}"}
        thread = json.loads(file.read_text())["thread"]["0"]
    late = [1000 * int(us) for us, n in thread["histogram"].items() for _ in range(n)]
    late += [1000 * thread["max"]] * (thread["cycles"] - len(late))  # beyond the histogram
    spread = Spread.of(late)
    missed = sum(ns >= 10**9 // hz for ns in late)
    bins = [[ns, late.count(ns)] for ns in sorted(set(late))]
    values = {key: getattr(spread, key) for key in ("count", "minimum", "mean", *SHOWN)}
    return {"period_ns": 10**9 // hz, "missed": missed, "late": values, "bins": bins}


# ---- all of them ---------------------------------------------------------------------------------


def measure(blocks: int, seconds: float, priority: int) -> list[dict[str, Any]]:
    """Every variant at every rate, in turns."""
    cases = [(hz, name) for hz in RATES for name in (*LOOPS, PEER)]
    found: dict[tuple[int, str], list[dict[str, Any]]] = {case: [] for case in cases}
    for _ in range(blocks):
        for hz, name in cases:
            one = (cyclictest(hz, seconds, priority) if name == PEER
                   else apart(name, hz, seconds, priority))  # fmt: skip
            found[hz, name].append(one)
    return [{"hz": hz, "runner": name, **summary(found[hz, name])} for hz, name in cases]


def summary(blocks: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians over the blocks, us; and the blocks."""
    absent = next((b["absent"] for b in blocks if "absent" in b), None)
    if absent is not None:
        return {"absent": absent}
    medians = {key: median(b["late"][key] for b in blocks) * 1e-3 for key in SHOWN}
    return {
        "us": medians,
        "worst_us": max(b["late"]["maximum"] for b in blocks) * 1e-3,
        "missed": sum(b["missed"] for b in blocks),
        "count": sum(b["late"]["count"] for b in blocks),
        "blocks": blocks,
    }


def relate(rows: list[dict[str, Any]]) -> None:
    """Adds to each what it is of cyclictest's at the same rate."""
    peers = {row["hz"]: row.get("us") for row in rows if row["runner"] == PEER}
    for row in rows:
        peer = peers[row["hz"]]
        if "us" in row and peer:
            row["ratio"] = {key: row["us"][key] / peer[key] for key in SHOWN if peer[key]}


def report(rows: list[dict[str, Any]]) -> str:
    """One table."""
    lines = []
    for row in rows:
        cells = [f"{row['hz']} Hz", row["runner"]]
        if "absent" in row:
            lines.append([*cells, row["absent"], "", "", "", "", "", ""])
            continue
        ratio = row.get("ratio", {}).get("p99")
        lines.append([
            *cells, *(f"{row['us'][key]:.1f}" for key in SHOWN), f"{row['worst_us']:.0f}",
            f"{row['missed']} of {row['count']}", "" if ratio is None else f"{ratio:.2f}",
        ])  # fmt: skip
    header = ["rate", "lateness, us: median of blocks", "p50", "p99", "p99.9", "max", "worst",
              "missed", "p99 to cyclictest's"]  # fmt: skip
    return tables.grid(header, lines)


def refusals(rows: list[dict[str, Any]]) -> list[str]:
    """What our loops asked for and did not get."""
    items = [i for row in rows for b in row.get("blocks", []) if "granted" in b
             for i in b["granted"]["items"]]  # fmt: skip
    return sorted({f"not granted: {i['name']}: {i['said']}" for i in items if not i["granted"]})


def figure(rows: list[dict[str, Any]], path: Path) -> None:
    """Histograms at the highest rate, all blocks together."""
    chosen = [r for r in rows if "blocks" in r and r["hz"] == max(RATES)]
    drawn = {}
    for row in chosen:
        late = [ns for b in row["blocks"] for ns, n in b["bins"] for _ in range(n)]
        zero = np.zeros(len(late), np.int64)
        drawn[row["runner"]] = lateness(zero, np.array(late), row["blocks"][0]["period_ns"])
    draw(drawn, path)


def version() -> str:
    """Of cyclictest."""
    if shutil.which("cyclictest") is None:
        return ""
    done = subprocess.run(["cyclictest", "--help"], capture_output=True, text=True, check=False)
    return next(iter((done.stdout + done.stderr).splitlines()), "")


def main() -> None:
    """Measure, print the table, write the numbers."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="one short block of everything")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers here")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="draw the histograms here")
    parser.add_argument("--blocks", type=int, default=5, help="blocks of each (default 5)")
    parser.add_argument("--seconds", type=float, default=5.0, help="of a block (default 5)")
    parser.add_argument("--priority", type=int, default=50, help="of SCHED_FIFO (default 50)")
    parser.add_argument("--block", choices=LOOPS, help=argparse.SUPPRESS)
    parser.add_argument("--hz", type=int, default=1000, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.block:
        print(json.dumps(block(options.block, options.hz, options.seconds, options.priority)))
        return
    blocks, seconds = (1, 0.05) if options.quick else (options.blocks, options.seconds)
    facts: dict[str, Any] = {"machine": {**tables.machine(), "cyclictest": version()}}
    rows = measure(blocks, seconds, options.priority)
    relate(rows)
    print(report(rows))
    for line in refusals(rows):
        print(line)
    if options.figure:
        figure(rows, options.figure)
    if options.json:
        facts |= {"blocks": blocks, "seconds": seconds, "rows": rows}
        options.json.write_text(json.dumps(facts, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
