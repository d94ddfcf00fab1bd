"""``load.h``: the time of a frame on its bus, in ns."""

from __future__ import annotations

import ctypes as c
from functools import lru_cache

from bridge.native.frame import Frame
from bridge.native.library import library
from cosim.bus.structs import FrameBitsStruct
from cosim.bus.timing import BusTiming


def frame_bits_exact(frame: Frame) -> tuple[int, int]:
    """Bit times (nominal, data) from start of frame to intermission; (0, 0): no CAN frame."""
    bits = FrameBitsStruct()
    _declared().frame_bits_exact(c.byref(frame), c.byref(bits))
    return bits.nominal, bits.data


def frame_time_ns(frame: Frame, timing: BusTiming) -> int:
    """How long a frame occupies its bus, ns; 0: no CAN frame."""
    lib = _declared()
    return int(lib.frame_time_ns(c.byref(frame), timing.bitrate, timing.data_bitrate or 0.0))


@lru_cache(maxsize=1)
def _declared() -> c.CDLL:
    lib = library()
    frame = c.POINTER(Frame)
    lib.frame_bits_exact.argtypes = (frame, c.POINTER(FrameBitsStruct))
    lib.frame_bits_exact.restype = None
    lib.frame_time_ns.argtypes = (frame, c.c_double, c.c_double)
    lib.frame_time_ns.restype = c.c_int64
    return lib
