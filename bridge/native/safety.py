"""``life.h``, ``guard.h``, ``watchdog.h`` and ``drive.h``, as ctypes sees them."""

from __future__ import annotations

import ctypes as c
from enum import IntEnum, IntFlag
from functools import lru_cache

from bridge.native.library import library

Doubles = c.POINTER(c.c_double)
#: The most joints a guard or an emulated drive can have.
JOINTS = 32


class LifeState(IntEnum):
    """``LIFE_``: where a node is in its life."""

    UNCONFIGURED = 0
    INACTIVE = 1
    ACTIVE = 2
    STOPPING = 3
    FAULT = 4
    FINISHED = 5


class Command(IntEnum):
    """``COMMAND_``: commands to a node."""

    NONE = 0
    ARM = 1
    START = 2
    STOP = 3
    RESET = 4


class Why(IntFlag):
    """``WHY_``: why a node has stopped."""

    COMMAND = 1
    ESTOP = 2
    PEER = 4
    STALE = 8
    GUARD = 16
    WATCHDOG = 32
    OVERRUN = 64
    COMPONENT = 128
    BUS = 256
    SYNC = 512
    APART = 1024
    JUMP = 2048
    DRIVE = 4096


class GuardBit(IntFlag):
    """``GUARD_``: what a guard did to a torque."""

    FINITE = 1
    TORQUE = 2
    RATE = 4
    POSITION = 8
    VELOCITY = 16
    POWER = 32
    JUMP = 64


class Status(IntFlag):
    """``STATUS_``: bits of the status byte; the lower three are the sender's :class:`LifeState`."""

    LIFE = 7  # mask of the state
    DEADMAN = 8
    ESTOP = 16
    SATURATED = 32
    STALE = 64
    SIMULATED = 128


class DriveState(IntEnum):
    """``DRIVE_``: where a drive is in its own life."""

    OFF = 0
    READY = 1
    ENABLED = 2
    FAULT = 3


class DriveRequest(IntEnum):
    """``DRIVE_``: what a drive may be asked."""

    POWER_ON = 1
    ENABLE = 2
    DISABLE = 3
    CLEAR = 4
    POWER_OFF = 5
    TRIP = 6


class LifeStruct(c.Structure):
    """``life_t``."""

    _fields_ = (
        ("state", c.c_int32),
        ("armed", c.c_int32),
        ("reasons", c.c_uint32),
        ("now", c.c_uint32),
        ("commands", c.c_uint32),
        ("ramp_ticks", c.c_int32),
        ("ramp", c.c_int32),
        ("refused", c.c_uint32),
        ("scale", c.c_double),
        ("moves", c.c_int32),
        ("reserved", c.c_int32),
    )


class Guard(c.Structure):
    """``guard_t``."""

    _fields_ = (
        ("joints", c.c_int32),
        ("stops", c.c_uint32),
        ("tau_max", Doubles),
        ("rate_max", Doubles),
        ("q_low", Doubles),
        ("q_high", Doubles),
        ("dq_max", Doubles),
        ("power_max", Doubles),
        ("q_jump", Doubles),
        ("brake", c.c_double),
        ("h", c.c_double),
        ("last_tau", Doubles),
        ("last_q", Doubles),
        ("trips", c.c_int64 * 8),
        ("bits", c.c_uint32),
        ("reserved", c.c_uint32),
    )


class WatchdogStruct(c.Structure):
    """``watchdog_t``."""

    _fields_ = (
        ("timeout_ns", c.c_int64),
        ("last_ns", c.c_int64),
        ("latched", c.c_int32),
        ("reserved", c.c_int32),
        ("trips", c.c_int64),
    )


class Peer(c.Structure):
    """``peer_t``."""

    _fields_ = (
        ("heartbeat", WatchdogStruct),
        ("state", c.c_int32),
        ("required", c.c_int32),
        ("boots", c.c_uint32),
        ("number", c.c_uint32),
        ("heard", c.c_int64),
        ("takes", c.c_int32),
        ("reserved", c.c_int32),
    )


class DriveStruct(c.Structure):
    """``drive_t``."""

    _fields_ = (
        ("joints", c.c_int32),
        ("state", c.c_int32),
        ("watchdog", WatchdogStruct),
        ("tau_max", Doubles),
        ("lag", c.c_double),
        ("h", c.c_double),
        ("damping", c.c_double),
        ("q_lsb", c.c_double),
        ("dq_lsb", c.c_double),
        ("tau_lsb", c.c_double),
        ("tau", Doubles),
        ("faults", c.c_int64),
    )


@lru_cache(maxsize=1)
def functions() -> c.CDLL:
    """The library with the functions of these headers declared. Raises CosimError without it."""
    found = library()
    structs: tuple[type[c.Structure], ...] = (LifeStruct, Guard, WatchdogStruct, Peer, DriveStruct)
    life, guard, watchdog, peer, drive = (c.POINTER(struct) for struct in structs)
    u32, i32, i64, d = c.c_uint32, c.c_int32, c.c_int64, c.c_double
    vector = Doubles
    declared: dict[str, tuple[object, list[object]]] = {
        "life_step": (i32, [life]),
        "guard_apply": (u32, [guard, vector, vector, vector, d, vector]),
        "guard_why": (u32, [guard]),
        "watchdog_feed": (None, [watchdog, i64]),
        "watchdog_check": (i32, [watchdog, i64]),
        "watchdog_reset": (None, [watchdog, i64]),
        "peer_heartbeat": (u32, [peer, i32, u32, i64]),
        "peer_check": (u32, [peer, i64]),
        "drive_request": (i32, [drive, i32, i64]),
        "drive_step": (None, [drive, vector, i32, vector, i64, vector]),
        "drive_measure": (None, [drive, vector, vector, vector, vector]),
    }
    for name, (result, arguments) in declared.items():
        function = getattr(found, name)
        function.restype, function.argtypes = result, arguments
    return found
