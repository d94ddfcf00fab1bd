"""``python -m tests.mutants [--count N] [--seed S] [--least SHARE] [--only FILE] [GROUP ...]``.

In a copy of the checkout, one small change after the other is made in the sources of a group, its
libraries are built again, and its tests run. A mutant that no test notices has *survived*: its line
is printed, and either a test is missing there or the change makes no difference. Exits with 1 where
fewer than ``--least`` of the mutants of a group were noticed.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.mutants.changes import Mutant, mutants

ROOT = Path(__file__).resolve().parents[2]
#: s for the tests of one mutant; one that takes longer was noticed.
PATIENCE = 600
LEFT_OUT = shutil.ignore_patterns(".git", ".venv", "__pycache__", ".*_cache", "runs", ".hypothesis")


@dataclass(frozen=True, slots=True)
class Group:
    """Sources that are changed, and the tests that are to notice it."""

    sources: tuple[str, ...]
    tests: tuple[str, ...]

    def files(self, root: Path) -> list[Path]:
        """The sources, by name."""
        return sorted(path for pattern in self.sources for path in root.glob(pattern))


_BRIDGE = ("native", "can", "safety", "node", "faults", "drives", "replay")
GROUPS = {
    "bridge": Group(("bridge/c/*.c",), tuple(f"tests/bridge/{room}" for room in _BRIDGE)),
    "engine": Group(
        ("cosim/c/*.c", "cosim/c/*.h"), ("tests/cosim/engine", "tests/cosim/links", "tests/system")
    ),
    "links": Group(("cosim/links/*.py", "cosim/links/*/*.py"), ("tests/cosim/links",)),
    "kernels": Group(("fmus/c/*.c",), ("tests/fmus", "tests/cosim/fmi")),
}


def passes(copy: Path, tests: Sequence[str], log: Path) -> bool:
    """Whether the copy can be built and its tests pass."""
    environment = os.environ | {"PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    build = [sys.executable, "build_backend/compiled.py"]
    run = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    with log.open("w", encoding="utf-8") as out:
        for words in (build, run):
            try:
                done = subprocess.run(
                    words, cwd=copy, env=environment, stdout=out, stderr=out, timeout=PATIENCE
                )
            except subprocess.TimeoutExpired:
                return False
            if done.returncode:
                return False
    return True


def noticed(copy: Path, mutant: Mutant, tests: Sequence[str], log: Path) -> bool:
    """Whether the tests fail with this change; the file is as before afterwards."""
    text = mutant.file.read_text(encoding="utf-8")
    mutant.file.write_text(mutant.apply(text), encoding="utf-8")
    try:
        return not passes(copy, tests, log)
    finally:
        mutant.file.write_text(text, encoding="utf-8")


def survivors(name: str, copy: Path, count: int, seed: int, only: str) -> tuple[int, list[str]]:
    """How many mutants of a group were made, and the lines of those that nothing noticed."""
    group, log = GROUPS[name], copy / "mutant.log"
    if not passes(copy, group.tests, log):
        raise SystemExit(f"{name}: its tests fail before any change:\n{log.read_text()[-2000:]}")
    found = [m for file in group.files(copy) if only in file.name for m in mutants(file)]
    chosen = random.Random(seed).sample(found, min(count, len(found)))
    lines = []
    for number, mutant in enumerate(chosen, 1):
        said = mutant.said(mutant.file.read_text(encoding="utf-8"), copy)
        alive = not noticed(copy, mutant, group.tests, log)
        lines += [said] if alive else []
        print(
            f"{name} {number}/{len(chosen)} {'SURVIVED' if alive else 'noticed '} {said}",
            flush=True,
        )
    return len(chosen), lines


def main() -> int:
    """Make mutants of the groups asked for; 1 where too many survived."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("groups", nargs="*", default=list(GROUPS), metavar="GROUP")
    parser.add_argument("--count", type=int, default=40, help="mutants of each group (40)")
    parser.add_argument("--seed", type=int, default=1, help="of which are chosen (1)")
    parser.add_argument("--least", type=float, default=0.75, help="share to be noticed (0.75)")
    parser.add_argument("--only", default="", help="only files with this in their name")
    options = parser.parse_args()
    for name in options.groups:
        if name not in GROUPS:
            parser.error(f"unknown group {name!r}; expected one of {', '.join(GROUPS)}")
    few = False
    with tempfile.TemporaryDirectory(prefix="mutants-") as scratch:
        copy = Path(scratch) / "copy"
        shutil.copytree(ROOT, copy, ignore=LEFT_OUT)
        for name in options.groups:
            made, alive = survivors(name, copy, options.count, options.seed, options.only)
            share = 1 - len(alive) / made if made else 1.0
            few |= share < options.least
            print(
                f"{name}: {made - len(alive)} of {made} noticed ({share:.0%}), seed {options.seed}"
            )
            print("".join(f"    {line}\n" for line in alive), end="")
    return 1 if few else 0


if __name__ == "__main__":
    sys.exit(main())
