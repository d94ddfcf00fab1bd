"""Recorder: takes chunks of the signal vector from the engine and writes them in another thread.

The engine fills a buffer, submits it and takes the next one; a thread selects, transposes and
encodes. The few buffers are allocated once, so memory does not grow with the length of a run (the
index at the end of the Parquet file does: some kilobytes per row group). The data that remains in
the buffers is the flight recorder: the last ticks of *all* signals, recorded or not. It is in a
memory-mapped file (:mod:`cosim.record.live`), so a killed process loses none of it.
"""

from __future__ import annotations

import errno
import os
import queue
import threading
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from math import ceil, isfinite
from pathlib import Path

import numpy as np

from cosim.base.errors import RunError, ScenarioError
from cosim.base.files import Closing
from cosim.record.folder import LIVE, PART, TRAJECTORIES, reason
from cosim.record.groups import GroupWriter, RecordedRows, group_rows
from cosim.record.live import Column, Live, RecordLayout, Rows

__all__ = ["Column", "Recorder"]

#: Buffers: the engine continues to fill some while the thread writes a row group, which takes as
#: long as several of them; no more than hold so many numbers (8 MiB), but a few.
_WAITING, _BUFFERS, _BUFFERS_LEAST = 1 << 20, 8, 3


class Recorder(Closing):
    """Records ticks k0, k0+1, … of a run into ``<folder>/trajectories.parquet``.

    Use::

        with Recorder(folder, columns, h=1e-3, n_signals=120) as recorder:
            rows = recorder.buffer()          # (rows_per_chunk, n_signals), yours to fill
            recorder.submit(rows, k0=0, n=2048)

    Until :meth:`close` the rows are in two other files, from which they are read or recovered where
    the process was killed (:mod:`cosim.record.recover`).

    `columns`: what is recorded, in this order. `h`: base step, s. `start`: the time of tick 0, s.
    `every`: ticks k with k mod every = 0 are kept, and the last one. `ticks`: how many are expected
    in all, by which row groups have their size; 0: not known. `rows_per_chunk`: rows (ticks) of
    a buffer. `keep`: ticks the flight recorder reaches back, at least, if chunks are handed in full
    or a row short of it; the buffers (three or more) are at least as many as that takes.
    `sparse`: only rows that are kept are filled in, and the flight recorder has no others.
    `metadata`: texts for the file's schema metadata, which is part of its bytes. `everything`: what
    a recovery writes into ``last.parquet``.

    Raises ScenarioError for settings that cannot be, RunError with the path if the file cannot
    be created. What fails in the thread (a full disk) is raised as RunError by the next
    :meth:`buffer`, :meth:`submit` or :meth:`close`.
    """

    def __init__(
        self,
        folder: str | Path,
        columns: Sequence[Column],
        *,
        h: float,
        start: float = 0.0,
        n_signals: int,
        rows_per_chunk: int = 2048,
        every: int = 1,
        keep: int = 1000,
        metadata: Mapping[str, str] | None = None,
        everything: Sequence[Column] = (),
        sparse: bool = False,
        ticks: int = 0,
    ) -> None:
        _check(columns, h, n_signals, rows_per_chunk, every, keep)
        self.path = Path(folder) / TRAJECTORIES
        self._columns = tuple(columns)
        self._h, self._every, self._metadata, self._start = h, every, metadata, start
        self._sparse = sparse and every > 1
        self._n_signals = n_signals
        self._next: int | None = None  # tick expected next
        self._failure: BaseException | None = None
        self._closed = False
        self._free: queue.SimpleQueue[Rows] = queue.SimpleQueue()
        self._full: queue.SimpleQueue[tuple[Rows, int, int, bool] | None] = queue.SimpleQueue()
        self._out: list[Rows] = []  # with the engine
        self._held: deque[tuple[Rows, int, int]] = deque()  # handed in, not yet reused
        waiting = _WAITING // max(1, rows_per_chunk * n_signals)
        self._buffers = max(
            min(_BUFFERS, 1 + waiting), _BUFFERS_LEAST, 1 + ceil(keep / max(1, rows_per_chunk - 1))
        )
        layout = RecordLayout(
            self._columns, h, every, n_signals, rows_per_chunk, self._buffers,
            group_rows(len(columns), ticks // every), metadata or {}, tuple(everything),
            self._sparse, start,
        )  # fmt: skip
        self._live, self._writer = self._create(layout)
        self._chunks = list(self._live.chunks)
        for rows in self._chunks:
            self._free.put(rows)
        self._thread = threading.Thread(target=self._write, name="recorder", daemon=True)
        self._thread.start()

    def _create(self, layout: RecordLayout) -> tuple[Live, GroupWriter]:
        """Open the files here, so that a folder that is not writable fails immediately.

        This also imports pyarrow before the run: during the run, the import would delay every
        callback of the engine to Python.
        """
        folder = self.path.parent
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if self.path.exists():
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
            live = Live.create(folder / LIVE, layout)
        except OSError as error:
            raise RunError(f"cannot write {self.path}: {reason(error)}") from error
        try:
            writer = GroupWriter(
                folder / PART, layout.columns, h=layout.h, every=layout.every,
                metadata=layout.metadata, live=live, sparse=layout.sparse, start=layout.start,
            )  # fmt: skip
        except OSError as error:
            live.release()
            for name in (LIVE, PART):
                (folder / name).unlink(missing_ok=True)
            raise RunError(f"cannot write {self.path}: {reason(error)}") from error
        return live, writer

    # ---- the engine's side -------------------------------------------------------------------

    def buffer(self) -> Rows:
        """A buffer to fill, (rows_per_chunk, n_signals); waits until one has been written.

        Its earlier content is no longer in the flight recorder.
        """
        self._raise_failure()
        if len(self._out) == self._buffers:
            raise RunError(
                f"all {self._buffers} buffers of the recorder are used; submit one first"
            )
        rows = self._free.get()
        self._raise_failure()
        self._held = deque(entry for entry in self._held if entry[0] is not rows)
        self._live.spans[self._place(rows), 1] = 0
        self._out.append(rows)
        return rows

    def begin(self, buffer: Rows, k0: int) -> int:
        """Mark `buffer` as filled from tick `k0` on; return the address of its row count (int64).

        Rows that are counted there as they arrive are not lost if the process is killed.
        """
        place = self._place(buffer)
        self._live.spans[place, 0] = k0
        return self._live.address(place)

    def _place(self, buffer: Rows) -> int:
        """The number of the chunk."""
        return next(i for i, rows in enumerate(self._chunks) if rows is buffer)

    def submit(self, buffer: Rows, k0: int, n: int, *, last: bool = False) -> None:
        """Hand over a buffer: its first `n` rows are ticks `k0` … `k0`+n-1, following the last.

        `last`: no other rows follow, and the last one is to be kept.
        """
        place = next((i for i, rows in enumerate(self._out) if rows is buffer), None)
        if place is None or self._closed:
            raise RunError("a buffer was submitted that this recorder did not provide")
        if not 0 <= n <= len(buffer):
            raise RunError(f"found {n} rows to record, expected 0 to {len(buffer)}")
        if k0 < 0 or self._next not in (None, k0):
            raise RunError(f"found a chunk from tick {k0}, expected tick {self._next or 0}")
        del self._out[place]
        self._next = k0 + n
        span = self._live.spans[self._place(buffer)]
        span[0] = k0
        span[1] = n
        self._held.append((buffer, k0, n))
        self._raise_failure()
        self._full.put((buffer, k0, n, last))

    def settle(self) -> RecordedRows:
        """Wait until all rows that were submitted are in the file or in the row group; the rows.

        Raises RunError.
        """
        waiting = self._buffers - len(self._out)
        for rows in [self._free.get() for _ in range(waiting)]:
            self._free.put(rows)
        self._raise_failure()
        try:
            return self._writer.recorded
        except OSError as error:
            raise RunError(f"cannot write {self.path}: {reason(error)}") from error

    def resume(self, groups: Iterable[Rows], rest: Rows, k0: int) -> None:
        """Begin with the rows of an earlier recording (:meth:`settle`), before the first buffer:
        its full row groups and the rest; the next tick is `k0`.

        Raises RunError, ScenarioError for row groups that cannot be read.
        """
        try:
            self._writer.take(groups, rest)
        except OSError as error:
            raise RunError(f"cannot write {self.path}: {reason(error)}") from error
        self._next = k0

    def close(self) -> None:
        """Write the rest and the footer. Later calls do nothing. Raises RunError."""
        if self._closed:
            return
        self._closed = True
        self._full.put(None)
        self._thread.join()
        self._live.release()
        self._raise_failure()
        try:
            os.replace(self.path.with_name(PART), self.path)
            self.path.with_name(LIVE).unlink(missing_ok=True)
        except OSError as error:
            raise RunError(f"cannot write {self.path}: {reason(error)}") from error

    def _raise_failure(self) -> None:
        if self._failure is not None:
            error = RunError(f"cannot write {self.path}: {reason(self._failure)}")
            error.saved = str(self.path.parent)
            raise error from self._failure

    # ---- flight recorder ---------------------------------------------------------------------

    def last(self, n: int) -> tuple[int, Rows]:
        """First tick and rows (≤ n, n_signals) of the last `n` ticks handed in, all signals.

        Reaches back `keep` ticks at least. Works after :meth:`close` and after any
        failure. Without a tick: (0, no rows).
        """
        parts: list[Rows] = []
        first = self._next or 0
        for rows, k0, count in reversed(self._held):
            if n <= 0:
                break
            start = max(count - n, 0)
            parts.append(rows[start:count])
            first = k0 + start
            n -= count - start
        if not parts:
            return first, np.empty((0, self._n_signals))
        return first, np.concatenate(parts[::-1])

    def save_last(self, path: str | Path, n: int, columns: Sequence[Column] | None = None) -> Path:
        """Write :meth:`last` as Parquet: `columns` of the signal vector (default the recorded).

        Raises RunError with the path; then no part of it is left.
        """
        path = Path(path)
        k0, rows = self.last(n)
        chosen = self._columns if columns is None else tuple(columns)
        try:
            every = self._every if self._sparse else 1
            writer = GroupWriter(
                path, chosen, h=self._h, every=every, metadata=self._metadata,
                sparse=self._sparse, start=self._start,
            )  # fmt: skip
            writer.add(rows, k0)
            writer.close()
        except OSError as error:
            path.unlink(missing_ok=True)
            raise RunError(f"cannot write {path}: {reason(error)}") from error
        return path

    # ---- the thread's side -------------------------------------------------------------------

    def _write(self) -> None:
        """Write chunks until the end, and accept them after a failure, too: the engine waits.

        A chunk is returned for reuse when all its rows are in the row group or the file.
        """
        chunk: tuple[Rows, int, int, bool] | None = None
        try:
            while (chunk := self._full.get()) is not None:
                rows, k0, n, last = chunk
                self._writer.add(rows[:n], k0, last=last)
                self._free.put(rows)
            self._writer.close()
        except Exception as error:
            self._failure = error
            if chunk is not None:
                self._free.put(chunk[0])  # who waits for it sees the failure first
            self._writer.abandon()
            self._drain()

    def _drain(self) -> None:
        while not self._closed and (chunk := self._full.get()) is not None:
            self._free.put(chunk[0])


def _check(
    columns: Sequence[Column], h: float, n_signals: int, rows: int, every: int, keep: int
) -> None:
    """Refuse settings that cannot be, in a sentence."""
    if not (isfinite(h) and h > 0):
        raise ScenarioError(f"found the base step {h} s, expected one above 0", "record.h")
    for name, value, least in (
        ("every", every, 1),
        ("rows_per_chunk", rows, 1),
        ("keep", keep, 0),
        ("n_signals", n_signals, 0),
    ):
        if value < least:
            raise ScenarioError(f"found {value}, expected {least} or more", f"record.{name}")
    names = {"t"}
    for column in columns:
        if column.name in names:
            raise ScenarioError(f"the column {column.name!r} is listed twice", "record.columns")
        if not 0 <= column.index < n_signals:
            raise ScenarioError(
                f"the column {column.name!r} is entry {column.index} of the signal vector, "
                f"which has {n_signals}",
                "record.columns",
            )
        names.add(column.name)
