"""``life_cycle.h``, ``guard.h``, ``watchdog.h`` and ``drive.h``."""

from __future__ import annotations

from bridge.native import enums
from bridge.native.enums import Command, DriveRequest, DriveState, GuardBit, LifeState, Status, Why
from bridge.native.library import library as functions
from bridge.native.structs import DriveStruct, Guard, LifeStruct, Peer, WatchdogStruct

__all__ = [
    "Command", "DriveRequest", "DriveState", "DriveStruct", "Guard", "GuardBit", "LifeState",
    "LifeStruct", "Peer", "Status", "WatchdogStruct", "Why", "functions",
]  # fmt: skip
#: The most joints a guard or an emulated drive can have.
JOINTS = enums.SAFETY_JOINTS
