"""``load.h``: the time of a frame on its bus, and a bus that arbitrates. Times are ns."""

from __future__ import annotations

import ctypes as c
from functools import lru_cache
from typing import final

from bridge.can.timing import BusTiming
from bridge.native.frame import Frame
from bridge.native.library import library

NEVER = -1


@final
class Bits(c.Structure):
    """Bit times at the nominal and the data bit rate (`bits_t`)."""

    _fields_ = (("nominal", c.c_int32), ("data", c.c_int32))


@final
class Request(c.Structure):
    """A frame that waits for the bus (`request_t`)."""

    _fields_ = (
        ("request_ns", c.c_int64),
        ("duration_ns", c.c_int64),
        ("rank", c.c_uint32),
        ("node", c.c_uint32),
        ("frame", Frame),
    )


class ArbiterStruct(c.Structure):
    """``arbiter_t``."""

    _fields_ = (
        ("bitrate", c.c_double),
        ("data_bitrate", c.c_double),
        ("fifo", c.c_int32),
        ("sending", c.c_int32),
        ("capacity", c.c_int64),
        ("n", c.c_int64),
        ("waiting", c.POINTER(Request)),
        ("free_ns", c.c_int64),
        ("sent", c.c_int64),
        ("dropped", c.c_int64),
        ("busy_ns", c.c_int64),
    )


@final
class Arbiter:
    """One bus: frames go in when they are handed over and come out when they have arrived.

    A request has to be put in before anything later is asked for; see ``load.h``. `fifo`: a node
    sends in the order of handing over. `struct` counts: sent, dropped, busy_ns.
    """

    def __init__(self, timing: BusTiming, capacity: int = 256, *, fifo: bool = False) -> None:
        self._waiting = (Request * capacity)()
        self.struct = ArbiterStruct(
            bitrate=timing.bitrate,
            data_bitrate=timing.data_bitrate or 0.0,
            fifo=fifo,
            capacity=capacity,
            waiting=self._waiting,
        )

    def put(self, frame: Frame, node: int, request_ns: int) -> bool:
        """`node` hands over a frame; False: no place, or no CAN frame (counted)."""
        lib = _declared()
        return bool(lib.arbiter_put(c.byref(self.struct), c.byref(frame), node, request_ns))

    def next(self, now_ns: int, frame: Frame) -> int | None:
        """The node whose frame is the next to have arrived by now (then in `frame`), or None."""
        node = c.c_uint32()
        here = c.byref(self.struct), now_ns, c.byref(frame), c.byref(node)
        return node.value if _declared().arbiter_next(*here) else None

    def due(self) -> int:
        """When the next frame arrives if nothing else is put in; NEVER: none waits."""
        return int(_declared().arbiter_due(c.byref(self.struct)))


def frame_bits_exact(frame: Frame) -> tuple[int, int]:
    """Bit times (nominal, data) from start of frame to intermission; (0, 0): no CAN frame."""
    bits = Bits()
    _declared().frame_bits_exact(c.byref(frame), c.byref(bits))
    return bits.nominal, bits.data


def frame_time_ns(frame: Frame, timing: BusTiming) -> int:
    """How long a frame occupies its bus, ns; 0: no CAN frame."""
    lib = _declared()
    return int(lib.frame_time_ns(c.byref(frame), timing.bitrate, timing.data_bitrate or 0.0))


def frame_rank(frame: Frame) -> int:
    """The bits that arbitrate; the smallest wins."""
    return int(_declared().frame_rank(c.byref(frame)))


def sizes(which: int) -> int:
    """What C takes for the size of a struct: bits_t, request_t, arbiter_t, frame_t."""
    return int(_declared().load_sizes(which))


@lru_cache(maxsize=1)
def _declared() -> c.CDLL:
    lib = library()
    frame, arbiter = c.POINTER(Frame), c.POINTER(ArbiterStruct)
    lib.frame_bits_exact.argtypes = (frame, c.POINTER(Bits))
    lib.frame_bits_exact.restype = None
    lib.frame_time_ns.argtypes = (frame, c.c_double, c.c_double)
    lib.frame_time_ns.restype = c.c_int64
    lib.frame_rank.argtypes = (frame,)
    lib.frame_rank.restype = c.c_uint32
    lib.arbiter_put.argtypes = (arbiter, frame, c.c_uint32, c.c_int64)
    lib.arbiter_put.restype = c.c_int32
    lib.arbiter_next.argtypes = (arbiter, c.c_int64, frame, c.POINTER(c.c_uint32))
    lib.arbiter_next.restype = c.c_int32
    lib.arbiter_due.argtypes = (arbiter,)
    lib.arbiter_due.restype = c.c_int64
    lib.load_sizes.argtypes = (c.c_int32,)
    lib.load_sizes.restype = c.c_size_t
    return lib
