"""``python -m tests.mutants.worker GROUP MUTANTS``: try mutants, in the checkout this runs in.

MUTANTS is a file of JSON: the tests and the mutants. For each mutant, a line of JSON goes to
standard output: its number, the test that noticed it or ``""``, and the wall time and processor
time this took, s. pytest and what the tests import are imported once; building and testing happen
in forked processes.
"""

from __future__ import annotations

import importlib
import json
import os
import pkgutil
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from tests.mutants.build import build
from tests.mutants.changes import Mutant
from tests.mutants.groups import GROUPS
from tests.mutants.trial import Outcome, Selection, forked, run

#: Tests that take more processor time or wall time than this, s, are left out.
CPU, WALL = 3.0, 20.0
#: So many files of tests, which noticed most mutants of a source before, are tried first.
FIRST = 3
#: s for a build, and for the tests before any change.
PATIENCE = 900.0
#: Imported by many tests, changed by none.
OUTSIDE = ("hypothesis", "numpy", "pyarrow", "pyarrow.parquet", "msgspec", "msgspec.toml")
#: Commands, and our libraries, which have the names of modules.
LIBRARIES = ("_engine", "_bus", "_bridge")
NOT_IMPORTED = ("__main__", *LIBRARIES)


class Trials:
    """The mutants tried in one checkout with some tests, and which tests noticed those before."""

    def __init__(self, tests: list[str], root: Path) -> None:
        self._tests, self._root = tests, root
        self._log, self._objects = root / "mutants.log", root / "mutants.objects"
        self._seconds: dict[str, tuple[float, float]] = {}
        self._left_out: frozenset[str] = frozenset()
        self._noticed: Counter[tuple[str, str]] = Counter()

    def unchanged(self) -> None:
        """Build, and run all tests once. Raises SystemExit where they fail."""
        outcome = self._outcome(self._tests, Path(), PATIENCE)
        if outcome.failed:
            said = self._log.read_text(encoding="utf-8", errors="replace")[-2000:]
            raise SystemExit(f"before any change, this fails: {outcome.failed}\n{said}")
        self._seconds = outcome.seconds
        slow = {name for name, (wall, cpu) in outcome.seconds.items() if cpu > CPU or wall > WALL}
        self._left_out = frozenset(slow)

    def said(self) -> str:
        """How many tests there are, how long they take, and which are left out."""
        wall = sum(s for name, (s, _) in self._seconds.items() if name not in self._left_out)
        names = "".join(f"\n    left out: {name}" for name in sorted(self._left_out))
        return f"{len(self._seconds) - len(self._left_out)} tests, {wall:.0f} s{names}"

    def failed(self, mutant: Mutant) -> str:
        """The first test that fails with this change, or ``""``; the file is restored."""
        file = self._root / mutant.file
        text = file.read_text(encoding="utf-8")
        _write(file, mutant.apply(text))
        try:
            return self._first_failure(mutant.file)
        finally:
            _write(file, text)

    def _first_failure(self, source: Path) -> str:
        limit = 60 + 3 * sum(wall for wall, _ in self._seconds.values())
        found = Outcome()
        for tests in self._rounds(source):
            found = self._outcome(tests, source, limit)
            if found.failed:
                test = found.failed.split(" (")[0]
                for key in ((str(source), test), ("", _file(test)), (str(source), _file(test))):
                    self._noticed[key] += 1
                break
        return found.failed

    def _rounds(self, source: Path) -> Iterator[list[str]]:
        """The files of tests: first the best for this source, then the others."""
        kept = (name for name in self._seconds if name not in self._left_out)
        files = sorted({_file(name) for name in kept}, key=lambda name: self._rank(source, name))
        first = [name for name in files[:FIRST] if self._noticed["", name]]
        yield from (part for part in (first, files[len(first) :]) if part)

    def _rank(self, source: Path, file: str) -> tuple[float, float, float, str]:
        seconds = sum(wall for name, (wall, _) in self._seconds.items() if _file(name) == file)
        return -self._noticed[str(source), file], -self._noticed["", file], seconds, file

    def _outcome(self, tests: list[str], source: Path, limit: float) -> Outcome:
        def compiled(_: int) -> int:
            build(self._root, self._objects)
            return 0

        if source.suffix != ".py":
            code, _ = forked(compiled, self._log, PATIENCE)
            if code:
                return Outcome("the build")
        order = {_file(name): n for n, name in enumerate(tests)}

        def rank(test: str) -> tuple[int, int]:
            return order.get(_file(test), 0), -self._noticed[str(source), test]

        return run(tests, Selection(rank, self._left_out, self._seconds), self._log, limit)


def _file(test: str) -> str:
    return test.partition("::")[0]


def _write(file: Path, text: str) -> None:
    """Write a source; Python compiles it again, however short ago it was written before."""
    file.write_text(text, encoding="utf-8")
    for known in file.parent.glob(f"__pycache__/{file.stem}.*.pyc"):
        known.unlink()


def warm(packages: tuple[str, ...]) -> None:
    """Import what no mutant changes. Raises SystemExit where this loads a library of ours."""
    for name in OUTSIDE:
        importlib.import_module(name)
    for name in packages:
        package = importlib.import_module(name)
        for module in pkgutil.walk_packages(package.__path__, f"{name}."):
            if module.name.rpartition(".")[2] in NOT_IMPORTED:
                continue
            try:
                importlib.import_module(module.name)
            except ImportError:  # an extra that is not installed
                continue
    loaded = Path("/proc/self/maps").read_text(encoding="utf-8")
    if any(f"{name}.so" in loaded for name in LIBRARIES):
        raise SystemExit("importing the packages loads a library that mutants change")


def main() -> None:
    """Try the mutants of the file named on the command line."""
    asked = json.loads(Path(sys.argv[2]).read_text(encoding="utf-8"))
    warm(GROUPS[sys.argv[1]].imported)
    trials = Trials(asked["tests"], Path.cwd())
    trials.unchanged()
    print(json.dumps({"said": trials.said()}), flush=True)
    for number, (file, at, old, new) in asked["mutants"]:
        wall, cpu = time.monotonic(), sum(os.times()[:4])
        failed = trials.failed(Mutant(Path(file), at, old, new))
        took = [time.monotonic() - wall, sum(os.times()[:4]) - cpu]
        print(json.dumps({"number": number, "failed": failed, "took": took}), flush=True)


if __name__ == "__main__":
    main()
