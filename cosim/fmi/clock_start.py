"""Clocks of an FMI 3.0 instance until its first step: then the engine ticks and asks them.

That is Initialization Mode and the Event Mode that follows, both at the start (FMI 3.0.2 §2.2.8).
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Callable, Mapping, Sequence

from cosim.base.errors import FmuError
from cosim.fmi.library import NEVER, Calls, Clocks, uint32

_UNKNOWN, _CHANGED = 0, 2
_SOME = (c.c_void_p, c.c_void_p, c.c_size_t)

Get = Callable[[str, Sequence[int], int], list[float]]
GetTexts = Callable[[str, Sequence[int], int], list[str]]


def intervals(calls: Calls, handle: int, clocks: Sequence[int]) -> dict[int, tuple[float, float]]:
    """Interval and shift (s) of periodic clocks, in Initialization Mode."""
    found = _intervals(calls, handle, clocks)
    n, shifts = len(clocks), (c.c_double * len(clocks))()
    calls.checked("GetShiftDecimal", *_SOME, c.c_void_p)(handle, uint32(clocks), n, shifts)
    return {r: (found[r][0], shift) for r, shift in zip(clocks, shifts, strict=True)}


def set_intervals(calls: Calls, handle: int, given: Mapping[int, float]) -> None:
    """Set the interval (s) of fixed and tunable clocks, in Initialization Mode."""
    values = (c.c_double * len(given))(*given.values())
    set_ = calls.checked("SetIntervalDecimal", *_SOME, c.c_void_p)
    set_(handle, uint32(list(given)), len(given), values)


def _intervals(calls: Calls, handle: int, clocks: Sequence[int]) -> dict[int, tuple[float, int]]:
    """Interval (s) and its qualifier."""
    n = len(clocks)
    found, qualifiers = (c.c_double * n)(), (c.c_int * n)()
    get = calls.checked("GetIntervalDecimal", *_SOME, c.c_void_p, c.c_void_p)
    get(handle, uint32(clocks), n, found, qualifiers)
    return dict(zip(clocks, zip(found, qualifiers, strict=True), strict=True))


class Ticking:
    """`next`: when clocks that are asked tick next (s); `values`: what ticking clocks gave."""

    def __init__(self, calls: Calls, handle: int, clocks: Clocks) -> None:
        self._calls, self._handle, self._clocks = calls, handle, clocks
        self.next = dict.fromkeys((*clocks.changing, *clocks.countdown), NEVER)
        self.values: dict[str, list[float]] = {}
        self.texts: dict[str, list[str]] = {}
        self._counts = dict.fromkeys((t.reference for t in clocks.triggered), 0.0)

    def ask(self, references: Sequence[int]) -> None:
        """Times of the next ticks of these clocks, from the start. Raises FmuError if unknown."""
        asked = _intervals(self._calls, self._handle, references) if references else {}
        for reference, (interval, qualifier) in asked.items():
            if reference in self._clocks.countdown and qualifier != _CHANGED:
                continue
            if qualifier == _UNKNOWN or not interval >= 0.0:
                said = "not yet known" if qualifier == _UNKNOWN else f"{interval:g} s"
                raise FmuError(
                    f"{self._calls.name}: the interval of the clock with value reference "
                    f"{reference} is {said} at the start; expected one of 0 s or more"
                )
            self.next[reference] = interval

    def instant(self, get: Get, get_texts: GetTexts) -> None:
        """Takes what belongs to clocks that the FMU ticks in this instant."""
        active: set[int] = set()
        for clock in self._clocks.triggered:
            if not clock.clocks or active.intersection(clock.clocks):
                ticks = c.c_bool()
                ask = self._calls.checked("GetClock", *_SOME, c.c_void_p)
                ask(self._handle, uint32([clock.reference]), 1, c.byref(ticks))
                active |= {clock.reference} if ticks.value else set()
                self._counts[clock.reference] += ticks.value
        for x in self._clocks.clocked:
            if x.type == "Clock":
                self.values[x.name] = [self._counts[r] for r in x.references]
            elif active.intersection(x.clocks):
                self.values[x.name] = get(x.type, x.references, x.count)
        for x in self._clocks.texts:
            if active.intersection(x.clocks):
                self.texts[x.name] = get_texts(x.type, x.references, x.count)
