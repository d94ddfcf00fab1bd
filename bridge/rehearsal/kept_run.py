"""A rehearsal in lock-step that is kept: begun, or resumed from its last checkpoint."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self, final

from bridge.deployment.system import System
from bridge.native.library import library_path
from bridge.node import saved_state
from bridge.node.lockstep import is_lockstep
from bridge.rehearsal.checkpoints import Keeping, last_number
from cosim.base.errors import RunError, ScenarioError
from cosim.checkpoint import Resumption, archive
from cosim.checkpoint.archive import Checkpoint
from cosim.checkpoint.resumption import code
from cosim.engine.simulate import metadata
from cosim.record.folder import CHECKPOINTS, NODES, json_data, reason

#: In the checkpoints of a run: what its command was given, and the nodes' states.
GIVEN = "given"


@final
class KeptRun:
    """A run with checkpoints each `interval` (s, wall time); `given`: for one that resumes it.

    `begun`: the folder of a run that is resumed; None: it is a new one.
    """

    def __init__(
        self, interval: float, given: Mapping[str, Any], begun: Resumption | None = None
    ) -> None:
        self._interval, self.given, self._begun = interval, dict(given), begun

    @classmethod
    def open(cls, folder: Path, interval: float | None) -> Self:
        """The run in a folder, to be resumed. Raises ScenarioError if it cannot be."""
        begun = Resumption.open(folder, GIVEN)
        if os.getcwd() != begun.given["place"]:
            raise ScenarioError(
                f"the run began in {begun.given['place']}; expected --resume to be called there",
                str(folder),
            )
        known = float(begun.found.facts["interval"])
        return cls(known if interval is None else interval, begun.given, begun)

    @property
    def is_resumed(self) -> bool:
        """True if it has begun before."""
        return self._begun is not None

    def check(self, system: System) -> None:
        """Raise ScenarioError if the run cannot be kept, or is not the one that is resumed."""
        if not is_lockstep(system):
            raise ScenarioError(
                "found checkpoints on a clock, expected them in lock-step: --clock lockstep, or "
                "--hosts FILE",
                "--checkpoint",
            )
        saved_state.refuse(system)
        if self._begun is not None:
            self._begun.check(_facts(system))

    def begin(self, system: System, folder: Path) -> Keeping:
        """The checkpoint with which the run in a folder begins. Raises ScenarioError, RunError."""
        facts = {
            "given": self.given, "interval": self._interval,
            "facts": json.loads(json_data(_facts(system))),
        }  # fmt: skip
        if self._begun is None:
            (folder / CHECKPOINTS).mkdir(exist_ok=True)
            archive.write(folder / CHECKPOINTS / GIVEN, Checkpoint(facts, {}))
            return Keeping(self._interval)
        return self.again(system, folder)

    def again(self, system: System, folder: Path) -> Keeping:
        """The last checkpoint that all nodes have; the start, if there is none."""
        found = last_number(system, folder / NODES)
        return Keeping(self._interval) if found is None else Keeping(self._interval, *found)

    def end(self, folder: Path) -> None:
        """Delete the checkpoints of a finished run. Raises RunError."""
        try:
            shutil.rmtree(folder / CHECKPOINTS)
        except OSError as error:
            raise RunError(f"cannot delete {folder / CHECKPOINTS}: {reason(error)}") from error


def _facts(system: System) -> dict[str, Any]:
    """The facts on which the result depends."""
    own = {"bridge": library_path(), "deployment": system.deployment.path}
    sums = {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in own.items()}
    return {**metadata(system.scenario, system.plan), "code": {**code(system.plan), **sums}}
