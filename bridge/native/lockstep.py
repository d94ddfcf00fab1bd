"""``lockstep.h``: a node that advances as its samples arrive."""

from __future__ import annotations

import ctypes as c

from bridge.native import enums
from bridge.native.library import library
from bridge.native.structs import LockstepStruct, StreamStruct

__all__ = ["LockstepStruct", "StreamStruct", "needed", "run", "sent"]
STALLED, LOST = enums.LOCKSTEP_STALLED, enums.LOCKSTEP_LOST
REFUSED = enums.LOCKSTEP_REFUSED


def sent(stream: StreamStruct, deadline_ns: int) -> int:
    """The number of samples sent before a slot at `deadline_ns` (relative to the start)."""
    return int(library().lockstep_sent(c.byref(stream), deadline_ns))


def needed(stream: StreamStruct, deadline_ns: int) -> int:
    """The number of them that the slot needs."""
    return int(library().lockstep_needed(c.byref(stream), deadline_ns))


def run(struct: LockstepStruct) -> int:
    """All slots, without the GIL: FINISHED, STOPPED, STALLED, LOST, REFUSED or the engine's."""
    return int(library().lockstep_run(c.byref(struct)))
