"""Recorded data that is not in a file yet, in a memory-mapped file that outlives the process.

``trajectories.live`` is mapped into memory. It contains in this order: a header of 64 bytes; a JSON
text that describes the recording; for each chunk of the engine its first tick and its number of
rows; the row group that is being filled; the chunks. The engine writes each row directly into the
mapping and then counts it, so a killed process loses no counted row: the pages belong to the
kernel. Complete row groups are in ``trajectories.parquet.part``, which has no footer yet. Both
files are removed when the recording is closed.
"""

from __future__ import annotations

import json
import mmap
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self, final

import numpy as np
from numpy.typing import NDArray

from cosim.base.convert import Struct, field
from cosim.base.copies import field_names
from cosim.base.errors import ScenarioError

Rows = NDArray[np.float64]
MAGIC, HEADER, PAGE = b"cosimlv1", 64, 4096
#: Bytes of a new file that get their memory at once, which takes a seventh of the time of one page
#: after the other, when they are first touched (8 MiB: 1.5 ms of 10.5 ms, ext4, Linux 6.18).
_AT_HAND, _ZEROS = 1 << 24, memoryview(bytes(1 << 20))
_COLUMNS = ("columns", "everything")


class Column(Struct, frozen=True):
    """A recorded scalar: its name (``master.q[0]``), unit and index in the signal vector."""

    name: str
    unit: str
    index: int


class RecordLayout(Struct, frozen=True):
    """The recorded columns, and the sizes of the arrays that hold them.

    `columns`: those of the trajectories; `everything`: those of ``last.parquet``; `h`: base step,
    s; `every`: ticks between two rows that are kept; `rows`: of a chunk; `group`: rows of a row
    group; `sparse`: other rows than those that are kept are not filled in;
    `start`: the time of tick 0, s.
    """

    columns: tuple[Column, ...]
    h: float
    every: int
    n_signals: int
    rows: int
    chunks: int
    group: int
    metadata: Mapping[str, str] = field(default_factory=dict)
    everything: tuple[Column, ...] = ()
    sparse: bool = False
    start: float = 0.0

    def text(self) -> bytes:
        """The layout as JSON; a column is a list of three, which is quicker than an object."""
        said = {name: getattr(self, name) for name in field_names(self)}
        lists = {key: [(c.name, c.unit, c.index) for c in said[key]] for key in _COLUMNS}
        return json.dumps({**said, **lists, "metadata": dict(self.metadata)}).encode()

    @classmethod
    def parse(cls, text: bytes) -> Self:
        """The layout that :meth:`text` wrote. Raises ValueError, TypeError or KeyError for another
        text.
        """
        said: dict[str, Any] = json.loads(text)
        lists = {key: tuple(Column(*column) for column in said[key]) for key in _COLUMNS}
        return cls(**{**said, **lists})

    def times(self, ticks: NDArray[np.int64]) -> NDArray[np.float64]:
        """The time (n,), s, of each of `ticks` (n,)."""
        times: NDArray[np.float64] = self.start + ticks * np.float64(self.h)
        return times

    def ticks(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """The tick (n,), a whole number, at each of `times` (n,), s."""
        found: NDArray[np.float64] = np.rint((times - self.start) / self.h)
        return found

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Bytes of the counts of chunks, of the row group, and of all chunks."""
        values = self.chunks * self.rows * self.n_signals
        return 16 * self.chunks, 8 * self.group * (len(self.columns) + 1), 8 * values


@final
class Live:
    """The arrays of a recording.

    `counts`: (written, filled): rows in complete row groups in the file, and rows in `group`;
    `spans`: (chunks, 2), the first tick and the number of rows of each chunk; `group`: (columns
    + 1, rows), row 0 is t; `chunks`: (chunks, rows, n_signals).
    """

    def __init__(self, layout: RecordLayout, memory: Any, text: int, held: int = -1) -> None:
        self.layout, self._held = layout, held
        start = -(-(HEADER + text) // PAGE) * PAGE
        spans, group, chunks = layout.sizes
        self.counts: NDArray[np.int64] = np.frombuffer(memory, np.int64, 2, 16)
        self.spans = np.frombuffer(memory, np.int64, spans // 8, start).reshape(-1, 2)
        start += spans
        self.group: Rows = np.frombuffer(memory, np.float64, group // 8, start)
        self.group = self.group.reshape(-1, layout.group)
        start += group
        shape = (layout.chunks, layout.rows, layout.n_signals)
        self.chunks: Rows = np.frombuffer(memory, np.float64, chunks // 8, start).reshape(shape)

    @classmethod
    def create(cls, path: Path, layout: RecordLayout) -> Self:
        """A new file. Raises OSError; then there is no file."""
        text = layout.text()
        start = -(-(HEADER + len(text)) // PAGE) * PAGE
        memory, held = map_new_file(path, start + sum(layout.sizes))
        memory[8:16] = len(text).to_bytes(8, sys.byteorder)
        memory[HEADER : HEADER + len(text)] = text
        memory[:8] = MAGIC  # last: a file without it says nothing
        return cls(layout, memory, len(text), held)

    @classmethod
    def read(cls, path: Path) -> Self:
        """The arrays that a process has left. Raises ScenarioError where it is damaged."""
        try:
            data = path.read_bytes()
            text = int.from_bytes(data[8:16], sys.byteorder)
            if data[:8] != MAGIC:
                raise ValueError(f"begins with {data[:8]!r}, expected {MAGIC!r}")
            return cls(RecordLayout.parse(data[HEADER : HEADER + text]), data, text)
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise ScenarioError(f"cannot be read: {error}", str(path)) from error

    def release(self) -> None:
        """Mark the recording as ended; see :func:`in_use`."""
        unlock(self._held)
        self._held = -1

    def address(self, chunk: int) -> int:
        """The address of the number of rows of a chunk, for the engine."""
        return int(self.spans[chunk].ctypes.data) + self.spans.itemsize


def map_new_file(path: Path, size: int) -> tuple[mmap.mmap, int]:
    """Create a file of `size` bytes (zeros), mapped and shared, with its disk space allocated.

    A full disk is therefore an error here and not a SIGBUS later. The descriptor that is returned
    holds a lock until it is closed, or the process has ended. Raises OSError; then there is no
    file. On Windows, where a file in use cannot be deleted, it is memory of this process only.
    """
    if sys.platform == "win32":
        return mmap.mmap(-1, size), -1
    import fcntl

    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if sys.platform == "linux":
            os.posix_fallocate(descriptor, 0, size)
            for at in range(0, min(size, _AT_HAND), len(_ZEROS)):
                os.pwrite(descriptor, _ZEROS[: size - at], at)
        else:
            os.truncate(descriptor, size)
        return mmap.mmap(descriptor, size), descriptor
    except BaseException:
        path.unlink(missing_ok=True)
        os.close(descriptor)
        raise


def unlock(descriptor: int) -> None:
    """Unlock a file that was locked as in :func:`map_new_file`; -1: there is none.

    Closing is not enough, because Python's mmap has a separate descriptor of the same open file.
    """
    if sys.platform == "win32" or descriptor < 0:
        return
    import fcntl

    fcntl.flock(descriptor, fcntl.LOCK_UN)
    os.close(descriptor)


def in_use(path: Path) -> bool:
    """True if a process still records into this file."""
    if sys.platform == "win32" or not path.exists():
        return False
    import fcntl

    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False
