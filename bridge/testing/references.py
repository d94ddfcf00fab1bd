"""Reference runs: what a test recorded when it was right, kept next to its file."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import final

import cosim
from bridge.testing.case import PytestCase, file_name
from cosim.base.errors import ScenarioError
from cosim.record.folder import TRAJECTORIES

#: A folder next to the file of a test.
FOLDER = "references"


@final
class References:
    """The references of a test; `update`: they are written anew."""

    def __init__(self, case: PytestCase, *, update: bool) -> None:
        self._case, self._update = case, update

    def __call__(self, run: cosim.RunResult, name: str = "") -> Path:
        """The trajectories to compare a run with; `name` tells several of one test apart.

        With ``--cosim-update`` they are those of the run from now on. Raises ScenarioError where
        there are none yet.
        """
        path = self._path(name)
        if self._update:
            path.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(run.folder / TRAJECTORIES, path)
        elif not path.exists():
            raise ScenarioError(
                "no reference is kept yet; pytest --cosim-update writes it", str(path)
            )
        return path

    def _path(self, name: str) -> Path:
        file, test = self._case.file, self._case.name.partition("::")[2]
        stem = file_name(f"{test}-{name}" if name else test)
        return file.parent / FOLDER / file.stem / f"{stem}.parquet"
