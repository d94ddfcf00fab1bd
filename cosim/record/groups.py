"""Rows of the signal vector in, Parquet row groups of fixed size out.

Settings, measured on a teleoperation run (60 001 rows, 43 columns; processor time of the encoder
alone, the best of nine, in turns): no compression 13 ms and 20.7 MB, Snappy 17 ms and 7.8 MB, LZ4
18 ms and 7.6 MB, Zstandard (level 1) 28 ms and 5.8 MB; splitting the bytes of the numbers
(BYTE_STREAM_SPLIT) adds 10 ms and saves little or nothing, because held signals repeat. Snappy is
what every reader has. Dictionaries and statistics of the signals are off; the statistics of ``t``
let readers skip row groups. A column of a row group costs about 9 µs beside its numbers, so row
groups are not smaller than they have to be for the engine not to wait for one; a file written
through a buffer takes a fifth less than one call of the system a page.

NumPy arrays become Arrow arrays, and these NumPy arrays, without Arrow's own conversions:
``pyarrow.array(ndarray)`` and ``to_numpy()`` import pandas wherever it is installed, which takes
longer than a short run; ``numpy.ma`` takes 10 ms.
"""

from __future__ import annotations

import ctypes as c
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.base.convert import Struct
from cosim.native.shared import library
from cosim.native.structs import RecordingStruct
from cosim.record.live import Column, Live, Rows

#: How files of trajectories are written.
SETTINGS: Mapping[str, Any] = {
    "compression": "snappy",
    "use_dictionary": False,
    "write_statistics": ["t"],
    "write_batch_size": 1 << 16,
}
#: Values in a row group, at most (4 MiB), and the limits of its rows.
_GROUP_VALUES, _GROUP_LEAST, _GROUP_MOST = 1 << 19, 1 << 10, 1 << 16
#: The row groups of a long recording are larger, up to so many values (64 MiB) and rows, so that
#: there are not many: a column of a row group takes 2 KB of memory in whoever writes or reads it.
_MANY, _LARGE_VALUES, _LARGE_MOST = 256, 1 << 23, 1 << 17
_BUFFER = 1 << 20  # bytes on their way to the file
_TYPES = {np.dtype(np.float64): "float64", np.dtype(np.int32): "int32"}


