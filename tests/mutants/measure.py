"""Measurements of the unchanged program: the time of each test, and its blocks of C.

Each file of tests runs in a process of its own, so that what several files share (a fixture of the
session, a cached result) is made in each of them, and counts for each. The results are kept in
``.mutants_cache`` of the checkout for as long as the sources and that file of tests stay the same.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path

from tests.mutants.blocks import Block, Marks, blocks, instrumented
from tests.mutants.build import build
from tests.mutants.trial import Outcome, Selection, forked, run

#: s for a build, and for one file of tests before any change.
PATIENCE = 900.0
#: The folder in the checkout where results are kept, and the packages that they depend on.
KEPT = ".mutants_cache"
_PACKAGES = ("cosim", "fmus", "bridge", "tests")
_SUFFIXES = (".py", ".c", ".h")


class Measurement:
    """Measures files of tests in the checkout `root`, or takes what is known from `checkout`."""

    def __init__(self, root: Path, checkout: Path, sources: Sequence[Path]) -> None:
        self._root, self._known = root, checkout / KEPT
        self._log = root / "mutants.log"
        self._sources = [file for file in sources if file.suffix != ".py"]
        self.blocks: list[Block] = blocks(self._sources, root)
        self._digest = _digest(root, self._sources)

    def of(self, tests: Iterable[str]) -> dict[str, Outcome]:
        """The outcome of each file of tests. Raises SystemExit where the build fails."""
        names = test_files(self._root, tests)
        missing = [name for name in names if not self._place(name).is_file()]
        if missing:
            for name in self._with_marks(missing):  # those fail because of the marks, or anyway
                known = self._read(name)
                again = self._run(name, None)
                known.failures, known.seconds = again.failures, again.seconds
                self._write(name, known)
        compiled(self._root, self._log)
        return {name: self._read(name) for name in names}

    def _with_marks(self, names: Iterable[str]) -> list[str]:
        """Run files of tests while the sources set their marks; those that fail."""
        marks = Marks(self._root / "mutants.marks", len(self.blocks))
        before = {file: (self._root / file).read_text(encoding="utf-8") for file in self._sources}
        failed = []
        try:
            for file, text in before.items():
                own = [block for block in self.blocks if block.file == file]
                if own:
                    (self._root / file).write_text(instrumented(text, own, marks), encoding="utf-8")
            compiled(self._root, self._log)
            for name in names:
                found = self._run(name, marks)
                self._write(name, found)
                failed += [name] if found.failures else []
        finally:
            for file, text in before.items():
                (self._root / file).write_text(text, encoding="utf-8")
            compiled(self._root, self._log)
        return failed

    def _run(self, name: str, marks: Marks | None) -> Outcome:
        return run([name], Selection(marks=marks), self._log, PATIENCE, to_the_end=True)

    def _place(self, name: str) -> Path:
        digest = hashlib.sha256(f"{self._digest}{name}".encode())
        digest.update((self._root / name).read_bytes())
        return self._known / f"{digest.hexdigest()[:32]}.json"

    def _read(self, name: str) -> Outcome:
        return Outcome(**json.loads(self._place(name).read_text(encoding="utf-8")))

    def _write(self, name: str, found: Outcome) -> None:
        self._known.mkdir(exist_ok=True)
        self._place(name).write_text(json.dumps(asdict(found)), encoding="utf-8")


def compiled(root: Path, log: Path) -> None:
    """Build in a process of its own, which may load what it made. Raises SystemExit."""

    def work(_: int) -> int:
        build(root)
        return 0

    if forked(work, log, PATIENCE)[0]:
        raise SystemExit(f"the build failed:\n{log.read_text(errors='replace')[-2000:]}")


def test_files(root: Path, tests: Iterable[str]) -> list[str]:
    """The files of tests in files and folders, relative to the checkout."""
    found = [root / name for name in tests]
    files = {
        file for path in found for file in ([path] if path.is_file() else path.rglob("test_*.py"))
    }
    return sorted(str(file.relative_to(root)) for file in files)


def _digest(root: Path, sources: Iterable[Path]) -> str:
    """The digest of everything that decides what a test executes, besides its own file."""
    digest = hashlib.sha256(repr([str(source) for source in sources]).encode())
    files = {f for name in _PACKAGES for f in (root / name).rglob("*") if f.suffix in _SUFFIXES}
    for file in sorted(files | {root / source for source in sources}):
        if not file.name.startswith("test_") and file.parent.name != "mutants":
            digest.update(str(file.relative_to(root)).encode() + file.read_bytes())
    return digest.hexdigest()
