"""Results of an unfinished comparison, in a file of its folder, from which it is continued.

The name of a result is a hash of everything that it follows from: the case with its scenario, what
is measured, the FMUs and versions. So a changed scenario is another result, and none is wrong.
"""

from __future__ import annotations

from base64 import b64decode, b64encode
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar, final

import msgspec
import numpy as np

from cosim.base.copies import replace
from cosim.base.errors import RunError
from cosim.comparison.measure import CaseOutcome, Task, failed_case, run_case
from cosim.comparison.port_columns import PortOutcome, PortTask, run_port
from cosim.record.folder import reason
from cosim.study.store import JOURNAL, Record, ResultJournal

R = TypeVar("R", CaseOutcome, PortOutcome)


@dataclass(frozen=True, slots=True)
class OutcomeRow:
    """The `outcome` of the task with the name `run`; None: its process `died`, for this reason."""

    run: str
    outcome: CaseOutcome | PortOutcome | None
    died: str = ""

    @property
    def reason(self) -> str:
        """The reason why a run has not come to its end."""
        if isinstance(self.outcome, CaseOutcome) and not self.outcome.verdict.ended:
            return self.outcome.verdict.text
        return self.died


def run_task(named: tuple[str, Task | PortTask]) -> OutcomeRow:
    """Run and measure a task with its name; a failure is an outcome with its reason."""
    name, task = named
    return OutcomeRow(name, run_case(task) if isinstance(task, Task) else run_port(task))


@final
class KeptResults:
    """Outcomes in the journal of a folder; a context manager.

    `folder`: None keeps them in memory only; `same`: what all of them follow from besides their
    tasks; `runs`: where run folders stay, None: nowhere. Raises RunError with the path.
    """

    def __init__(
        self, folder: Path | None = None, same: str = "", runs: Path | None = None
    ) -> None:
        self.runs, self._same, self._journal = runs, same, None
        self._rows: dict[str, OutcomeRow] = {}
        self._taken: dict[str, Record] = {}
        try:
            if folder is not None:
                self._journal = ResultJournal(folder / JOURNAL)
        except OSError as error:
            raise RunError(f"cannot use {folder}: {reason(error)}") from error
        self.done = set(self._journal.rows) if self._journal else set[str]()
        self.failed = set[str]()

    def __enter__(self) -> KeptResults:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._journal is not None:
            self._journal.close()

    def take(self, rows: Mapping[str, Record]) -> None:
        """Take rows of the journals of other folders, in memory."""
        self._taken.update(rows)
        self.done |= rows.keys()

    def append(self, row: OutcomeRow) -> None:
        """Take an outcome; that of a process that died is not kept for another time."""
        if self._journal is None or row.outcome is None:
            self._rows[row.run] = row
        else:
            self._journal.append({"run": row.run, "result": _packed(row.outcome)})

    def case(self, name: str, task: Task) -> CaseOutcome:
        """The outcome of a case."""
        row = self._row(name, CaseOutcome)
        found = row.outcome
        return found if isinstance(found, CaseOutcome) else failed_case(task.case, row.died)

    def port(self, name: str) -> PortOutcome:
        """The outcome of a test of a port."""
        row = self._row(name, PortOutcome)
        return row.outcome if isinstance(row.outcome, PortOutcome) else PortOutcome(reason=row.died)

    def _row(self, name: str, kind: type[R]) -> OutcomeRow:
        kept = self._taken.get(name) or (self._journal and self._journal.rows.get(name))
        return OutcomeRow(name, _unpacked(kept["result"], kind)) if kept else self._rows[name]

    def name(self, task: Task | PortTask) -> str:
        """The name of a task's outcome."""
        if isinstance(task, Task):
            task = replace(task, folder=None)
        return sha256(f"{self._same} {task!r}".encode()).hexdigest()[:16]


def _packed(result: CaseOutcome | PortOutcome) -> str:
    return b64encode(msgspec.msgpack.encode(result, enc_hook=_array_as_data)).decode()


def _unpacked(text: str, kind: type[R]) -> R:
    return msgspec.msgpack.decode(b64decode(text), type=kind, dec_hook=_data_as_array)


def _array_as_data(array: Any) -> Any:
    return array.dtype.str, array.tobytes()


def _data_as_array(kind: type, data: Any) -> Any:
    return np.frombuffer(data[1], dtype=data[0])
