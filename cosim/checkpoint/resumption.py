"""A run that can be resumed: its last valid checkpoint, and the recorded rows before it."""

from __future__ import annotations

import hashlib
import inspect
import json
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.errors import RunError, ScenarioError
from cosim.checkpoint import archive
from cosim.checkpoint.archive import LATEST, PREVIOUS, Checkpoint
from cosim.fmi.components import stepped_fmu
from cosim.native import shared
from cosim.record.folder import (
    CHECKPOINTS,
    FINISHED,
    PART,
    TRAJECTORIES,
    json_data,
    read_metadata,
    reason,
)
from cosim.record.live import Rows
from cosim.record.pages import groups
from cosim.schedule.plan import Plan

#: Entries of ``run.json`` on which a result depends.
_DECISIVE = (
    "versions", "code", "scenario", "fmus", "files", "simulators", "step", "start", "ticks",
    "algorithm", "order", "seed", "weights", "links",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Resumption:
    """The run in `folder`, to be resumed from `found`, the file `name`. `note`: the damaged one."""

    folder: Path
    found: Checkpoint
    name: str
    note: str = ""

    @classmethod
    def open(cls, folder: Path, part: str = "") -> Resumption:
        """The last valid checkpoint of a run folder. Raises ScenarioError if there is none.

        `part`: the folder in its checkpoints.
        """
        place = folder / CHECKPOINTS / part
        if not folder.is_dir():
            raise ScenarioError("there is no such run folder", str(folder))
        there = [name for name in (LATEST, PREVIOUS) if (place / name).exists()]
        if not there and read_metadata(folder).get("status") == FINISHED:
            shutil.rmtree(place, ignore_errors=True)  # rows of a run that was killed at its end
            raise ScenarioError("the run is finished; there is nothing to resume", str(folder))
        if not there:
            raise ScenarioError(
                "has no checkpoint; expected the folder of a run with --checkpoint", str(folder)
            )
        notes: list[str] = []
        for name in there:
            try:
                return cls(folder, archive.read(place / name), name, "; ".join(notes))
            except ScenarioError as error:
                notes.append(str(error))
        raise ScenarioError(f"no checkpoint can be used: {'; '.join(notes)}", str(folder))

    @property
    def tick(self) -> int:
        """The tick at which it is resumed."""
        return int(self.found.facts["tick"])

    @property
    def time(self) -> float:
        """The time of this tick, s."""
        return float(self.found.facts["time"])

    @property
    def given(self) -> Mapping[str, Any]:
        """The scenario, settings and options of the command that wrote it."""
        found: Mapping[str, Any] = self.found.facts["given"]
        return found

    @property
    def number(self) -> int:
        """The number of times that the run had been resumed before."""
        return int(self.found.facts["resumed"])

    def check(self, facts: Mapping[str, Any]) -> None:
        """Refuse to resume another run: its `facts` are those of ``run.json``, and the code.

        Raises ScenarioError with the first entry that differs.
        """
        old, new = self.found.facts["facts"], json.loads(json_data(facts))
        for name in _DECISIVE:
            if difference := _difference(name, old.get(name), new.get(name)):
                raise ScenarioError(
                    f"the run cannot be resumed, since {difference}; expected what it began with",
                    str(self.folder),
                )

    def take_over(self) -> None:
        """Move the recorded rows aside, where a run that is resumed reads them.

        May be repeated after a kill at any moment. Raises RunError.
        """
        place = self.folder / CHECKPOINTS
        try:
            if self.name == PREVIOUS:
                (place / PREVIOUS).replace(place / LATEST)
            if not self._rows.exists():
                there = [self.folder / name for name in (TRAJECTORIES, PART)]
                path = next((path for path in there if path.exists()), None)
                if path is not None:
                    path.replace(self._rows)
                    archive.sync(self.folder)
        except OSError as error:
            raise RunError(f"cannot use {place}: {reason(error)}") from error

    @property
    def _rows(self) -> Path:
        """The file with the rows before the checkpoint."""
        return self.folder / CHECKPOINTS / rows_name(self.number)

    @property
    def rest(self) -> Rows:
        """The rows after the full row groups, (columns + 1, k), row 0 is t."""
        data, columns = self.found.blobs["rest"], self.found.facts["columns"]
        return np.frombuffer(data, np.float64).reshape(columns, -1)

    def groups(self) -> Iterator[Rows]:
        """The full row groups before the checkpoint, (columns + 1, rows). Raises ScenarioError."""
        columns = self.found.facts["columns"]
        rows = self.found.facts["group"]
        return groups(self._rows, columns, rows, self.found.facts["written"] // rows)


def rows_name(number: int) -> str:
    """The name of the file with the rows of a run that was resumed `number` times."""
    return f"rows-{number}"


def code(plan: Plan) -> dict[str, str]:
    """SHA-256 sums of what a result depends on beside the facts: engine, and Python components."""
    found = {"engine": _sum(shared.library_path())}
    for step in plan.components:
        if stepped_fmu(step.component) is None:
            try:
                found[step.name] = _sum(Path(inspect.getfile(type(step.component))))
            except (OSError, TypeError):  # a class without a file
                continue
    return found


def _sum(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _difference(name: str, old: Any, new: Any) -> str:
    """The first difference of two values of JSON, as part of a sentence; "": none."""
    if old == new:
        return ""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted({*old, *new}):
            if found := _difference(f"{name}.{key}", old.get(key), new.get(key)):
                return found
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for i, (a, b) in enumerate(zip(old, new, strict=True)):
            if found := _difference(f"{name}.{i}", a, b):
                return found
    return f"{name} was {_short(old)} and is {_short(new)}"


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
