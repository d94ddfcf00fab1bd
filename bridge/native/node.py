"""``node.h``, ``gates.h`` and the functions of a node on its clocks."""

from __future__ import annotations

import ctypes as c
from typing import Any

from bridge.native import enums
from bridge.native.library import address
from bridge.native.library import library as functions
from bridge.native.structs import (
    Apart,
    ForwardStruct,
    HistoryStruct,
    InletStruct,
    Inside,
    MotorFault,
    MotorStruct,
    NodeStruct,
    OutletStruct,
    PlayedStruct,
    Reception,
    Services,
)

__all__ = [
    "Apart", "ForwardStruct", "HistoryStruct", "InletStruct", "Inside", "MotorFault",
    "MotorStruct", "NodeStruct", "OutletStruct", "PlayedStruct", "Reception",
    "Services", "address", "functions",
]  # fmt: skip
WALL, SIMULATED, REPLAY = enums.CLOCK_WALL, enums.CLOCK_SIMULATED, enums.CLOCK_REPLAY
#: Flags of a row: a missed slot, done late; a component failed; drives disabled; all ready.
BURST, FAILED = enums.ROW_BURST, enums.ROW_FAILED
DISABLED, ENABLED = enums.ROW_DISABLED, enums.ROW_ENABLED
RAISED = enums.ALARM_RAISED  # of `alarm`: emergency stop
UNKNOWN, THERE = enums.SAMPLE_UNKNOWN, enums.SAMPLE_THERE  # a sample in a replay
FINISHED, STOPPED, NEVER_STARTED = enums.LIVE_FINISHED, enums.LIVE_STOPPED, enums.LIVE_NEVER_STARTED
FAULT, NOT_JOINED = enums.LIVE_FAULT, enums.LIVE_NOT_JOINED
#: Called with the slot in which a life begins in the middle of a run; returns 0 where it can.
Joined = c.CFUNCTYPE(c.c_int32, c.c_int64)


def pointer_to(struct: MotorStruct) -> Any:
    """A pointer to an element of an array; it does not keep the array alive."""
    return c.cast(c.addressof(struct), c.POINTER(MotorStruct))
