"""``vendor.h``: drives as their vendors describe them, as ctypes sees them."""

from __future__ import annotations

import ctypes as c
from enum import IntEnum
from functools import lru_cache

from bridge.native.frame import Frame
from bridge.native.library import library

QUEUE, PARTS = 16, 2


class VendorKind(IntEnum):
    """``VENDOR_``: whose drive it is."""

    DAMIAO = 1
    ODRIVE = 2
    CIA402 = 3


class VendorFault(IntEnum):
    """``VENDOR_``: what may happen to a drive; the header says what the code of each is."""

    TRIP = 1
    REBOOT = 2
    UNPLUG = 3
    PLUG = 4
    LATE = 5
    OTHER_ID = 6
    OLD = 7
    HOT = 8
    DROP = 9


class VendorStruct(c.Structure):
    """``vendor_t``."""

    _fields_ = (
        ("kind", c.c_int32),
        ("node", c.c_int32),
        ("format", c.c_int32),
        ("host", c.c_int32),
        ("timeout_ns", c.c_int64),
        ("cycle_ns", c.c_int64),
        ("boot_ns", c.c_int64),
        ("answer_ns", c.c_int64),
        ("jitter_ns", c.c_int64),
        ("beat_ns", c.c_int64),
        ("p_max", c.c_double),
        ("v_max", c.c_double),
        ("t_max", c.c_double),
        ("rated", c.c_double),
        ("seed", c.c_uint64),
        ("acts", c.c_int32),
        ("state", c.c_int32),
        ("error", c.c_uint32),
        ("result", c.c_int32),
        ("network", c.c_int32),
        ("reserved", c.c_int32),
        ("tau", c.c_double),
        ("owed", c.c_int32 * PARTS),
        ("refused", c.c_int64),
        ("unheard", c.c_int64),
        ("trips", c.c_int64),
        ("lost", c.c_int64),
        ("now_ns", c.c_int64),
        ("booted_ns", c.c_int64),
        ("fed_ns", c.c_int64),
        ("due_ns", c.c_int64),
        ("beat_due_ns", c.c_int64),
        ("ramp_ns", c.c_int64),
        ("late_ns", c.c_int64),
        ("last_ns", c.c_int64),
        ("draw", c.c_uint64),
        ("saved", c.c_uint32),
        ("word", c.c_uint32),
        ("before", c.c_uint32),
        ("mode", c.c_int32),
        ("input", c.c_int32),
        ("plugged", c.c_int32),
        ("hot", c.c_int32),
        ("drops", c.c_int32),
        ("shift", c.c_int32),
        ("old", c.c_int32),
        ("n_queue", c.c_int32),
        ("n_ready", c.c_int32),
        ("kept", (c.c_uint8 * 8) * PARTS),
        ("queue", Frame * QUEUE),
    )


@lru_cache(maxsize=1)
def functions() -> c.CDLL:
    """The library with the functions of this header declared. Raises CosimError without it."""
    found = library()
    vendor, frame, i32, i64 = c.POINTER(VendorStruct), c.POINTER(Frame), c.c_int32, c.c_int64
    declared: dict[str, tuple[object, list[object]]] = {
        "vendor_init": (None, [vendor, i64]),
        "vendor_brought_up": (None, [vendor, i64]),
        "vendor_take": (i32, [vendor, frame, i64]),
        "vendor_step": (None, [vendor, i64]),
        "vendor_say": (None, [vendor, i32, frame, i64]),
        "vendor_next": (i32, [vendor, i64, frame]),
        "vendor_fault": (None, [vendor, i32, i32, i64]),
    }
    for name, (result, arguments) in declared.items():
        function = getattr(found, name)
        function.restype, function.argtypes = result, arguments
    return found
