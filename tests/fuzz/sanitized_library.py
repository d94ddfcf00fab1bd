"""A pytest plug-in: the module SANITIZED_MODULE takes its library from SANITIZED_LIBRARY.

ctypes keeps an array of up to 16 bytes inside of its object, where an access beyond its end is not
seen. So arrays that describe an FMU to the engine get memory of their own.
"""

from __future__ import annotations

import ctypes as c
import os
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from cosim.fmi import layout

shared = import_module(os.environ["SANITIZED_MODULE"])
shared.library_path = lambda: Path(os.environ["SANITIZED_LIBRARY"])


def array_address(kind: Any, values: Sequence[Any], alive: list[Any]) -> int:
    """The replacement of ``cosim.fmi.layout._array_address``."""
    kind = kind * max(1, len(values))
    array = kind.from_buffer(bytearray(c.sizeof(kind)))
    for i, value in enumerate(values):
        array[i] = value
    alive.append(array)
    return c.addressof(array)


layout._array_address = array_address
