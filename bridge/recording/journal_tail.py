"""A journal that is being written, read by another process without mapping or locking it.

A writer that ends truncates its file, and a process that has mapped the file would receive SIGBUS
when it reads beyond the end. This module uses ``pread``, which returns fewer bytes instead.
"""

from __future__ import annotations

import os
from io import FileIO
from pathlib import Path
from typing import Any, Self, final

import numpy as np
from numpy.typing import NDArray

from bridge.native.journal import HEADER, MAGIC, VERSION, JournalError, JournalStruct, row_of

Rows = NDArray[np.void]


@final
class JournalTail:
    """The rows of a journal so far. Raises JournalError if the file is not a journal (yet)."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._opened = FileIO(path)  # closed with the last that has it
        except OSError as error:
            raise JournalError(
                f"{path}: {os.strerror(error.errno or 0)}; expected a journal"
            ) from error
        self._file = self._opened.fileno()
        try:
            header = self._header()
            end = HEADER + header.capacity * header.row_size
            text = os.pread(self._file, header.description, end)
            self.row: np.dtype[Any] = row_of(path, text, header.row_size)
        except BaseException:
            self._opened.close()
            raise

    def _header(self) -> JournalStruct:
        raw = os.pread(self._file, HEADER, 0)
        if len(raw) < HEADER or raw[:8] != MAGIC:
            raise JournalError(f"{self.path}: begins with {raw[:8]!r}; a journal with {MAGIC!r}")
        header = JournalStruct.from_buffer_copy(raw)
        if header.version != VERSION:
            raise JournalError(
                f"{self.path}: a journal of version {header.version}; expected {VERSION}"
            )
        return header

    def __len__(self) -> int:
        """Rows written so far; 0 where the file has been emptied meanwhile."""
        raw = os.pread(self._file, HEADER, 0)
        return int(JournalStruct.from_buffer_copy(raw).rows) if len(raw) == HEADER else 0

    @property
    def closed(self) -> bool:
        """True if its writer has ended normally; a full journal looks the same."""
        header = self._header()
        return bool(header.rows == header.capacity)

    @property
    def dropped(self) -> int:
        """Rows that did not fit."""
        return int(self._header().dropped)

    def rows(self, first: int, last: int) -> Rows:
        """Rows `first` to `last` (exclusive), as many of them as are there; (n,), a copy."""
        first, size = max(first, 0), self.row.itemsize
        n = max(0, min(last, len(self)) - first)
        raw = os.pread(self._file, n * size, HEADER + first * size)
        return np.frombuffer(raw[: len(raw) // size * size], self.row)

    def newest(self, n: int) -> Rows:
        """The last `n` rows, or all; (n,)."""
        count = len(self)
        return self.rows(count - n, count)

    def since(self, field: str, span: int) -> Rows:
        """Return the rows (n,) whose `field`, which ascends, is within `span` of the last one's."""
        n = 1024
        while True:
            found = self.newest(n)
            if not len(found) or n > len(found) or found[field][0] <= found[field][-1] - span:
                return found[found[field] > found[field][-1] - span] if len(found) else found
            n *= 2

    def close(self) -> None:
        """Let go of the file."""
        self._opened.close()
        self._file = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
