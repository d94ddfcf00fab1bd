"""The shared library of the engine, and functions by which C calls Python."""

from __future__ import annotations

import ctypes as c
import sys
from functools import lru_cache
from pathlib import Path

from cosim.base.errors import CosimError
from cosim.native import structs

#: ``call_t``, ``saving_t``, the member `texts` of ``partition_t``, and access to texts of an FMU.
CALL = c.CFUNCTYPE(c.c_int32, c.c_int32, c.c_double, c.c_double)
SAVING = c.CFUNCTYPE(c.c_int32, c.c_int32, c.c_int32)
TEXTS = c.CFUNCTYPE(c.c_int32)
TEXT_ACCESS = c.CFUNCTYPE(c.c_int, c.c_void_p, c.c_void_p, c.c_size_t, c.POINTER(c.c_double))


def library_path() -> Path:
    """The path of the engine's shared library, built at installation."""
    suffix = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
    return Path(__file__).parent.with_name(f"_engine{suffix}")


@lru_cache(maxsize=1)
def library() -> c.CDLL:
    """The engine, loaded once. Raises CosimError when it is missing."""
    path = library_path()
    if not path.is_file():
        raise CosimError(f"{path} is missing: install the project (pip install .), which builds it")
    return structs.declare(c.CDLL(str(path)))


def address(function: object) -> int:
    """The address of a ctypes function or call-back."""
    value = c.cast(function, c.c_void_p).value  # type: ignore[arg-type]
    assert value is not None
    return value
