"""Stability of tests on the wall clock: each runs many times, on an idle and a busy machine.

    python -m tests.repeat [--times N] [PYTEST ARGUMENTS ...]     default: -m live, 50 times
    python -m tests.repeat --only idle [PYTEST ARGUMENTS ...]     one of the two columns
    python -m tests.repeat --together 6 [PYTEST ARGUMENTS ...]    6 pytest processes at once

Prints one line a test: how often it passed, failed and was inconclusive (skipped, with its reason),
on the idle machine and next to a process that computes without a pause. With `--together N`, N
rounds run side by side and are each other's load: that is never easier than one at a time, and
takes an Nth of the time where the tests mostly wait. The exit code is 1 if any test failed once; a
round in which pytest itself died counts as failed for all of its tests. The output of failed rounds
stays in the folder that is named at the end.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path

OUTCOMES = ("passed", "failed", "inconclusive")
Counts = defaultdict[str, Counter[str]]


def outcomes(report: Path) -> Iterator[tuple[str, str]]:
    """The name of each test in a JUnit file and its result, one of OUTCOMES."""
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


def collected(selection: list[str]) -> list[str]:
    """The tests of a selection: collecting all takes longer than a round of a few."""
    words = [sys.executable, "-m", "pytest", "--collect-only", "-q", *selection]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(done.stdout + done.stderr)
    return [line for line in done.stdout.splitlines() if "::" in line]


def one_round(tests: list[str], folder: Path, number: int) -> list[tuple[str, str]]:
    """Run the tests once; what came of each. The log of a round that failed stays in `folder`."""
    report, temporary = folder / f"{number}.xml", folder / str(number)
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
    words += ["-m", "", f"--basetemp={temporary}", f"--junit-xml={report}", *tests]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode:
        report.with_suffix(".log").write_text(done.stdout + done.stderr, encoding="utf-8")
    found = [*outcomes(report)] if report.is_file() else [(test, "failed") for test in tests]
    report.unlink(missing_ok=True)
    shutil.rmtree(temporary, ignore_errors=True)
    return found


def repeat(times: int, tests: list[str], folder: Path, busy: int, together: int) -> Counts:
    """Run the tests so often, beside `busy` processes, `together` at once; see `one_round`."""
    folder.mkdir()
    counts: Counts = defaultdict(Counter)
    with load(busy), ThreadPoolExecutor(together) as pool:
        for found in pool.map(partial(one_round, tests, folder), range(times)):
            for name, said in found:
                counts[name][said] += 1
            failed = sum(count["failed"] for count in counts.values())
            print(
                f"{max(c.total() for c in counts.values())} of {times}, {failed} failures",
                file=sys.stderr,
            )
    return counts


def table(columns: Mapping[str, Counts]) -> str:
    """One line a test."""
    titles = "".join(f"{title:>12}" for title in columns)
    lines = [f"{'/'.join(OUTCOMES)}:{titles}"]
    for name in sorted({name for counts in columns.values() for name in counts}):
        cells = ["/".join(str(c[name][o]) for o in OUTCOMES) for c in columns.values()]
        lines.append("".join(f"{cell:>12}" for cell in cells) + f"  {name}")
    return "\n".join(lines)


def main() -> int:
    """Repeat, print the table; 1 if a test failed once."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--times", type=int, default=50, help="rounds of each kind (50)")
    parser.add_argument("--only", choices=("idle", "busy"), help="one of the two kinds")
    parser.add_argument("--together", type=int, default=1, help="rounds at once (1)")
    options, selection = parser.parse_known_args()
    folder = Path(tempfile.mkdtemp(prefix="repeat-"))
    run = partial(repeat, options.times, collected(selection or ["-m", "live"]))
    kinds = {"idle": 0, "busy": 1}
    chosen = [options.only] if options.only else [*kinds]
    columns = {kind: run(folder / kind, kinds[kind], options.together) for kind in chosen}
    print(table(columns))
    failed = sum(c["failed"] for counts in columns.values() for c in counts.values())
    print(f"{failed} failures" + (f"; their output is in {folder}" if failed else ""))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
