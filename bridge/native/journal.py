"""Rows of one kind in a file mapped into memory (``bridge/c/journal.h``).

C (:attr:`Journal.address`) or Python (:meth:`Journal.append`) appends rows; disk and memory are
taken in pieces (:meth:`Journal.make_room`). Readers see all rows written so far, even after the
writer was killed, because the rows are in the page cache. The
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
import weakref
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, Self, final

import numpy as np
from numpy.typing import NDArray

from bridge.native.library import library_path
from bridge.native.structs import JournalStruct, declare
from cosim.base.errors import CosimError
from cosim.record.live import unlock

__all__ = ["Journal", "JournalError", "JournalStruct", "row_of"]
MAGIC, VERSION, HEADER = b"cosimjnl", 1, 64
#: Bytes of rows for which there is room ahead of the writer.
AHEAD = 1 << 24
#: Added to the name of a file that is being made.
UNFINISHED = ".new"
Rows = NDArray[np.void]


#: Exceptions of Python and NumPy for a text that describes no fields.
_NO_DESCRIPTION = (
    SyntaxError, ValueError, TypeError, LookupError, RecursionError, MemoryError, OverflowError,
)  # fmt: skip


class JournalError(CosimError, ValueError):
    """A file is not a journal, or a journal cannot be created."""


@final
class Journal:
    """A journal that is being written, by one writer. `create` makes it, `open` reads one."""

    def __init__(self, path: Path, memory: Any, row: np.dtype[Any], text: bytes, file: int) -> None:
        self.path, self._file, self._text = path, file, text
        self._let_go = weakref.finalize(self, _let_go, file)  # also of one that nobody closes
        self._let_go.atexit = False
        self._memory, self._closed = memory, False
        self.struct = JournalStruct.from_buffer(memory)
        capacity = int(self.struct.capacity)
        self._rows: Rows = np.frombuffer(memory, row, capacity, HEADER)

    @classmethod
    def create(cls, path: Path | str, row: np.dtype[Any], capacity: int) -> Self:
        """A new file for `capacity` rows, of which those of the first `AHEAD` bytes are in memory.

        Raises JournalError if the file cannot be created, or the disk has no space for all rows.
        """
        path = Path(path)
        if capacity < 1 or row.itemsize < 1:
            found = f"{capacity} rows of {row.itemsize} bytes"
            raise JournalError(f"{path}: {found}; expected at least one row of one byte")
        text = repr(np.lib.format.dtype_to_descr(row)).encode()
        end = HEADER + capacity * row.itemsize
        aside = path.with_name(f"{path.name}{UNFINISHED}")  # nobody finds half of one
        file, made = _new_file(aside, end + len(text)), None
        try:
            memory, grows = _mapped(file, end + len(text))
            _write(file, text, end)
            header = JournalStruct(
                version=VERSION, row_size=row.itemsize, capacity=capacity, description=len(text),
                limit=0 if grows else capacity, descriptor=file + 1 if grows else 0,
            )  # fmt: skip
            c.memmove(c.addressof(c.c_char.from_buffer(memory)), bytes(header), HEADER)
            made = cls(path, memory, row, text, file)
            made.make_room()
            made.struct.magic = MAGIC  # last: a file without it is not one
            os.replace(aside, path)
        except BaseException as error:
            os.close(file) if made is None else made._let_go()
            aside.unlink(missing_ok=True)
            if isinstance(error, OSError):
                raise _failure(path, end + len(text), error) from error
            raise
        return made

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
        """The address of `journal_t`, for C; valid until `close`."""
        return c.addressof(self.struct)

    @property
    def dropped(self) -> int:
        """Rows that did not fit."""
        return int(self.struct.dropped)

    @property
    def rows(self) -> Rows:
        """Return a view (n,) of the rows written so far."""
        return self._rows[: len(self)]

    def make_room(self) -> None:
        """Take disk and memory for the rows of the next `AHEAD` bytes. Raises OSError."""
        rows = len(self) + 1 + AHEAD // int(self.struct.row_size)
        number = _functions().journal_grow(c.byref(self.struct), rows)
        if number:
            raise OSError(number, os.strerror(number))

    def append(self, *values: object) -> bool:
        """One row; False: full (counted). Raises ValueError for values that do not fit a row."""
        if not self._has_room():
            return False
        self._rows[len(self)] = values
        self.struct.rows += 1
        return True

    def append_bytes(self, row: bytes) -> bool:
        """One row as it is in memory; False: full (counted). Raises ValueError for another size."""
        if len(row) != self.struct.row_size:
            raise ValueError(f"{len(row)} bytes; expected a row of {self.struct.row_size}")
        if not self._has_room():
            return False
        self._rows[len(self)] = np.frombuffer(row, self._rows.dtype)[0]
        self.struct.rows += 1
        return True

    def extend(self, rows: Rows) -> None:
        """Append rows (n,). Raises JournalError for other fields or too many, OSError."""
        after = len(self) + len(rows)
        if rows.dtype != self._rows.dtype or after > self.struct.capacity:
            found = f"{after} rows of {rows.dtype.itemsize} bytes"
            raise JournalError(
                f"{self.path}: found {found}; expected at most {self.struct.capacity} rows of the "
                f"{self.struct.row_size} bytes of this journal"
            )
        piece = max(1, AHEAD // rows.dtype.itemsize)
        for i in range(0, len(rows), piece):
            self.make_room()
            some = rows[i : i + piece]
            self._rows[len(self) : len(self) + len(some)] = some
            self.struct.rows += len(some)

    def sync(self) -> None:
        """Bring the rows written so far to the disk. Raises OSError."""
        os.fsync(self._file)

    def _has_room(self) -> bool:
        """True if there is room for another row; otherwise it is counted as dropped."""
        if len(self) >= self.struct.limit:
            with suppress(OSError):
                self.make_room()
        if len(self) < self.struct.limit:
            return True
        self.struct.dropped += 1
        return False

    def close(self) -> None:
        """Truncate the file to the rows written, and unmap it. Views of `rows` must no longer be in
        use.

        A bus that still has it as its log counts further frames as dropped.
        """
        if self._closed:
            return
        self._closed = True
        used = HEADER + len(self) * int(self.struct.row_size)
        self.struct.capacity = self.struct.limit = len(self)
        self.struct.descriptor = 0
        try:
            _write(self._file, self._text, used)
            os.ftruncate(self._file, used + len(self._text))
        finally:
            self._let_go()

    def __len__(self) -> int:
        return int(self.struct.rows)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _let_go(file: int) -> None:
    """Unlock and close the file of a journal."""
    unlock(file)
    if sys.platform == "win32":
        os.close(file)


def _new_file(path: Path, size: int) -> int:
    """An empty, locked file of `size` bytes, which takes no space yet; its descriptor."""
    flags = os.O_RDWR | os.O_CREAT | os.O_TRUNC | getattr(os, "O_CLOEXEC", 0)
    file = -1
    try:
        file = os.open(path, flags | getattr(os, "O_BINARY", 0), 0o644)
        if sys.platform != "win32":
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            disk = os.fstatvfs(file)
            if size > disk.f_bavail * disk.f_frsize:  # said before a run, and not in it
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        os.ftruncate(file, size)
    except OSError as error:
        if file >= 0:
            os.close(file)
        if error.errno == errno.ENOSPC:
            path.unlink(missing_ok=True)
        place = path.with_name(path.name.removesuffix(UNFINISHED))
        raise _failure(place, size, error) from error
    return file


def _failure(path: Path, size: int, error: OSError) -> JournalError:
    failure = JournalError(f"{path}: cannot create {size} bytes: {error.strerror}")
    failure.exit_code = 1  # nothing is wrong with what was asked for
    return failure


def _mapped(file: int, size: int) -> tuple[Any, bool]:
    """The file in memory, and whether in pieces. Raises OSError."""
    if sys.platform != "linux":
        return mmap.mmap(file, size), False
    functions = _functions()
    address = functions.journal_reserve(file, size)
    if not address:
        number = c.get_errno() or errno.ENOMEM
        raise OSError(number, os.strerror(number))
    memory = (c.c_char * size).from_address(address)
    own = c.cast(address, c.POINTER(JournalStruct))
    weakref.finalize(memory, functions.journal_release, own, size).atexit = False
    return memory, True


def _write(file: int, text: bytes, at: int) -> None:
    os.lseek(file, at, os.SEEK_SET)
    if os.write(file, text) != len(text):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@lru_cache(maxsize=1)
def _functions() -> c.CDLL:
    """The library, whose functions leave the number of an error where ctypes finds it."""
    return declare(c.CDLL(str(library_path()), use_errno=True))


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
    """The fields of a row, from the text behind the rows. Raises JournalError."""
    try:
        row = np.lib.format.descr_to_dtype(ast.literal_eval(text.decode()))
    except _NO_DESCRIPTION as error:
        raise JournalError(f"{path}: invalid description of its rows: {text!r}") from error
    if row.names is None or row.hasobject:
        raise JournalError(f"{path}: rows of {row}; expected fields of numbers")
    if row.itemsize != size or not size:
        raise JournalError(f"{path}: rows of {size} bytes, described as {row.itemsize}")
    return row