def group_rows(n_columns: int, expected: int = 0) -> int:
    """Rows in a full row group of `n_columns` signals: a power of two near 4 MiB.

    It is up to 16 times as much where so many rows are `expected` that there would be very many.
    """
    fit = _GROUP_VALUES // (n_columns + 1)
    rows = max(_GROUP_LEAST, min(_GROUP_MOST, 1 << (max(fit, 1).bit_length() - 1)))
    largest = min(_LARGE_MOST, _LARGE_VALUES // (n_columns + 1))
    while _MANY * rows < expected and 2 * rows <= largest:
        rows *= 2
    return rows


def schema(columns: Sequence[Column], h: float, every: int, metadata: Mapping[str, str]) -> Any:
    """The schema of a file of trajectories: ``t`` and the columns, each with its unit."""
    import pyarrow as pa

    named = [("t", "s"), *((column.name, column.unit) for column in columns)]
    return pa.schema(
        [pa.field(n, pa.float64(), nullable=False, metadata={"unit": u}) for n, u in named],
        metadata={"h": repr(h), "every": str(every), **metadata},
    )


def batch(values: NDArray[np.float64], fields: Any) -> Any:
    """Return an Arrow batch that shares `values` (columns, rows), in the units of the columns."""
    import pyarrow as pa

    return pa.RecordBatch.from_arrays([arrow(column) for column in values], schema=fields)


class RecordedRows(Struct, frozen=True):
    """A recording at one moment: `written` rows are in full row groups of its file, of `group` rows
    each; `rest` (columns + 1, k): those after them, row 0 is t.
    """

    written: int
    group: int
    rest: Rows


class GroupWriter:
    """One Parquet file: ``t`` and the columns, every `every`-th tick and the last one.

    `sparse`: other rows than these are not filled in, and the last one only where that is said.
    `start`: the time of tick 0, s; `live`: has the row group that is filled, of its size.

    Boundaries of row groups depend on the number of rows and on that size only, so the same rows
    give the same bytes however they were cut into chunks. Not thread-safe; errors of the file pass
    through.
    """

    def __init__(
        self,
        path: Path,
        columns: Sequence[Column],
        *,
        h: float,
        every: int = 1,
        metadata: Mapping[str, str] | None = None,
        live: Live | None = None,
        sparse: bool = False,
        start: float = 0.0,
    ) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        self._every, self._sparse = every, sparse
        self._index = np.array([column.index for column in columns], dtype=np.int64)
        n = len(columns)
        self._group = np.empty((n + 1, group_rows(n))) if live is None else live.group
        self._rows = self._group.shape[1]
        # rows written, rows in the group
        self._counts = np.zeros(2, np.int64) if live is None else live.counts
        self._columns = RecordingStruct(
            columns=self._group.ctypes.data, room=self._rows, n_columns=len(columns),
            index=self._index.ctypes.data, every=every, h=h, start=start,
        )  # fmt: skip
        self._pending: tuple[int, Rows] | None = None  # last tick so far, if not on the grid
        self._schema = schema(columns, h, every, metadata or {})
        self._path = path
        self._file: Any = pa.BufferedOutputStream(pa.OSFile(str(path), "wb"), _BUFFER)
        self._writer: Any = pq.ParquetWriter(self._file, self._schema, **SETTINGS)

    @property
    def recorded(self) -> RecordedRows:
        """The rows so far: those in the file, which is brought to the disk, and the others."""
        with open(self._path, "rb") as file:
            os.fsync(file.fileno())
        written, filled = (int(n) for n in self._counts)
        return RecordedRows(written, self._rows, self._group[:, :filled].copy())

    def take(self, groups: Iterable[Rows], rest: Rows) -> None:
        """Begin with rows of an earlier recording: full row groups (columns + 1, rows), and the
        `rest` (columns + 1, k); row 0 is t.
        """
        for group in chain(groups, (rest,)):
            n = group.shape[1]
            self._group[:, :n] = group
            self._counts[1] = n
            if n == self._rows:
                self._flush()

    def add(self, rows: Rows, k0: int, *, last: bool = False) -> None:
        """Take `rows` (n, n_signals), signals at ticks k0 … k0+n-1; `last`: there are no more."""
        if not len(rows):
            return
        first = -k0 % self._every
        self._put(rows[first :: self._every], k0 + first)
        newest = k0 + len(rows) - 1
        kept = newest % self._every != 0 and (last or not self._sparse)
        self._pending = (newest, rows[-1:].copy()) if kept else None

    def _put(self, rows: Rows, k0: int) -> None:
        """Take rows on the grid: ticks k0, k0 + every and so on."""
        if rows.strides[1] != rows.itemsize:  # a row is one piece of memory
            rows = np.ascontiguousarray(rows)
        take, columns = library().recording_take, c.addressof(self._columns)
        stride, done = rows.strides[0] // rows.itemsize, 0
        while done < len(rows):
            fill = self._fill
            n = min(len(rows) - done, self._rows - fill)
            tick = k0 + self._every * done
            take(columns, rows[done:].ctypes.data, stride, n, tick, fill)
            self._counts[1] = fill + n  # after the rows themselves: a reader counts on it
            done += n
            if self._fill == self._rows:
                self._flush()

    @property
    def _fill(self) -> int:
        """Rows in the group so far."""
        return int(self._counts[1])

    def _flush(self) -> None:
        fill = self._fill
        self._writer.write_batch(batch(self._group[:, :fill], self._schema), self._rows)
        self._file.flush()  # before it is counted: a reader relies on it
        self._counts[0] += fill
        self._counts[1] = 0

    def close(self) -> None:
        """Write what is left, the last tick included, and the footer."""
        if self._pending is not None:
            last, row = self._pending
            self._pending = None
            self._put(row, last)
        if self._fill:
            self._flush()
        self._writer.close()
        self._file.close()

    def abandon(self) -> None:
        """Let go of the file after a failure, whatever state it is in."""
        for item in (self._writer, self._file):
            with suppress(Exception):
                item.close()


def arrow(values: NDArray[Any]) -> Any:
    """An Arrow array of `values` (n,), float64 or int32, contiguous, as they lie there."""
    import pyarrow as pa

    kind = getattr(pa, _TYPES[values.dtype])()
    return pa.Array.from_buffers(kind, len(values), [None, pa.py_buffer(values)])


def numpy(column: Any, dtype: type[np.float64] | type[np.int32]) -> NDArray[Any]:
    """Return a copy (n,) of a column of a table in its unit, cast to `dtype` if necessary.

    Null becomes NaN; in an integer column it raises ValueError (pyarrow.ArrowInvalid).
    """
    import pyarrow as pa

    kind = getattr(pa, _TYPES[np.dtype(dtype)])()
    if column.type != kind:  # a cast imports pyarrow.compute, as long as the rest of pyarrow
        column = column.cast(kind)
    if column.null_count:
        import pyarrow.compute as pc

        if dtype is not np.float64:
            raise pa.ArrowInvalid(f"{column.null_count} values are null; expected integers")
        column = pc.fill_null(column, float("nan"))
    whole = np.empty(len(column), dtype)
    at = 0
    for chunk in column.chunks:
        first = chunk.offset * whole.itemsize
        there = np.frombuffer(chunk.buffers()[1], dtype, len(chunk), first)
        whole[at : at + len(chunk)] = there
        at += len(chunk)
    return whole
