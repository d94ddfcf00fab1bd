"""The place of the library, and the way it is loaded."""

from __future__ import annotations

import ctypes as c
import sys
from functools import lru_cache
from pathlib import Path

from bridge.native import structs
from cosim.base.errors import CosimError


def library_path() -> Path:
    """The path of the shared library, built at installation next to the package's sources."""
    suffix = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
    return Path(__file__).parent.with_name(f"_bridge{suffix}")


@lru_cache(maxsize=1)
def library() -> c.CDLL:
    """The library, loaded once. Raises CosimError when it is missing."""
    path = library_path()
    if not path.is_file():
        raise CosimError(f"{path} is missing: install the project (pip install .), which builds it")
    return structs.declare(c.CDLL(str(path)))


def address(name: str) -> int:
    """The address of a function of the library."""
    value = c.cast(getattr(library(), name), c.c_void_p).value
    assert value is not None
    return value
