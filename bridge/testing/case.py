"""One test: its seed, its folders, and what is kept of it when it fails."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, final
from warnings import catch_warnings
from zlib import crc32

import cosim
from cosim.base.errors import CosimError, CutShort
from cosim.base.files import write_file

if TYPE_CHECKING:
    import pytest

#: A file in the folder of a failed test: the commands that repeat it.
REPEAT = "repeat.sh"


def name_of(node: pytest.Item) -> str:
    """The name of a test (its node id), the same in one process and in several of pytest-xdist."""
    name: str = node.nodeid
    mark = node.get_closest_marker("xdist_group")
    if mark is not None:  # with --dist=loadgroup, workers see the group behind the name
        group = mark.args[0] if mark.args else mark.kwargs.get("name", "default")
        name = name.removesuffix(f"@{group}")
    return name


def file_name(test: str) -> str:
    """A name for files about a test; parameters that cannot be one get a sum behind them."""
    function, bracket, parameters = test.partition("[")
    name = re.sub(r"/|::", "_", function) + bracket + parameters
    safe = re.sub(r"[^\w.=+-]+", "_", name).strip("_")[:120]
    return safe if safe == name else f"{safe}-{crc32(test.encode()):08x}"


@final
@dataclass
class PytestCase:
    """A test `name` of `file`, in a project whose names of tests count from `root`.

    Its runs are written into `folder`; `out`: where they are kept if it fails, None: there.
    """

    name: str
    root: Path
    file: Path
    folder: Path
    out: Path | None = None
    runs: list[Path] = field(default_factory=list)

    @property
    def seed(self) -> int:
        """A seed from the name of the test: the same on every machine, in every order of tests."""
        return crc32(self.name.encode()) & 0x7FFFFFFF

    def next_run(self, what: str) -> Path:
        """The folder for the next run of this test, which is not there yet."""
        path = self.folder / f"{what}-{len(self.runs) + 1}"
        self.runs.append(path)
        return path

    @contextmanager
    def at_home(self) -> Iterator[None]:
        """Work in the folder of the test's file, where scenarios and Python components are."""
        here = str(self.file.parent)
        added = here not in sys.path
        if added:
            sys.path.append(here)
        try:
            with chdir(here):
                yield
        finally:
            if added:
                sys.path.remove(here)

    def settings(self, changes: Any) -> dict[str, Any]:
        """Changes of a scenario, with the seed of this test where they name none."""
        return {"run.seed": self.seed, **(changes or {})}

    # ---- of a test that failed ---------------------------------------------------------------

    def kept(self) -> tuple[list[tuple[str, object]], str]:
        """Write reports and the commands; return properties of the test, and a text about it."""
        lines = [("seed", f"{self.seed} (from {self.name})"), ("repeat it", self._pytest())]
        script = ["#!/bin/sh", f"# seed {self.seed}, from {self.name}", self._pytest()]
        properties: list[tuple[str, object]] = [("cosim.repeat", self._pytest())]
        for run in self.runs:
            if not run.exists():
                continue
            found, command = self._described(run)
            lines += [(run.name, command or "made by the test itself"), ("", found)]
            script += [f"# {run.name}", command] if command else []
            properties.append((f"cosim.{run.name}", found))
        self.folder.mkdir(parents=True, exist_ok=True)
        write_file(self.folder / REPEAT, "\n".join(script) + "\n")
        kept = self._moved()
        lines.append(("kept in", str(kept)))
        return properties, "\n".join(f"{what:<12} {text}" for what, text in lines)

    def _pytest(self) -> str:
        """The command that runs this test alone."""
        return f"cd {shlex.quote(str(self.root))} && pytest {shlex.quote(self.name)}"

    def _described(self, run: Path) -> tuple[str, str]:
        """The path of a run's report, or why there is none, and the command that repeats it."""
        from cosim.record import Run
        from cosim.reporting.recorded import repeating_command

        try:
            with catch_warnings(action="ignore", category=CutShort):
                command = repeating_command(Run.open(run))
                report = cosim.open(run).report()
        except CosimError as error:
            return f"no report: {error}", ""
        here = shlex.quote(str(self.file.parent))
        shown = self._place() / report.relative_to(self.folder)
        return str(shown), f"cd {here} && {command}" if command else ""

    def _place(self) -> Path:
        """The folder in which all is kept."""
        if self.out is None:
            return self.folder
        return self.out / file_name(self.name)

    def _moved(self) -> Path:
        """Copy everything to the place where it is kept."""
        place = self._place()
        if place != self.folder:
            shutil.rmtree(place, ignore_errors=True)
            shutil.copytree(self.folder, place)
        os.chmod(place / REPEAT, 0o755)
        return place
