"""``python -m tests.mutants.worker GROUP ASKED``: try mutants, in the checkout this runs in.

ASKED is a file of JSON: the tests, the mutants, the budget of time for each, and the checkout that
this one is a copy of. For each mutant, a line of JSON goes to standard output: its number, the test
that noticed it or ``""``, how many tests were chosen of how many, and the wall time and processor
time this took, s. pytest and what the tests import are imported once; building and testing happen
in forked processes.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import os
import pkgutil
import sys
import time
from pathlib import Path

from tests.mutants.changes import Mutant
from tests.mutants.choice import Choice, file_of
from tests.mutants.groups import GROUPS
from tests.mutants.measure import Measurement, compiled
from tests.mutants.trial import Outcome, Selection, run
from tests.objects import keep

#: Imported by many tests, changed by none.
OUTSIDE = ("hypothesis", "numpy", "pyarrow", "pyarrow.parquet", "msgspec", "msgspec.toml")
#: Commands, and our libraries, which have the names of modules.
LIBRARIES = ("_engine", "_bus", "_bridge")
#: In place of a test: the change makes no difference, for the compiler makes the same of both.
SAME = "the same program"
NOT_IMPORTED = ("__main__", *LIBRARIES)


class Trials:
    """The mutants tried in one checkout, with the tests that its `choice` names."""

    def __init__(self, choice: Choice, root: Path) -> None:
        self._choice, self._root, self._log = choice, root, root / "mutants.log"
        self._built = built(root)

    def failed(self, mutant: Mutant) -> tuple[str, list[int]]:
        """The first test that fails with this change, ``""`` or :data:`SAME`; how many of how many
        were chosen. The file is restored.
        """
        file = self._root / mutant.file
        text = file.read_text(encoding="utf-8")
        chosen, executing = self._choice.tests(mutant)
        _write(file, mutant.apply(text))
        try:
            return self._first_failure(mutant, chosen), [len(chosen), executing]
        finally:
            _write(file, text)

    def _first_failure(self, mutant: Mutant, chosen: list[str]) -> str:
        if mutant.file.suffix != ".py":
            try:
                compiled(self._root, self._log)
            except SystemExit:
                return "the build"
            if built(self._root) == self._built:
                return SAME
        for files in self._choice.rounds(mutant, chosen):
            found = self._outcome(files, chosen)
            if found.failures and self._choice.waits(found.failures[0].split(" (")[0]):
                found = self._outcome(files, chosen)  # not because the machine is busy
            if found.failures:
                self._choice.noticed(mutant.file, found.failures[0].split(" (")[0])
                return found.failures[0]
        return ""

    def _outcome(self, files: list[str], chosen: list[str]) -> Outcome:
        order = {test: n for n, test in enumerate(chosen)}
        place = {name: n for n, name in enumerate(files)}

        def rank(test: str) -> tuple[int, int]:
            return place.get(file_of(test), 0), order.get(test, 0)

        seconds = self._choice.seconds
        limit = 60 + 5 * sum(seconds[test][0] for test in chosen if file_of(test) in place)
        selection = Selection(rank, frozenset(chosen), seconds)
        return run(files, selection, self._log, limit)


def built(root: Path) -> str:
    """The digest of the libraries and FMUs of a checkout."""
    digest = hashlib.sha256()
    for file in sorted([*root.glob("*/_*.so"), *root.glob("fmus/_built/*.fmu")]):
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


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
    root, group = Path.cwd(), GROUPS[sys.argv[1]]
    warm(group.imported)
    keep(root / "mutants.objects")
    begin = sum(os.times()[:4])
    sources = [file.relative_to(root) for file in group.files(root)]
    measurement = Measurement(root, Path(asked["checkout"]), sources)
    choice = Choice(measurement.of(asked["tests"]), measurement.blocks, asked["budget"])
    took = sum(os.times()[:4]) - begin
    said = f"{choice.said()}\n    measured in {took:.0f} s of processor time"
    print(json.dumps({"said": said}), flush=True)
    trials = Trials(choice, root)
    for number, (file, at, old, new) in asked["mutants"]:
        wall, cpu = time.monotonic(), sum(os.times()[:4])
        failed, tests = trials.failed(Mutant(Path(file), at, old, new))
        spent = [time.monotonic() - wall, sum(os.times()[:4]) - cpu]
        event = {"number": number, "failed": failed, "tests": tests, "took": spent}
        print(json.dumps(event), flush=True)


if __name__ == "__main__":
    main()
