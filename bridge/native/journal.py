"""Rows of one kind in a file mapped into memory (``bridge/c/journal.h``).

C (:attr:`Journal.address`) or Python (:meth:`Journal.append`) appends rows. Readers see all rows
written so far, even after the writer was killed, because the rows are in the page cache. The
description of the rows follows the last row, so the file is self-describing. The writer holds a
lock on the file, by which :func:`cosim.record.live.in_use` detects that it is still being written.
"""

from __future__ import annotations

import ast
import ctypes as c
import errno
import mmap
import os
import sys
from pathlib import Path
from typing import Any, Self, final

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import CosimError
from cosim.record.live import unlock

MAGIC, VERSION, HEADER = b"cosimjnl", 1, 64
Rows = NDArray[np.void]


class JournalError(CosimError, ValueError):
    """A file is not a journal, or a journal cannot be created."""


class JournalStruct(c.Structure):
    """``journal_t``: the first 64 bytes."""

    _fields_ = (
        ("magic", c.c_char * 8),
        ("version", c.c_uint32),
        ("row_size", c.c_uint32),
        ("capacity", c.c_uint64),
        ("rows", c.c_uint64),
        ("dropped", c.c_uint64),
        ("description", c.c_uint64),
        ("reserved", c.c_uint64 * 2),
    )


@final
class Journal:
    """A journal that is being written, by one writer. `create` makes it, `open` reads one."""

    def __init__(self, path: Path, memory: mmap.mmap, row: np.dtype[Any], lock: int = -1) -> None:
        self.path, self._lock = path, lock
        self._memory, self._closed = memory, False
        self.struct = JournalStruct.from_buffer(memory)
        capacity = int(self.struct.capacity)
        self._rows: Rows = np.frombuffer(memory, row, capacity, HEADER)

    @classmethod
    def create(cls, path: Path | str, row: np.dtype[Any], capacity: int) -> Self:
        """A new file for `capacity` rows, whose pages are in memory before the first row is
        written.

        The disk space is allocated immediately, so a full disk is an error here and not a SIGBUS
        later. Raises JournalError if the file cannot be created or space is missing.
        """
        path = Path(path)
        if capacity < 1 or row.itemsize < 1:
            found = f"{capacity} rows of {row.itemsize} bytes"
            raise JournalError(f"{path}: {found}; expected at least one row of one byte")
        text = repr(np.lib.format.dtype_to_descr(row)).encode()
        end = HEADER + capacity * row.itemsize
        memory, lock = _new_file(path, end + len(text))
        memory[end : end + len(text)] = text
        header = JournalStruct(
            version=VERSION, row_size=row.itemsize, capacity=capacity, description=len(text)
        )
        memory[:HEADER] = bytes(header)
        memory[:8] = MAGIC  # last: a file without it is not one
        return cls(path, memory, row, lock)

    @staticmethod
    def open(path: Path | str) -> Rows:
        """The rows written so far, read-only, (rows,), with the fields given to `create`.

        Raises JournalError if the file is not a journal, is truncated, or has another version.
        """
        path = Path(path)
        try:
            with path.open("rb") as file:
                memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            raise JournalError(f"{path}: {error}; expected a journal") from error
        header = _header(path, memory)
        end = HEADER + header.capacity * header.row_size
        row = row_of(path, memory[end : end + header.description], header.row_size)
        return np.frombuffer(memory, row, header.rows, HEADER)

    @property
    def address(self) -> int:
        """Of `journal_t`, for C; valid until `close`."""
        return c.addressof(self.struct)

    @property
    def dropped(self) -> int:
        """Rows that did not fit."""
        return int(self.struct.dropped)

    @property
    def rows(self) -> Rows:
        """Return a view (n,) of the rows written so far."""
        return self._rows[: len(self)]

    def append(self, *values: object) -> bool:
        """One row; False: full (counted). Raises ValueError for values that do not fit a row."""
        n = len(self)
        if n >= self.struct.capacity:
            self.struct.dropped += 1
            return False
        self._rows[n] = values
        self.struct.rows = n + 1
        return True

    def close(self) -> None:
        """Truncate the file to the rows written, and unmap it. Views of `rows` must no longer be in
        use.

        A bus that still has it as its log counts further frames as dropped.
        """
        if self._closed:
            return
        self._closed = True
        size = int(self.struct.row_size)
        used, end = HEADER + len(self) * size, HEADER + int(self.struct.capacity) * size
        description = self._memory[end : end + int(self.struct.description)]
        self.struct.capacity = len(self)
        self._memory[used : used + len(description)] = description
        try:
            os.truncate(self.path, used + len(description))
        finally:
            unlock(self._lock)

    def __len__(self) -> int:
        return int(self.struct.rows)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _new_file(path: Path, size: int) -> tuple[mmap.mmap, int]:
    """An empty file of `size` bytes, mapped, its pages there; a descriptor that locks it, or -1."""
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o644)
        try:
            return _mapped(descriptor, size)
        except BaseException:
            os.close(descriptor)
            raise
    except OSError as error:
        if error.errno == errno.ENOSPC:
            path.unlink(missing_ok=True)
        failure = JournalError(f"{path}: cannot create {size} bytes: {error.strerror}")
        failure.exit_code = 1  # nothing is wrong with what was asked for
        raise failure from error


def _mapped(descriptor: int, size: int) -> tuple[mmap.mmap, int]:
    if sys.platform == "win32":
        os.truncate(descriptor, size)
        memory = mmap.mmap(descriptor, size)
        os.close(descriptor)
        return memory, -1
    import fcntl

    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    if sys.platform != "linux":
        os.truncate(descriptor, size)
        return mmap.mmap(descriptor, size), descriptor
    disk = os.fstatvfs(descriptor)
    if size > disk.f_bavail * disk.f_frsize:  # said before it is tried block by block
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    os.posix_fallocate(descriptor, 0, size)
    flags = mmap.MAP_SHARED | mmap.MAP_POPULATE
    return mmap.mmap(descriptor, size, flags), descriptor


def _header(path: Path, memory: mmap.mmap | bytes) -> JournalStruct:
    if len(memory) < HEADER or memory[:8] != MAGIC:
        raise JournalError(f"{path}: begins with {bytes(memory[:8])!r}; expected {MAGIC!r}")
    header = JournalStruct.from_buffer_copy(memory[:HEADER])
    if header.version != VERSION:
        raise JournalError(f"{path}: a journal of version {header.version}; expected {VERSION}")
    size = HEADER + header.capacity * header.row_size + header.description
    if len(memory) < size or header.rows > header.capacity:
        raise JournalError(
            f"{path}: {len(memory)} bytes, {header.rows} rows; expected {size} bytes for at most "
            f"{header.capacity} rows: the file is damaged"
        )
    return header


def row_of(path: Path, text: bytes, size: int) -> np.dtype[Any]:
    """What a row is made of, from the text behind the rows. Raises JournalError."""
    try:
        row = np.lib.format.descr_to_dtype(ast.literal_eval(text.decode()))
    except (SyntaxError, ValueError, TypeError) as error:
        raise JournalError(f"{path}: invalid description of its rows: {text!r}") from error
    if row.itemsize != size:
        raise JournalError(f"{path}: rows of {size} bytes, described as {row.itemsize}")
    return row
