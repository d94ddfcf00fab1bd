"""The shared library of the simulated bus (``cosim/c/bus``)."""

from __future__ import annotations

import ctypes as c
import sys
from functools import lru_cache
from pathlib import Path

from cosim.base.errors import CosimError
from cosim.bus import structs


def tick_gates() -> tuple[int, int]:
    """The addresses of the gates of a sender and of a receiver. Raises CosimError."""
    bus = library()
    send, receive = (
        c.cast(function, c.c_void_p).value for function in (bus.bus_tick_send, bus.bus_tick_receive)
    )
    assert send is not None
    assert receive is not None
    return send, receive


def library_path() -> Path:
    """The path of the shared library of the simulated bus, built at installation."""
    suffix = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
    return Path(__file__).parent.with_name(f"_bus{suffix}")


@lru_cache(maxsize=1)
def library() -> c.CDLL:
    """The simulated bus, loaded once. Raises CosimError if it is missing."""
    path = library_path()
    if not path.is_file():
        raise CosimError(f"{path} is missing: install the project (pip install .), which builds it")
    return structs.declare(c.CDLL(str(path)))
