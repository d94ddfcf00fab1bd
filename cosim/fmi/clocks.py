"""Clocks (FMI 3.0.2 §2.2.8) and step sizes: what of them a fixed step can keep.

The engine ticks input clocks: those with a constant, fixed or tunable period (it tunes nothing),
with event mode a whole number of steps of their FMU; changing ones and those that count down, when
the FMU says that they tick next; triggered ones, when the signal wired to them rises. Output clocks
are ticked by the FMU, in its events, and asked; how often they have ticked is a signal.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Protocol

from cosim.base.component import Values
from cosim.base.errors import FmuError
from cosim.fmi.file.description import Description
from cosim.fmi.file.intervals import Intervals, given, has_fractions, written
from cosim.fmi.file.ports import VariableGroup
from cosim.fmi.file.variables import TEXTS, FmuVariable
from cosim.fmi.layout import Ticker
from cosim.fmi.library import Clocked, Clocks, Instance, TriggeredClock
from cosim.native.enums import ClockKind

_KINDS = {
    "constant": ClockKind.PERIODIC, "fixed": ClockKind.PERIODIC, "tunable": ClockKind.PERIODIC,
    "changing": ClockKind.CHANGING, "countdown": ClockKind.COUNTDOWN,
    "triggered": ClockKind.WIRED,
}  # fmt: skip


class ClockedFmu(Protocol):
    """The interface of an FMU used here: :class:`cosim.fmi.component.FmuComponent`."""

    @property
    def name(self) -> str:
        """The name used in errors."""

    @property
    def clocked(self) -> bool:
        """True if its clocks are ticked: with event mode, or in scheduled execution."""

    @property
    def description(self) -> Description:
        """Its model description."""

    @property
    def groups(self) -> Mapping[str, VariableGroup]:
        """Its variables by name, arrays as one."""

    @property
    def instance(self) -> Instance:
        """The FMU that runs. Raises FmuError where none does."""


def tickers(
    description: Description, h: float, name: str, said: Intervals, places: Mapping[int, int]
) -> tuple[Ticker, ...]:
    """The clocks the engine ticks, for steps of `h` (s). Raises FmuError for any it cannot.

    `places`: where clocks that are signals are among these, by value reference. In scheduled
    execution, in the order of their priorities.
    """
    inputs = _inputs(description)
    if description.scheduled:
        h = 0.0  # a partition is activated at any time
        inputs.sort(key=lambda clock: _priority(clock, name))
    return tuple(_ticker(v, h, name, said, places) for v in inputs)


def _priority(clock: FmuVariable, name: str) -> int:
    """Less is more urgent. Raises FmuError where it is missing (FMI 3.0.2 §2.4.7.4)."""
    written_one = clock.attributes.get("priority", "")
    if not written_one.isdecimal():
        raise FmuError(
            f"{name}: clock {clock.name!r} has the priority {written_one!r}; expected a whole "
            "number, which scheduled execution needs"
        )
    return int(written_one)


def is_signal(variable: FmuVariable) -> bool:
    """True if a clock can be wired: output clocks, and input clocks that these trigger."""
    if variable.type != "Clock":
        return False
    return variable.causality == "output" or _variability(variable) == "triggered"


def read_clocks(x: ClockedFmu) -> Clocks:
    """The questions to an FMU's clocks, with event mode. Raises FmuError where one is none."""
    if not x.clocked:
        return Clocks()
    inputs = _inputs(x.description)
    outputs = [g for g in x.groups.values() if g.first.causality == "output"]
    found = [Clocked(g.name, g.first.type, g.references, g.size, g.first.clocks) for g in outputs]
    clocked = [x for x in found if x.clocks or x.type == "Clock"]
    return Clocks(
        changing=tuple(v.reference for v in inputs if _variability(v) == "changing"),
        countdown=tuple(v.reference for v in inputs if _variability(v) == "countdown"),
        triggered=triggered(x.description, x.name),
        clocked=tuple(x for x in clocked if x.type not in TEXTS),
        texts=tuple(x for x in clocked if x.type in TEXTS),
        fractions=tuple(v.reference for v in inputs if has_fractions(v)),
    )


def _variability(clock: FmuVariable) -> str:
    return clock.attributes.get("intervalVariability", "")


