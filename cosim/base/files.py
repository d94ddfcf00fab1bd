"""Files that are read: a device or a pipe is none, and would be read for ever."""

from __future__ import annotations

import stat
from pathlib import Path


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
