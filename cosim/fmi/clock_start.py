"""Clocks of an FMI 3.0 instance until its first step: then the engine ticks and asks them.

That is Initialization Mode and the Event Mode that follows, both at the start (FMI 3.0.2 §2.2.8).
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Callable, Mapping, Sequence

from cosim.base.errors import FmuError
from cosim.fmi.file.intervals import Interval, Intervals, NextTick, fraction
from cosim.fmi.library import NEVER, Calls, Clocks, uint32

_UNKNOWN, _CHANGED = 0, 2
_SOME = (c.c_void_p, c.c_void_p, c.c_size_t)

Get = Callable[[str, Sequence[int], int], list[float]]
GetTexts = Callable[[str, Sequence[int], int], list[str]]


def intervals(calls: Calls, handle: int, clocks: Mapping[int, bool]) -> dict[int, Interval]:
    """Interval and shift of periodic clocks, in Initialization Mode; true: as fractions.

    Raises FmuError for a shift of another resolution.
    """
    found = {}
    for reference, exact in clocks.items():
        one = (handle, uint32([reference]), 1)
        interval, _ = _interval(calls, handle, reference, exact)
        if exact:
            shift, resolution = c.c_uint64(), c.c_uint64()
            get = calls.checked("GetShiftFraction", *_SOME, *(c.c_void_p,) * 2)
            get(*one, c.byref(shift), c.byref(resolution))
            if resolution.value != interval.resolution:
                raise FmuError(
                    f"{calls.name}: the clock with value reference {reference} has an interval in "
                    f"1/{interval.resolution} s and a shift in 1/{resolution.value} s; expected "
                    "the same resolution"
                )
            found[reference] = fraction(interval.count, shift.value, interval.resolution)
        else:
            seconds = c.c_double()
            calls.checked("GetShiftDecimal", *_SOME, c.c_void_p)(*one, c.byref(seconds))
            found[reference] = Interval(interval.time, seconds.value)
    return found


def set_intervals(calls: Calls, handle: int, given: Intervals) -> None:
    """Set the interval of fixed and tunable clocks, in Initialization Mode."""
    for reference, interval in given.items():
        one = (handle, uint32([reference]), 1)
        if interval.resolution:
            counter, resolution = c.c_uint64(interval.counter), c.c_uint64(interval.resolution)
            set_ = calls.checked("SetIntervalFraction", *_SOME, *(c.c_void_p,) * 2)
            set_(*one, c.byref(counter), c.byref(resolution))
        else:
            seconds = c.c_double(interval.seconds)
            calls.checked("SetIntervalDecimal", *_SOME, c.c_void_p)(*one, c.byref(seconds))


def _interval(calls: Calls, handle: int, reference: int, exact: bool) -> tuple[NextTick, int]:
    """An interval, as the tick that would follow the start, and its qualifier. Raises FmuError."""
    one, qualifier = (handle, uint32([reference]), 1), c.c_int()
    if not exact:
        seconds = c.c_double()
        get = calls.checked("GetIntervalDecimal", *_SOME, *(c.c_void_p,) * 2)
        get(*one, c.byref(seconds), c.byref(qualifier))
        return NextTick(seconds.value), qualifier.value
    count, resolution = c.c_uint64(), c.c_uint64()
    get = calls.checked("GetIntervalFraction", *_SOME, *(c.c_void_p,) * 3)
    get(*one, c.byref(count), c.byref(resolution), c.byref(qualifier))
    if not resolution.value:
        if qualifier.value == _CHANGED:
            raise FmuError(
                f"{calls.name}: the interval of the clock with value reference {reference} has the "
                "resolution 0"
            )
        return NextTick(0.0), qualifier.value
    time = count.value / resolution.value
    return NextTick(time, count.value, resolution.value), qualifier.value


class Ticking:
    """`next`: when clocks that are asked tick next; `values`: what ticking clocks gave."""

    def __init__(self, calls: Calls, handle: int, clocks: Clocks) -> None:
        self._calls, self._handle, self._clocks = calls, handle, clocks
        never = NextTick(NEVER)
        self.next = dict.fromkeys((*clocks.changing, *clocks.countdown), never)
        self.values: dict[str, list[float]] = {}
        self.texts: dict[str, list[str]] = {}
        self._counts = dict.fromkeys((t.reference for t in clocks.triggered), 0.0)

    def ask(self, references: Sequence[int]) -> None:
        """Times of the next ticks of these clocks, from the start. Raises FmuError if unknown."""
        for reference in references:
            exact = reference in self._clocks.fractions
            tick, qualifier = _interval(self._calls, self._handle, reference, exact)
            if reference in self._clocks.countdown and qualifier != _CHANGED:
                continue
            if qualifier == _UNKNOWN or not tick.time >= 0.0:
                said = "not yet known" if qualifier == _UNKNOWN else f"{tick.time:g} s"
                raise FmuError(
                    f"{self._calls.name}: the interval of the clock with value reference "
                    f"{reference} is {said} at the start; expected one of 0 s or more"
                )
            self.next[reference] = tick

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
