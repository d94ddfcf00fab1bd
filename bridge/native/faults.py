"""``faults.h``: injection of faults into received frames; the header describes the kinds."""

from __future__ import annotations

import ctypes as c
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, final

import numpy as np

from bridge.native.bus import Accept
from bridge.native.frame import Frame
from bridge.native.library import library
from bridge.native.message import Message
from cosim.base.errors import PlanError

DROP, BURST, DELAY, JITTER, DUPLICATE, REORDER, CORRUPT, FORGE, REPLAY, ABSURD, FLOOD = range(11)
HOSTILE = (FORGE, REPLAY, ABSURD, FLOOD)
FOREVER = 2**63 - 1

#: A row of the journal of what was injected (`injected_t`).
INJECTED: np.dtype[Any] = np.dtype(
    [
        ("t_ns", "<i8"),
        ("through_ns", "<i8"),
        ("id", "<u4"),
        ("sequence", "<u4"),
        ("crc", "<u4"),
        ("crc_after", "<u4"),
        ("rule", "<i4"),
        ("kinds", "<u4"),
        ("length", "<u2"),
        ("flags", "u1"),
        ("bus", "u1"),
        ("copies", "<i4"),
        ("data", "u1", (64,)),
    ]
)


@final
class Fault(c.Structure):
    """One rule (`fault_t`)."""

    _fields_ = (
        ("kind", c.c_int32),
        ("count", c.c_int32),
        ("t0_ns", c.c_int64),
        ("t1_ns", c.c_int64),
        ("accept", Accept),
        ("bus", c.c_int32),
        ("reserved", c.c_int32),
        ("probability", c.c_double),
        ("a", c.c_double),
        ("b", c.c_double),
        ("random", c.c_uint64),
        ("left", c.c_int64),
        ("last_ns", c.c_int64),
        ("asked", c.c_int64),
        ("hits", c.c_int64),
        ("message", c.POINTER(Message)),
        ("values", c.c_void_p),
        ("store", c.POINTER(Frame)),
        ("stored", c.c_int64),
        ("taken", c.c_int64),
    )


@final
class Faults(c.Structure):
    """`faults_t`; the arrays it points to belong to an :class:`Injector`."""

    _fields_ = (
        ("rules", c.c_void_p),
        ("n_rules", c.c_int64),
        ("waiting", c.c_void_p),
        ("first", c.c_int64),
        ("n_waiting", c.c_int64),
        ("capacity", c.c_int64),
        ("journal", c.c_void_p),
        ("frames", c.c_int64),
        ("injected", c.c_int64),
        ("dropped", c.c_int64),
        ("corrupted", c.c_int64),
        ("overflow", c.c_int64),
    )


@final
class Injector:
    """A `faults_t` and its memory: rules in order, and delayed frames.

    `journal`: address of a journal of :data:`INJECTED` rows, or None. Raises PlanError for a
    `capacity` (frames delayed at the same time) that is not a power of two.
    """

    def __init__(
        self, rules: Sequence[Fault], capacity: int = 1024, journal: int | None = None
    ) -> None:
        if capacity < 1 or capacity & (capacity - 1):
            raise PlanError(f"faults with {capacity} frames waiting; expected a power of two")
        self.rules = (Fault * len(rules))(*rules)
        self._room = [self._room_for(rule) for rule in self.rules]
        self._waiting = (Frame * capacity)()
        self.struct = Faults(n_rules=len(rules), capacity=capacity, journal=journal)
        self.struct.rules = c.addressof(self.rules)
        self.struct.waiting = c.addressof(self._waiting)
        self._library = _declared()

    @staticmethod
    def _room_for(rule: Fault) -> tuple[object, ...]:
        """Memory of a rule of a hostile peer, bound to it."""
        if rule.kind not in HOSTILE or not rule.message:
            return ()
        values = (c.c_double * max(1, rule.message.contents.n_fields))()
        frames = (Frame * max(1, rule.count if rule.kind == REPLAY else 0))()
        rule.values, rule.store = c.addressof(values), frames
        return values, frames

    @property
    def address(self) -> int:
        """Of the `faults_t`, valid as long as this lives."""
        return c.addressof(self.struct)

    def put(self, frame: Frame, start_ns: int) -> None:
        """Take a frame in; its `t_ns` is the arrival, `start_ns` t = 0 on the same clock."""
        self._library.faults_put(c.byref(self.struct), c.byref(frame), start_ns, start_ns > 0)

    def get(self, now_ns: int) -> Frame | None:
        """The next that gets through by now, with its new `t_ns`; None: there is none."""
        frame = Frame()
        found = self._library.faults_get(c.byref(self.struct), c.byref(frame), now_ns)
        return frame if found else None

    def hits(self) -> tuple[int, ...]:
        """How many frames each rule did something to."""
        return tuple(rule.hits for rule in self.rules)


@lru_cache(maxsize=1)
def _declared() -> c.CDLL:
    lib = library()
    lib.faults_put.argtypes = (c.POINTER(Faults), c.POINTER(Frame), c.c_int64, c.c_int32)
    lib.faults_put.restype = None
    lib.faults_get.argtypes = (c.POINTER(Faults), c.POINTER(Frame), c.c_int64)
    lib.faults_get.restype = c.c_int32
    return lib
