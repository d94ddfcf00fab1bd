"""The lock of a run folder: two runs never record into one."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from cosim.base.errors import ScenarioError
from cosim.record.folder import reason


@contextmanager
def held_folder(folder: str | Path) -> Iterator[None]:
    """Create the folder, and hold it: until the block or the process ends, whatever ends it.

    The lock is the system's, on the folder itself, and needs no file (not on Windows, which has
    none). Raises ScenarioError where another run holds it, or it cannot be created.
    """
    folder = Path(folder)
    with ExitStack() as stack:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if sys.platform != "win32":
                place = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
                stack.callback(os.close, place)
                _lock(place, folder)
        except OSError as error:
            text = f"cannot use this run folder: {reason(error)}"
            raise ScenarioError(text, str(folder)) from error
        yield


def _lock(place: int, folder: Path) -> None:
    import fcntl

    try:
        fcntl.flock(place, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise ScenarioError(
            "another run records into this folder; choose another one, or wait for its end",
            str(folder),
        ) from None
    except OSError:  # a file system without locks of folders
        return
