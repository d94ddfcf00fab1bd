"""``mail.h``: the far side of a bus of rings, as Python's threads fill and empty it."""

from __future__ import annotations

import ctypes as c
import threading
from collections.abc import Callable
from functools import lru_cache

from bridge.native.enums import MAIL_ASLEEP
from bridge.native.frame import Ring
from bridge.native.library import library, library_path
from bridge.native.structs import Frame, declare


def frame_writer(ring: Ring, number: int) -> Callable[[bytes], None]:
    """A function that puts bytes that have just arrived into `ring`, as frames with a number.

    Frames that do not fit are counted. The GIL is held, so there is one writer at a time, but it is
    released while a waiting thread is woken.
    """
    bring, wake, struct = _holding().mail_bring, library().mail_wake, c.byref(ring.struct)

    def brought(data: bytes) -> None:
        if bring(struct, number, data, len(data)) == MAIL_ASLEEP:
            wake(struct)

    return brought


def frame_reader(ring: Ring, descriptor: int, frame: Frame) -> Callable[[], int]:
    """A function that takes the next frame out of `ring`, and sleeps while there is none.

    It sleeps on `descriptor` without the GIL, and returns 0 if it was woken without a frame.
    """
    take, arguments = library().mail_next, (c.byref(ring.struct), descriptor, c.byref(frame))
    return lambda: int(take(*arguments))


def keep_thread() -> None:
    """Keep the Python state of the calling thread, which was not created by Python.

    Otherwise each callback creates and destroys such a state, which is most of its cost.
    """
    ident = threading.get_ident()
    if ident not in _kept:
        _kept.add(ident)
        c.pythonapi.PyGILState_Ensure()


_kept: set[int] = set()


@lru_cache(maxsize=1)
def _holding() -> c.PyDLL:
    """The functions that are called without giving Python's lock away."""
    lib = c.PyDLL(str(library_path()))
    declare(lib)
    return lib
