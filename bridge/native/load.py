"""``load.h``: the time of a frame on its bus, in ns."""

from __future__ import annotations

import ctypes as c

from bridge.native.library import library
from bridge.native.structs import Frame
from cosim.bus.structs import BitsStruct
from cosim.bus.timing import BusTiming


def frame_bits_exact(frame: Frame) -> tuple[int, int]:
    """Bit times (nominal, data) from start of frame to intermission; (0, 0): no CAN frame."""
    bits = BitsStruct()
    library().frame_bits_exact(c.byref(frame), c.byref(bits))
    return bits.nominal, bits.data


def frame_time_ns(frame: Frame, timing: BusTiming) -> int:
    """The time that a frame occupies its bus, ns; 0: no CAN frame."""
    lib = library()
    return int(lib.frame_time_ns(c.byref(frame), timing.bitrate, timing.data_bitrate or 0.0))
