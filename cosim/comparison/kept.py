"""Results of an unfinished comparison, in a file of its folder, from which it is continued.

The name of a result is a hash of everything that it follows from: the case with its scenario, what
is measured, the FMUs and versions. So a changed scenario is another result, and none is wrong.
"""

from __future__ import annotations

from base64 import b64decode, b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from types import TracebackType
from typing import Any, TypeVar, final
from weakref import finalize

import msgspec
import numpy as np

from cosim.base.copies import replace
from cosim.base.errors import RunError
from cosim.comparison.measure import CaseOutcome, Task, failed_case, run_case
from cosim.comparison.port_columns import PortOutcome, PortTask, run_port
from cosim.comparison.same_links import KEPT, RecordedTable
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

    `folder`: None keeps them in memory only, and their tables in files that are deleted with it;
    `same`: what all of them follow from besides their tasks; `runs`: where run folders stay, None:
    nowhere; `tables`: where the tables of links stay. Raises RunError with the path.
    """

    def __init__(
        self, folder: Path | None = None, same: str = "", runs: Path | None = None
    ) -> None:
        self.runs, self._same, self._journal = runs, same, None
        if folder is None:
            self.tables = Path(mkdtemp(prefix="cosim-tables-"))
            finalize(self, rmtree, self.tables, ignore_errors=True)
        else:
            self.tables = folder / KEPT
        self._folders = [self.tables]
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

    def take(self, rows: Mapping[str, Record], folders: Sequence[Path]) -> None:
        """Take rows of the journals of other folders, in memory; their tables stay there."""
        self._folders += [folder / KEPT for folder in folders]
        self._taken.update(rows)
        self.done |= rows.keys()

    def append(self, row: OutcomeRow) -> None:
        """Take an outcome; that of a process that died is not kept for another time."""
        if self._journal is None or row.outcome is None:
            self._rows[row.run] = row
        else:
            self._journal.append({"run": row.run, "result": _packed(row.outcome)})

    def case(self, name: str, task: Task) -> CaseOutcome:
        """The outcome of a case. Raises RunError if a table that it recorded is not there."""
        row = self._row(name, CaseOutcome)
        found = row.outcome
        if not isinstance(found, CaseOutcome):
            return failed_case(task.case, row.died)
        return replace(found, tables=tuple(replace(x, path=self._at(x)) for x in found.tables))

    def _at(self, table: RecordedTable) -> Path:
        """The file of a table; folders may have been moved or copied since it was recorded."""
        for folder in self._folders:
            if (path := folder / table.path.name).is_file():
                return path
        folders = ", ".join(map(str, self._folders))
        raise RunError(
            f"no {table.path.name}, the table of {table.channel}, in {folders}; expected all files"
            " of the folder, or begin again with --force"
        )

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
            task = replace(task, folder=None, tables=Path())
        return sha256(f"{self._same} {task!r}".encode()).hexdigest()[:16]


def _packed(result: CaseOutcome | PortOutcome) -> str:
    return b64encode(msgspec.msgpack.encode(result, enc_hook=_as_data)).decode()


def _unpacked(text: str, kind: type[R]) -> R:
    return msgspec.msgpack.decode(b64decode(text), type=kind, dec_hook=_from_data)


def _as_data(what: Any) -> Any:
    """An array or a path as plain data."""
    return what.name if isinstance(what, Path) else (what.dtype.str, what.tobytes())


def _from_data(kind: type, data: Any) -> Any:
    return Path(data) if kind is Path else np.frombuffer(data[1], dtype=data[0])
