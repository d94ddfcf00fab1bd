"""``frame.h``: frames, as a struct and as rows of an array, and the ring between two threads."""

from __future__ import annotations

import ctypes as c
from typing import Any, final

import numpy as np

from bridge.native.enums import FRAME_DATA, Flags
from bridge.native.library import library
from bridge.native.structs import Frame, RingStruct
from cosim.base.errors import CosimError

__all__ = ["DATA", "Flags", "Frame", "Ring", "RingStruct", "frame_dtype"]
DATA = FRAME_DATA


def frame_dtype(data: int = 64) -> np.dtype[np.void]:
    """The fields of `frame_t` as a row with `data` bytes: 64 for CAN (88 bytes), 232 for all buses.

    A log may have any size: data beyond it is not logged, but `length` contains the full length.
    """
    fields: list[Any] = [
        ("t_ns", "<i8"), ("id", "<u4"), ("flags", "u1"), ("bus", "u1"), ("length", "<u2"),
        ("sequence", "<u4"), ("reserved", "<u4"), ("data", "u1", (data,)),
    ]  # fmt: skip
    return np.dtype(fields)


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
        return bool(library().ring_put(c.byref(self.struct), c.byref(frame)))

    def get(self, frame: Frame) -> bool:
        """Take the oldest frame out into `frame`; False: empty."""
        return bool(library().ring_get(c.byref(self.struct), c.byref(frame)))

    @property
    def dropped(self) -> int:
        """Frames that did not fit."""
        return int(self.struct.dropped)

    def __len__(self) -> int:
        return int(self.struct.head - self.struct.tail)
