"""Writes checkpoints of a run between its chunks, and resumes the run from one."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

from cosim.base.clock import stopwatch
from cosim.base.errors import RunError
from cosim.checkpoint import archive, state
from cosim.checkpoint.archive import Checkpoint
from cosim.checkpoint.resumption import Resumption, code, rows_name
from cosim.engine.engine import Engine
from cosim.record.folder import CHECKPOINTS, json_data, reason
from cosim.record.recorder import Recorder


@dataclass(frozen=True, slots=True)
class CheckpointInterval:
    """The time between two checkpoints, s; `simulated`: of the run, else of the wall clock."""

    time: float
    simulated: bool = False


@final
class CheckpointKeeper:
    """Keeps the state of one run (:class:`cosim.engine.simulate.Keeper`).

    `interval`: between two checkpoints. `given`: what the command was given, for one that resumes
    the run. `resumption`: from where this run is resumed; None: from its start. Its
    caller ends the keeper once what is made of the run is complete, too.
    """

    def __init__(
        self,
        interval: CheckpointInterval,
        given: Mapping[str, Any],
        resumption: Resumption | None = None,
    ) -> None:
        self._interval, self._given, self._from = interval, dict(given), resumption
        self._every = 0  # ticks between two checkpoints; 0: wall time
        facts = {} if resumption is None else resumption.found.facts
        self._number = 0 if resumption is None else resumption.number + 1
        #: Wall time of earlier parts of the run, s.
        self.before: float = facts.get("wall", 0.0)
        self._numbers = [] if resumption is None else [resumption.number]
        self._facts: Mapping[str, Any] = {}
        self._folder = Path()
        self._running = self._since = stopwatch()
        #: Bytes of the last checkpoint, the number of all, and what they took, s; what it took to
        #: resume the run, s.
        self.size, self.count, self.spent, self.resuming = 0, 0, 0.0, 0.0

    @property
    def command(self) -> str:
        """The command that began the run."""
        return str(self._given["command"])

    def check(self, engine: Engine, facts: Mapping[str, Any]) -> None:
        """Raise ScenarioError if the run cannot be kept, or is not the one that is resumed."""
        state.refuse(engine.plan)
        if self._interval.simulated:
            self._every = max(1, round(self._interval.time / engine.plan.h))
        self._facts = {**facts, "code": code(engine.plan)}
        if self._from is None:
            state.save(engine)
        else:
            self._from.check(self._facts)

    def prepare(self, folder: Path) -> bool:
        """Make the folder ready; true: it has the run that is resumed. Raises RunError."""
        self._folder = folder / CHECKPOINTS
        if self._from is not None:
            self._from.take_over()
        return self._from is not None

    def begin(self, engine: Engine, recorder: Recorder) -> None:
        """Bring the run to the tick at which it is resumed; of a new run, keep the start.

        Raises RunError, ScenarioError.
        """
        watch = stopwatch()
        if self._from is not None:
            state.restore(engine, self._from.tick, self._from.found.blobs)
            recorder.resume(self._from.groups(), self._from.rest, self._from.tick)
            self._from, self.resuming = None, watch()
        else:
            self.keep(engine, recorder, now=True)
        self._running, self._since = stopwatch(), stopwatch()

    def ahead(self, tick: int) -> int:
        """The ticks from `tick` to the next checkpoint; in wall time: any number."""
        return self._every - tick % self._every if self._every else sys.maxsize

    def _is_time(self, tick: int) -> bool:
        if self._every:
            return tick % self._every == 0
        return self._since() >= self._interval.time

    def keep(self, engine: Engine, recorder: Recorder, *, now: bool) -> None:
        """Write a checkpoint if it is time, or with `now`. Raises RunError."""
        if not (now or self._is_time(engine.tick)) or not state.is_between_ticks(engine):
            return
        watch = stopwatch()
        rows = recorder.settle()
        facts = {
            "tick": engine.tick, "time": engine.plan.time(engine.tick), "given": self._given,
            "facts": json.loads(json_data(self._facts)), "resumed": self._number,
            "wall": self.before + self._running(), "columns": len(rows.rest),
            "written": rows.written, "group": rows.group,
            "interval": (self._interval.time, self._interval.simulated),
        }  # fmt: skip
        blobs = {**state.save(engine), "rest": rows.rest.tobytes()}
        self.size = archive.write(self._folder, Checkpoint(facts, blobs))
        self._numbers = [*self._numbers[-1:], self._number]
        self._drop_rows()
        self.count, self.spent = self.count + 1, self.spent + watch()
        self._since = stopwatch()

    def _drop_rows(self) -> None:
        """Delete rows of earlier parts of the run that no checkpoint needs."""
        needed = set(map(rows_name, self._numbers))
        try:
            for path in self._folder.glob(rows_name(0)[:-1] + "*"):
                if path.name not in needed:
                    path.unlink()
        except OSError as error:
            raise RunError(f"cannot write {self._folder}: {reason(error)}") from error

    def end(self) -> None:
        """Delete the checkpoints: the run, and what is made of it, is complete. Raises RunError.

        The rows of earlier parts are deleted last: a checkpoint that is there can be used.
        """
        try:
            for name in (archive.PREVIOUS, archive.LATEST):
                (self._folder / name).unlink(missing_ok=True)
            shutil.rmtree(self._folder)
        except OSError as error:
            raise RunError(f"cannot delete {self._folder}: {reason(error)}") from error
