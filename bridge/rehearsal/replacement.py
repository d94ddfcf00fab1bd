"""Nodes and hosts that died in lock-step are replaced, and the run is continued.

All nodes are ended and started again from the last checkpoint that all of them have: where they
were, or on the other hosts of the file if a host does not start any more. What was computed after
the checkpoint is computed again, to the same bits.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import final

from bridge.deployment.system import System
from bridge.node.handle import LostError
from bridge.records.records import Gone, LifeEnd, Note, Remark
from bridge.rehearsal.host_file import HostFile
from bridge.rehearsal.kept_run import KeptRun
from bridge.rehearsal.remote import RemoteHosts, on_hosts
from bridge.rehearsal.settings import NodeStarter, RehearsalRecord, Settings
from bridge.rehearsal.supervisor import Rehearsal
from cosim.base.copies import replace

#: Replacements one after the other, without a new checkpoint between them, if no option says.
REPLACEMENTS = 3


@final
class ReplacingRun:
    """A run, with at most `most` replacements between two checkpoints; 0 without `kept`.

    `settings`: with the checkpoint that the run begins with; `file`: of its hosts. `ended`: what
    came of it so far.
    """

    def __init__(
        self,
        kept: KeptRun | None,
        system: System,
        settings: Settings,
        folder: Path,
        *,
        file: HostFile | None = None,
        most: int = REPLACEMENTS,
    ) -> None:
        self._kept, self._system, self._settings = kept, system, settings
        self._folder, self._file, self._most = folder, file, most
        self._notes: list[Note] = []
        self._tries = 0
        self.ended = RehearsalRecord()

    @property
    def starter(self) -> NodeStarter | None:
        """The hosts of the last attempt."""
        return self._settings.starter

    def run(
        self, progress: Callable[[float, float], None], tell: Callable[[str], None]
    ) -> RehearsalRecord:
        """The run to its end. `progress` is called with (t, end), s; `tell` with a sentence at each
        replacement.

        Raises RunError, Interrupted.
        """
        while True:
            try:
                why = self._attempt(progress)
                if not why or self._tries >= self._most:
                    return self.ended
                self._again(why, tell)
            except LostError as error:
                self._leave_out(error)
                self._again(str(error), tell)

    def _attempt(self, progress: Callable[[float, float], None]) -> str:
        """One attempt; the nodes that were lost, or "": none, or one ended with an error."""
        with Rehearsal(self._system, self._settings, self._folder) as running:
            self.ended = running.ended
            try:
                running.run(progress)
            finally:
                self.ended.notes[:0] = self._notes
        lost = [n for n in self.ended.notes if isinstance(n, Gone) and n.end is LifeEnd.KILLED]
        if any(node.failed for node in running.current.values()):
            return ""
        return "; ".join(note.describe() for note in lost)

    def _leave_out(self, error: LostError) -> None:
        """Go on without the hosts that did not start. Raises the error if that is not possible."""
        file = self._file
        if self._tries >= self._most or (error.hosts and not self._tries):
            raise error
        left = {n: h for n, h in file.hosts.items() if n not in error.hosts} if file else {}
        if file is not None and not left:
            raise error
        if file is not None:
            self._file = replace(file, hosts=left)

    def _again(self, why: str, tell: Callable[[str], None]) -> None:
        """Prepare an attempt from the last checkpoint. Raises ScenarioError."""
        assert self._kept is not None
        before = self._settings.keeping
        keeping = self._kept.again(self._system, self._folder)
        newer = before is not None and keeping.resumes > before.resumes
        self._tries = 1 if newer else self._tries + 1
        t = keeping.t_ns * 1e-9
        self._notes.append(Remark(t=t, remark=f"{why}; all nodes began again from here"))
        tell(
            f"{why}; all nodes begin again at t = {t:.6g} s (replacement {self._tries} of "
            f"{self._most} before the next checkpoint)"
        )
        starter: RemoteHosts | None = None
        if self._file is not None:
            changes = self._settings.changes
            starter, _ = on_hosts(self._system, self._file, changes, self._folder)
        self._settings = replace(self._settings, keeping=keeping, starter=starter)
