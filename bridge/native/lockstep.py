"""``lockstep.h``: a node that advances as its samples arrive."""

from __future__ import annotations

import ctypes as c

from bridge.native import enums
from bridge.native.library import library
from bridge.native.structs import LockstepStruct, StreamStruct

__all__ = ["LockstepStruct", "StreamStruct", "needed", "run", "sent", "sent_before"]
STALLED, LOST = enums.LOCKSTEP_STALLED, enums.LOCKSTEP_LOST
REFUSED, UNTIL = enums.LOCKSTEP_REFUSED, enums.LOCKSTEP_UNTIL
#: As `until_ns`: to the end of the run.
TO_END = -1


def sent(stream: StreamStruct, deadline_ns: int) -> int:
    """The number of samples sent before a slot at `deadline_ns` (relative to the start)."""
    return int(library().lockstep_sent(c.byref(stream), deadline_ns))


def sent_before(stream: StreamStruct, time_ns: int) -> int:
    """The number of samples sent before a time (relative to the start)."""
    return int(library().lockstep_sent_before(c.byref(stream), time_ns))


def needed(stream: StreamStruct, deadline_ns: int) -> int:
    """The number of them that the slot needs."""
    return int(library().lockstep_needed(c.byref(stream), deadline_ns))


def run(struct: LockstepStruct) -> int:
    """All slots, or those before `until_ns`, without the GIL: FINISHED, STOPPED, STALLED, LOST,
    REFUSED, UNTIL or the engine's.
    """
    return int(library().lockstep_run(c.byref(struct)))
