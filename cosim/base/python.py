"""Places of modules, and when Python searches for garbage.

Ours and installed modules come first, the working directory last, for a user's own.

A file there that is called like a module of Python or of a library (``can.py``, ``queue.py``) takes
its place in no process of ours.
"""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

#: The folder that our packages are in.
ROOT = Path(__file__).resolve().parents[2]
_START = (
    "import sys; root = sys.argv.pop(1); root in sys.path or sys.path.insert(0, root); "
    "import runpy; runpy.run_module(sys.argv.pop(1), run_name='__main__', alter_sys=True)"
)


def python_call(module: str, *arguments: str) -> list[str]:
    """The command that runs one of our modules as the main program of another process."""
    return [sys.executable, "-P", "-c", _START, str(ROOT), module, *arguments]


def add_working_directory() -> None:
    """Let modules of the working directory be imported, where no other has their name."""
    here = os.getcwd()
    if sys.path and sys.path[0] in ("", here) and here != str(ROOT):  # by `python -m`
        del sys.path[0]
    if here not in sys.path:
        sys.path.append(here)


@contextmanager
def without_collections() -> Iterator[None]:
    """Do not search for garbage in the block: with ten thousand components a quarter of the time of
    a start went into searching what had been made, and all of it stays.
    """
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
