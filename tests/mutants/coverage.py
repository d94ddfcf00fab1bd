"""``python -m tests.mutants.coverage [c] [python]``: what the tests execute, room by room.

Of C, the lines of the blocks that any test of a group executes (:mod:`tests.mutants.blocks`), file
by file; of Python, lines and branches by coverage.py, which the environment has to have, in all
tests of ``.ci/run``. A map of where tests are missing, not a target. Prints Markdown tables.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path

from tests.mutants.__main__ import LEFT_OUT, ROOT, THREADS
from tests.mutants.blocks import Block
from tests.mutants.changes import masked
from tests.mutants.groups import GROUPS
from tests.mutants.measure import Measurement
from tests.mutants.worker import warm
from tests.objects import keep

_SETTINGS = """\
[run]
branch = True
parallel = True
patch = subprocess
concurrency = thread, multiprocessing
source = cosim, fmus, bridge
"""


def code_lines(text: str, known: Iterable[Block], executed: set[int]) -> tuple[int, int]:
    """Lines of C with code inside of blocks: (executed, all)."""
    inside = sorted(known, key=lambda block: block.end - block.begin)
    at, done, lines = 0, 0, 0
    for line in masked(text).splitlines(keepends=True):
        begin, at = at + len(line) - len(line.lstrip()), at + len(line)
        if not line.strip(" \t\r\n{};\0"):
            continue
        block = next((b for b in inside if b.begin <= begin < b.end), None)
        if block is not None:
            lines += 1
            done += block.number in executed
    return done, lines


def measure(name: str, checkout: str) -> None:
    """Print, as JSON, the rows (file, executed lines, lines) of a group, in a copy of a checkout
    that is the working directory.
    """
    root, group = Path.cwd(), GROUPS[name]
    warm(group.imported)
    keep(root / "mutants.objects")
    files = [file.relative_to(root) for file in group.files(root)]
    measured = Measurement(root, Path(checkout), files)
    texts = {file: (root / file).read_text(encoding="utf-8") for file in files}
    found = measured.of(group.tests)
    executed = {number for outcome in found.values() for number in outcome.blocks()}
    rows = []
    for file, text in texts.items():
        own = [block for block in measured.blocks if block.file == file]
        done, lines = code_lines(text, own, executed)
        if lines:
            rows.append((str(file), done, lines))
    print(json.dumps(rows))


def of_c() -> list[tuple[str, int, int]]:
    """(file, executed lines, lines) of every C file of the groups."""
    rows = []
    for name, group in GROUPS.items():
        if all(pattern.endswith(".py") for pattern in group.sources):
            continue
        with tempfile.TemporaryDirectory(prefix="coverage-") as scratch:
            copy = Path(scratch, "checkout")
            shutil.copytree(ROOT, copy, ignore=LEFT_OUT)
            own = {"PYTHONPATH": str(copy), "XDG_CACHE_HOME": f"{scratch}/cache", **THREADS}
            command = [sys.executable, "-m", "tests.mutants.coverage", f"measure:{name}", str(ROOT)]
            run = subprocess.run(
                command, cwd=copy, env=os.environ | own, stdout=subprocess.PIPE, check=True
            )
            rows += [tuple(row) for row in json.loads(run.stdout.splitlines()[-1])]
    return rows


def of_python() -> list[tuple[str, int, int, int, int]]:
    """(room, executed lines, lines, executed branches, branches) of Python."""
    with tempfile.TemporaryDirectory(prefix="coverage-") as scratch:
        settings = Path(scratch, "settings")
        settings.write_text(f"{_SETTINGS}data_file = {scratch}/data\n", encoding="utf-8")
        tool = [sys.executable, "-m", "coverage"]
        own = f"--rcfile={settings}"
        tests = ["-m", "pytest", "-q", "-n", "2", "--no-header", "-p", "no:cacheprovider"]
        subprocess.run([*tool, "run", own, *tests], cwd=ROOT, stdout=sys.stderr, check=False)
        subprocess.run([*tool, "combine", "-q", own], cwd=ROOT, check=True)
        subprocess.run(
            [*tool, "json", "-q", own, "-o", f"{scratch}/found.json"], cwd=ROOT, check=True
        )
        files = json.loads(Path(scratch, "found.json").read_text(encoding="utf-8"))["files"]
    rooms: defaultdict[str, list[int]] = defaultdict(lambda: [0, 0, 0, 0])
    for name, found in files.items():
        told = found["summary"]
        numbers = ("covered_lines", "num_statements", "covered_branches", "num_branches")
        for i, number in enumerate(numbers):
            rooms["/".join(Path(name).parts[:2])][i] += told[number]
    return [(room, *numbers) for room, numbers in sorted(rooms.items())]  # type: ignore[misc]


def _share(done: int, every: int) -> str:
    return f"{done / every:.0%}" if every else "–"


def _print(header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    for row in (header, ["---"] * len(header), *rows):
        print(f"| {' | '.join(row)} |", flush=True)


def main() -> None:
    """Measure and print."""
    asked = sys.argv[1:] or ["c", "python"]
    if asked[0].startswith("measure:"):
        measure(asked[0].partition(":")[2], asked[1])
        return
    if "c" in asked:
        rows = of_c()
        total = ("all", sum(r[1] for r in rows), sum(r[2] for r in rows))
        _print(("C file", "lines executed", "of"), [
            (name, _share(done, lines), str(lines)) for name, done, lines in (*rows, total)
        ])  # fmt: skip
    if "python" in asked:
        found = of_python()
        every = ("all", *(sum(r[i] for r in found) for i in range(1, 5)))
        _print(("room", "lines executed", "of", "branches taken", "of"), [
            (room, _share(a, b), str(b), _share(c, d), str(d)) for room, a, b, c, d in
            (*found, every)
        ])  # fmt: skip


if __name__ == "__main__":
    main()
