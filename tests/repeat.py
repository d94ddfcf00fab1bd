"""Whether tests on the wall clock are stable: each of them many times, idle and beside a busy core.

    python -m tests.repeat [--times N] [PYTEST ARGUMENTS ...]     default: -m live, 50 times

Prints one line a test: how often it passed, failed and was inconclusive (skipped, with its reason),
on the idle machine and next to a process that computes without a pause. The exit code is 1 if any
test failed once. Output of failed repetitions is kept in the folder that is named at the end.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

OUTCOMES = ("passed", "failed", "inconclusive")
Counts = defaultdict[str, Counter[str]]


def outcomes(report: Path) -> Iterator[tuple[str, str]]:
    """Of a JUnit file: the name of each test and what came of it, one of OUTCOMES."""
    for case in ET.parse(report).getroot().iter("testcase"):
        kinds = {child.tag for child in case}
        failed = kinds & {"failure", "error"}
        said = "failed" if failed else "inconclusive" if "skipped" in kinds else "passed"
        yield f"{case.get('classname')}::{case.get('name')}", said


@contextmanager
def load(processes: int) -> Iterator[None]:
    """So many processes that compute without a pause."""
    running = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(processes)
    ]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def repeat(times: int, selection: list[str], folder: Path, busy: int) -> Counts:
    """Run the selection so often; what came of each test. Logs of failed runs stay in `folder`."""
    counts: Counts = defaultdict(Counter)
    for number in range(times):
        report = folder / f"{'busy' if busy else 'idle'}-{number}.xml"
        words = [sys.executable, "-m", "pytest", "-q", f"--junit-xml={report}", *selection]
        with load(busy):
            done = subprocess.run(words, capture_output=True, text=True, check=False)
        if not report.is_file():
            raise SystemExit(done.stdout + done.stderr)
        for name, said in outcomes(report):
            counts[name][said] += 1
        if done.returncode:
            report.with_suffix(".log").write_text(done.stdout + done.stderr, encoding="utf-8")
        report.unlink()
    return counts


def table(idle: Counts, busy: Counts) -> str:
    """One line a test."""
    lines = [f"{'passed/failed/inconclusive':>28}  {'idle':>10}  {'busy':>10}"]
    for name in sorted({*idle, *busy}):
        cells = ["/".join(str(c[name][o]) for o in OUTCOMES) for c in (idle, busy)]
        lines.append(f"{cells[0]:>40}  {cells[1]:>10}  {name}")
    return "\n".join(lines)


def main() -> int:
    """Repeat, print the table; 1 if a test failed once."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--times", type=int, default=50, help="repetitions of each kind (50)")
    options, selection = parser.parse_known_args()
    folder = Path(tempfile.mkdtemp(prefix="repeat-"))
    chosen = selection or ["-m", "live"]
    idle = repeat(options.times, chosen, folder, 0)
    busy = repeat(options.times, chosen, folder, 1)
    print(table(idle, busy))
    failed = sum(c["failed"] for counts in (idle, busy) for c in counts.values())
    print(f"{failed} failures" + (f"; their output is in {folder}" if failed else ""))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
