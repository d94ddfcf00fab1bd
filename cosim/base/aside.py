"""Files that are written aside and renamed: a reader finds the old or the new one, never a part."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from cosim.base.errors import RunError


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


def write_file(path: Path, data: str | bytes | Iterable[bytes]) -> None:
    """Write a file in one step; `data`: text (UTF-8), bytes, or pieces one after the other.

    Raises RunError with the path; the old file then remains.
    """
    pieces = data.encode() if isinstance(data, str) else data
    with written_aside(path) as part, part.open("wb") as file:
        file.writelines((pieces,) if isinstance(pieces, bytes) else pieces)
