"""Intervals of clocks (FMI 3.0.2 §2.2.8): seconds, or whole numbers of a fraction of a second."""

from __future__ import annotations

from collections.abc import Mapping

from cosim.base.convert import Struct
from cosim.base.errors import FmuError
from cosim.fmi.file.variables import FmuVariable


class Interval(Struct, frozen=True):
    """Interval and shift of a periodic clock: `seconds` and `shift_seconds`; with a `resolution`
    exactly `counter` / `resolution` and `shift` / `resolution`.
    """

    seconds: float
    shift_seconds: float = 0.0
    counter: int = 0
    shift: int = 0
    resolution: int = 0


class NextTick(Struct, frozen=True):
    """The next tick of a clock (s); exactly `count` / `resolution` after the start, if that is not
    0.
    """

    time: float
    count: int = 0
    resolution: int = 0


#: Of clocks that do not state their interval, or for which a scenario sets one, by value reference.
Intervals = Mapping[int, Interval]


def fraction(counter: int, shift: int, resolution: int) -> Interval:
    """An interval as the fractions that it is. Raises ZeroDivisionError."""
    return Interval(counter / resolution, shift / resolution, counter, shift, resolution)


def has_fractions(clock: FmuVariable) -> bool:
    """True if the FMU gives and takes intervals of a clock as fractions."""
    return clock.attributes.get("supportsFraction", "false") in ("true", "1")


def written(clock: FmuVariable, name: str) -> Interval:
    """The interval that a clock states, as decimals or as counts of a resolution.

    Raises FmuError where `clock`, of the FMU `name`, states none.
    """
    a = clock.attributes
    try:
        if "intervalCounter" in a:
            counts = (int(a["intervalCounter"]), int(a.get("shiftCounter", 0)))
            return fraction(*counts, int(a["resolution"]))
        return Interval(float(a["intervalDecimal"]), float(a.get("shiftDecimal", 0.0)))
    except (KeyError, ValueError, ZeroDivisionError):
        raise FmuError(
            f"{name}: clock {clock.name!r} states no interval; expected intervalDecimal, or "
            "intervalCounter and resolution"
        ) from None


def given(clock: FmuVariable, seconds: float, name: str) -> Interval:
    """The interval that a scenario gives a clock, with the shift that it states.

    A fraction where the clock states one. Raises FmuError for no whole number of its resolution.
    """
    stated = written(clock, name)
    if not (stated.resolution and has_fractions(clock)):
        return Interval(seconds, stated.shift_seconds)
    counter = round(seconds * stated.resolution)
    if counter < 1 or abs(counter / stated.resolution - seconds) > 1e-12 * seconds:
        raise FmuError(
            f"{name}: the interval {seconds:.17g} s of clock {clock.name!r} is no multiple of its "
            f"resolution, 1/{stated.resolution} s"
        )
    return fraction(counter, stated.shift, stated.resolution)
