"""``faults.h``: injection of faults into received frames; the header describes the kinds."""

from __future__ import annotations

import ctypes as c
from collections.abc import Sequence
from typing import Any, final

import numpy as np

from bridge.native import enums
from bridge.native.library import library
from bridge.native.structs import Fault, Faults, Frame, InjectedStruct, JournalStruct
from cosim.base.errors import PlanError

__all__ = ["FOREVER", "INJECTED", "Fault", "Injector"]
DROP, BURST, DELAY = enums.FAULT_DROP, enums.FAULT_BURST, enums.FAULT_DELAY
JITTER, DUPLICATE, REORDER = enums.FAULT_JITTER, enums.FAULT_DUPLICATE, enums.FAULT_REORDER
CORRUPT, FORGE, REPLAY = enums.FAULT_CORRUPT, enums.FAULT_FORGE, enums.FAULT_REPLAY
ABSURD, FLOOD = enums.FAULT_ABSURD, enums.FAULT_FLOOD
HOSTILE = (FORGE, REPLAY, ABSURD, FLOOD)
FOREVER = 2**63 - 1

#: A row of the journal of what was injected (`injected_t`).
INJECTED: np.dtype[Any] = np.dtype(InjectedStruct)


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
        self.struct = Faults(n_rules=len(rules), capacity=capacity)
        self.struct.rules, self.struct.waiting = self.rules, self._waiting
        if journal is not None:
            self.struct.journal = c.cast(journal, c.POINTER(JournalStruct))
        self._library = library()

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
        """The address of the `faults_t`, valid as long as this lives."""
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
        """The number of frames that each rule did something to."""
        return tuple(rule.hits for rule in self.rules)
