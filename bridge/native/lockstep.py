"""``lockstep.h``: a node that advances as its samples arrive."""

from __future__ import annotations

import ctypes as c
from functools import lru_cache

from bridge.native.bus import BusStruct
from bridge.native.frame import Frame
from bridge.native.library import library
from bridge.native.message import Message
from bridge.native.node import NodeStruct

STALLED, LOST = -10, -11


class StreamStruct(c.Structure):
    """``stream_t``."""

    _fields_ = (
        ("message", c.POINTER(Message)),
        ("bus", c.c_int32),
        ("before", c.c_int32),
        ("period_ns", c.c_int64),
        ("offset_ns", c.c_int64),
        ("received", c.c_int64),
        ("given", c.c_int64),
        ("capacity", c.c_int64),
        ("frames", c.POINTER(Frame)),
    )

    def needed(self, deadline_ns: int) -> int:
        """Samples that a slot at `deadline_ns` (relative to the start) needs."""
        return int(_declared().lockstep_needed(c.byref(self), deadline_ns))


class LockstepStruct(c.Structure):
    """``lockstep_t``."""

    _fields_ = (
        ("node", c.POINTER(NodeStruct)),
        ("outside", c.POINTER(BusStruct)),
        ("streams", c.POINTER(StreamStruct)),
        ("n_streams", c.c_int32),
        ("awaited", c.c_int32),
        ("patience_ns", c.c_int64),
        ("found", c.c_int64),
    )


def run(struct: LockstepStruct) -> int:
    """All slots; the GIL is released. FINISHED, STOPPED, STALLED, LOST, or the engine's result."""
    return int(_declared().lockstep_run(c.byref(struct)))


@lru_cache(maxsize=1)
def _declared() -> c.CDLL:
    lib = library()
    lib.lockstep_run.argtypes, lib.lockstep_run.restype = (c.POINTER(LockstepStruct),), c.c_int32
    lib.lockstep_needed.argtypes = (c.POINTER(StreamStruct), c.c_int64)
    lib.lockstep_needed.restype = c.c_int64
    return lib
