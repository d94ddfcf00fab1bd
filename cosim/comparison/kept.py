"""Results of an unfinished comparison, in a file of its folder, from which it is continued.

The name of a result is a hash of everything that it follows from: the case with its scenario, what
is measured, the FMUs and versions. So a changed scenario is another result, and none is wrong.
"""

from __future__ import annotations

from base64 import b64decode, b64encode
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar, final

import msgspec
import numpy as np

from cosim.base.errors import RunError
from cosim.base.processes import Opened
from cosim.comparison.measure import CaseOutcome, Task
from cosim.comparison.port_columns import PortOutcome, PortTask
from cosim.record.folder import reason
from cosim.study.runner import perform
from cosim.study.store import JOURNAL, ResultJournal

T = TypeVar("T", Task, PortTask)
R = TypeVar("R", CaseOutcome, PortOutcome)


@final
class KeptResults:
    """Results in the journal of a folder; a context manager.

    `folder`: None keeps no results; `same`: what all of them follow from besides their tasks;
    `runs`: where run folders stay, None: nowhere. Raises RunError with the path.
    """

    def __init__(
        self, folder: Path | None = None, same: str = "", runs: Path | None = None
    ) -> None:
        self.runs, self._same, self._journal = runs, same, None
        try:
            if folder is not None:
                self._journal = ResultJournal(folder / JOURNAL)
        except OSError as error:
            raise RunError(f"cannot use {folder}: {reason(error)}") from error

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

    def results(
        self, function: Callable[[T], R], tasks: Sequence[T], kind: type[R], opened: Opened | None
    ) -> Iterator[tuple[T, R | str]]:
        """(task, result): first those that are kept, then others as they are done.

        A text instead of the result if the process of a task died, which is not kept.
        """
        rows, missing = self._journal.rows if self._journal else {}, dict[str, T]()
        for task in tasks:
            name = self._name(task)
            if name in rows:
                yield task, _unpacked(rows[name]["result"], kind)
            else:
                missing[name] = task
        names = {id(task): name for name, task in missing.items()}
        for task, result in perform(function, list(missing.values()), opened):
            if self._journal is not None and not isinstance(result, str):
                self._journal.append({"run": names[id(task)], "result": _packed(result)})
            yield task, result

    def _name(self, task: Task | PortTask) -> str:
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
