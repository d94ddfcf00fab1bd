"""``frame.h``: frames, as a struct and as rows of an array, and the ring between two threads."""

from __future__ import annotations

import ctypes as c
from enum import IntFlag
from functools import lru_cache
from typing import Any, final

import numpy as np

from bridge.native.library import library
from cosim.base.errors import CosimError

DATA = 232


class Flags(IntFlag):
    """``FRAME_...``: what kind of frame; SENT in a log only: sent by this node, not received."""

    FD = 1
    BRS = 2
    ESI = 4
    REMOTE = 8
    EXTENDED = 16
    ERROR = 32
    SENT = 64


@final
class Frame(c.Structure):
    """A CAN frame, or a message of another network (`frame_t`, 256 bytes)."""

    _fields_ = (
        ("t_ns", c.c_int64),
        ("id", c.c_uint32),
        ("flags", c.c_uint8),
        ("bus", c.c_uint8),
        ("length", c.c_uint16),
        ("sequence", c.c_uint32),
        ("reserved", c.c_uint32),
        ("data", c.c_uint8 * DATA),
    )

    @classmethod
    def of(cls, identifier: int, data: bytes = b"", flags: int = 0, t_ns: int = 0) -> Frame:
        """A frame with these bytes. Raises CosimError for more than 232 of them."""
        if len(data) > DATA:
            raise CosimError(f"frame {identifier:#x}: {len(data)} bytes; at most {DATA} fit")
        frame = cls(t_ns=t_ns, id=identifier, flags=int(flags), length=len(data))
        c.memmove(frame.data, data, len(data))
        return frame

    @property
    def payload(self) -> bytes:
        """The `length` bytes of data."""
        return c.string_at(c.addressof(self) + Frame.data.offset, self.length)

    def key(self) -> tuple[int, int, bytes]:
        """Identifier, flags without SENT, and data: what a receiver can compare."""
        return self.id, self.flags & ~Flags.SENT, self.payload


def frame_dtype(data: int = 64) -> np.dtype[np.void]:
    """The fields of `frame_t` as a row with `data` bytes: 64 for CAN (88 bytes), 232 for all buses.

    A log may have any size: data beyond it is not logged, but `length` contains the full length.
    """
    fields: list[Any] = [
        ("t_ns", "<i8"), ("id", "<u4"), ("flags", "u1"), ("bus", "u1"), ("length", "<u2"),
        ("sequence", "<u4"), ("reserved", "<u4"), ("data", "u1", (data,)),
    ]  # fmt: skip
    return np.dtype(fields)


class RingStruct(c.Structure):
    """``ring_t``."""

    _fields_ = (
        ("head", c.c_uint64),
        ("dropped", c.c_uint64),
        ("bell", c.c_int32),
        ("reserved0", c.c_int32),
        ("pad0", c.c_uint64 * 5),
        ("tail", c.c_uint64),
        ("asleep", c.c_uint32),
        ("reserved", c.c_uint32),
        ("pad1", c.c_uint64 * 6),
        ("capacity", c.c_int64),
        ("frames", c.POINTER(Frame)),
    )


@final
class Ring:
    """A queue of frames from one writer to one reader, which may be different threads.

    `capacity` is a power of two. It never blocks; what does not fit is counted in `dropped`.
    """

    def __init__(self, capacity: int = 1024) -> None:
        if capacity < 1 or capacity & (capacity - 1):
            raise CosimError(f"a ring of {capacity} frames: expected a power of two")
        self._frames = (Frame * capacity)()
        self.struct = RingStruct(capacity=capacity, frames=self._frames)

    def put(self, frame: Frame) -> bool:
        """Copy a frame in; False: full (counted)."""
        return bool(_declared().ring_put(c.byref(self.struct), c.byref(frame)))

    def get(self, frame: Frame) -> bool:
        """Take the oldest frame out into `frame`; False: empty."""
        return bool(_declared().ring_get(c.byref(self.struct), c.byref(frame)))

    @property
    def dropped(self) -> int:
        """Frames that did not fit."""
        return int(self.struct.dropped)

    def __len__(self) -> int:
        return int(self.struct.head - self.struct.tail)


@lru_cache(maxsize=1)
def _declared() -> c.CDLL:
    lib = library()
    for function in (lib.ring_put, lib.ring_get):
        function.argtypes = (c.POINTER(RingStruct), c.POINTER(Frame))
        function.restype = c.c_int32
    return lib
