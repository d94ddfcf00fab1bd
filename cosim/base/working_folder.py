"""The working directory, which FMUs of some tools change: paths of this process must not follow."""

from __future__ import annotations

import os
from contextlib import suppress


def working_folder() -> str:
    """The working directory; "" where it has been removed."""
    with suppress(OSError):
        return os.getcwd()
    return ""


def return_to(folder: str) -> None:
    """Make a folder the working directory again, if it is another; not where it is gone or ""."""
    if folder and working_folder() != folder:
        with suppress(OSError):
            os.chdir(folder)
