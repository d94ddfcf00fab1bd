"""Files read (a device or a pipe is none, and would be read for ever), files written, and where.

A file is written aside and renamed: a reader finds the old or the new one, never a part. FMUs of
some tools change the working directory; paths of this process must not follow.
"""

from __future__ import annotations

import os
import re
import stat
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from cosim.base.errors import RunError


def regular(path: Path) -> Path:
    """The path, if what is there is a file, or nothing. Raises OSError for anything else.

    A pipe would be waited for, a device may have no end, and either can be read only once.
    """
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return path  # who opens it says why it cannot be read
    kinds = {stat.S_ISFIFO: "a pipe", stat.S_ISSOCK: "a socket", stat.S_ISCHR: "a device",
             stat.S_ISBLK: "a device"}  # fmt: skip
    for is_kind, word in kinds.items():
        if is_kind(mode):
            raise OSError(f"it is {word}, not a file")
    return path


@contextmanager
def written_aside(path: Path) -> Iterator[Path]:
    """Give a place next to `path`, with its suffix, which takes the name of `path` at the end.

    A full disk, an error or a signal in the block leaves `path` as it was. A device or a pipe is
    its own place. Raises RunError with `path` if it cannot be written.
    """
    whole = path.resolve() if path.is_symlink() else path
    special = whole.exists() and not whole.is_file()
    part = whole if special else whole.with_name(f".{whole.stem}-{os.getpid()}.part{whole.suffix}")
    try:
        yield part
        if not special:
            os.replace(part, whole)
    except OSError as error:
        why = os.strerror(error.errno) if error.errno is not None else str(error)
        raise RunError(f"cannot write {path}: {why}") from error
    except RunError as error:
        raise RunError(str(error).replace(str(part), str(path))) from error
    finally:
        if not special:
            with suppress(OSError):
                part.unlink(missing_ok=True)


def aside_for(name: str) -> str:
    """The name of the file that is written aside under a name; "" if nothing is."""
    found = re.fullmatch(r"\.(.+)-\d+\.part(\.[^.]+)?", name)
    return f"{found[1]}{found[2] or ''}" if found else ""


def write_file(path: Path, data: str | bytes | Iterable[bytes]) -> None:
    """Write a file in one step; `data`: text (UTF-8), bytes, or pieces one after the other.

    Raises RunError with the path; the old file then remains.
    """
    pieces = data.encode() if isinstance(data, str) else data
    with written_aside(path) as part, part.open("wb") as file:
        file.writelines((pieces,) if isinstance(pieces, bytes) else pieces)


def working_folder() -> str:
    """The working directory; "" where it has been removed."""
    with suppress(OSError):
        return os.getcwd()
    return ""


@contextmanager
def same_working_folder() -> Iterator[None]:
    """After the block the working directory is the one before, whatever user code has done."""
    before = working_folder()
    try:
        yield
    finally:
        return_to(before)


def return_to(folder: str) -> None:
    """Make a folder the working directory again, if it is another; not where it is gone or ""."""
    if folder and working_folder() != folder:
        with suppress(OSError):
            os.chdir(folder)


class Closing(ABC):
    """Closed at the end of a ``with`` block, also after an error: what was written is kept.

    An error of :meth:`close` is raised, or, where the block has failed already, added to that
    error as a note.
    """

    @abstractmethod
    def close(self) -> None:
        """Complete what is being written. Raises RunError."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            self.close()
        except RunError as failure:
            if error is None:
                raise
            error.add_note(str(failure))  # what stopped the run comes first
