"""``lockstep.h``: a node that advances as its samples arrive."""

from __future__ import annotations

import ctypes as c
from functools import lru_cache

from bridge.native.bus import BusStruct
from bridge.native.frame import Frame
from bridge.native.library import library
from bridge.native.message import Message
from bridge.native.node import NodeStruct, Reception

STALLED, LOST, REFUSED = -10, -11, -12


class StreamStruct(c.Structure):
    """``stream_t``."""

    _fields_ = (
        ("message", c.POINTER(Message)),
        ("bus", c.c_int32),
        ("before", c.c_int32),
        ("period_ns", c.c_int64),
        ("offset_ns", c.c_int64),
        ("lead_ns", c.c_int64),
        ("reception", c.POINTER(Reception)),
        ("received", c.c_int64),
        ("given", c.c_int64),
        ("capacity", c.c_int64),
        ("frames", c.POINTER(Frame)),
    )

    def sent(self, deadline_ns: int) -> int:
        """Samples sent before a slot at `deadline_ns` (relative to the start)."""
        return int(_declared().lockstep_sent(c.byref(self), deadline_ns))

    def needed(self, deadline_ns: int) -> int:
        """Those of them that the slot needs."""
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
        ("unsent_ns", c.c_int64),
    )


def run(struct: LockstepStruct) -> int:
    """All slots, without the GIL: FINISHED, STOPPED, STALLED, LOST, REFUSED or the engine's."""
    return int(_declared().lockstep_run(c.byref(struct)))


@lru_cache(maxsize=1)
def _declared() -> c.CDLL:
    lib = library()
    lib.lockstep_run.argtypes, lib.lockstep_run.restype = (c.POINTER(LockstepStruct),), c.c_int32
    for function in (lib.lockstep_sent, lib.lockstep_needed):
        function.argtypes, function.restype = (c.POINTER(StreamStruct), c.c_int64), c.c_int64
    return lib