def intervals_from_fmu(description: Description) -> dict[int, bool]:
    """Value references of periodic clocks whose interval the FMU defines (FMI 3.0.2 §2.2.8), and
    whether as a fraction.
    """
    return {
        v.reference: has_fractions(v)
        for v in _inputs(description)
        if _variability(v) in ("fixed", "tunable")
        and not {"intervalDecimal", "intervalCounter"} & v.attributes.keys()
    }


def _inputs(description: Description) -> list[FmuVariable]:
    return [v for v in description.variables if v.type == "Clock" and v.causality == "input"]


def triggered(description: Description, name: str) -> tuple[TriggeredClock, ...]:
    """The clocks the FMU ticks, those that others depend on first. Raises FmuError for no such."""
    clocks = [v for v in description.variables if v.type == "Clock"]
    known = {v.reference for v in clocks if v.causality == "input"}
    waiting = [v for v in clocks if v.causality == "output"]
    found: list[TriggeredClock] = []
    while waiting:
        ready = [v for v in waiting if set(v.clocks) <= known]
        if not ready:
            _check_clocks(waiting[0], known, name)
        found += [TriggeredClock(v.reference, v.clocks) for v in ready]
        known |= {v.reference for v in ready}
        waiting = [v for v in waiting if v not in ready]
    for v in description.variables:
        if v.causality in ("input", "output") and v.type != "Clock":
            _check_clocks(v, known, name)
    return tuple(found)


def _check_clocks(variable: FmuVariable, known: Collection[int], name: str) -> None:
    """Raises FmuError if a variable refers to something that is not a clock, or to itself."""
    for reference in variable.clocks:
        if reference not in known:
            raise FmuError(
                f"{name}: {variable.name!r} belongs to a clock of value reference {reference}; "
                "expected that of an input or output clock, and no loop of clocks"
            )


def _ticker(
    clock: FmuVariable, h: float, name: str, said: Intervals, places: Mapping[int, int]
) -> Ticker:
    kind = _KINDS.get(_variability(clock))
    if kind is None:
        raise FmuError(
            f"{name}: clock {clock.name!r} has intervalVariability {_variability(clock)!r}; "
            f"expected one of {', '.join(_KINDS)}"
        )
    if kind is not ClockKind.PERIODIC:
        place, exact = places.get(clock.reference, 0), has_fractions(clock)
        return Ticker(clock.reference, kind, place=place, exact=exact)
    found = said.get(clock.reference) or written(clock, name)
    period, shift = found.seconds, found.shift_seconds
    if not (period > 0.0 and shift >= 0.0):
        raise FmuError(f"{name}: clock {clock.name!r} has interval {period:g} s, shift {shift:g} s")
    if not h:
        return Ticker(clock.reference, kind, interval=found)
    return Ticker(
        clock.reference,
        kind,
        _steps(period, h, f"{name}: the interval of clock {clock.name!r}"),
        _steps(shift, h, f"{name}: the shift of clock {clock.name!r}") if shift else 0,
    )


def set_intervals(x: ClockedFmu, values: Values) -> Intervals:
    """Set the clocks among `values`; returns their intervals and shifts. Raises FmuError."""
    groups = {k: x.groups[k] for k in values if x.groups[k].first.type == "Clock"}
    found = {
        v.reference: given(v, float(interval), x.name)
        for k, group in groups.items()
        for v, interval in zip(group.variables, values[k].reshape(-1), strict=True)
    }
    if found:
        x.instance.set_intervals(found)
    return found


def check_step(description: Description, h: float, name: str) -> None:
    """True if an FMU can do steps of `h` (s).

    One that takes no varying step and states the step it makes inside (FMI 3.0.2 §4.3.1,
    fixedInternalStepSize) gets whole numbers of that only. Raises FmuError.
    """
    written = description.step_attributes.get("fixedInternalStepSize")
    if written is None or description.flags.get("canHandleVariableCommunicationStepSize"):
        return
    try:
        inside = float(written)
    except ValueError:
        inside = 0.0
    if not inside > 0.0:
        raise FmuError(f"{name}: fixedInternalStepSize {written!r} is not a positive number")
    _steps(h, inside, f"{name}: the period")


def _steps(seconds: float, h: float, what: str) -> int:
    n = round(seconds / h)
    if n < 1 or abs(n * h - seconds) > 1e-9 * max(seconds, h):
        raise FmuError(f"{what}, {seconds:g} s, is not a multiple of the step {h:g} s")
    return n
