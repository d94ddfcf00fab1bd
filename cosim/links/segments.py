"""A delay that is constant but for some segments of time, which the scenario lists.

::

    delay = { law = "segments", delay = "750 ms", segments = [
        { from = "0.63 s", to = "0.66 s", delay = "1.2 s" }, { from = 2, to = 2.1, lost = true } ] }

Source: own construction.
"""

from __future__ import annotations

from fractions import Fraction
from math import ceil, isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.base.convert import Struct
from cosim.base.errors import ScenarioError
from cosim.links.keys import Keyed, Seconds, Table, si
from cosim.links.laws import Delays, FloatArray, check_delay, decimal_fraction

if TYPE_CHECKING:
    from numpy.random import Generator

#: Samples that count as none: times are rounded to float64.
_NONE = Fraction(1, 10**9)
#: The keys of a segment that are times.
_TIMES = ("from", "to", "delay")


class Segment(
    Struct, frozen=True, forbid_unknown_fields=True, rename={"begin": "from", "end": "to"}
):
    """The delay T (s) in [begin, end) (s), or a loss of everything that is sent then."""

    begin: Seconds
    end: Seconds
    delay: Seconds | None = None
    lost: bool = False

    @property
    def value(self) -> float:
        """The delay, s; NaN where packets are lost."""
        return float("nan") if self.delay is None else self.delay

    def facts(self) -> dict[str, Any]:
        """The keys of the segment."""
        value = {"lost": True} if self.lost else {"delay": self.delay}
        return {"from": self.begin, "to": self.end, **value}


class Segments(Keyed, frozen=True, tag="segments"):
    """T(t) = the delay (s) of the segment that contains t, and `delay` outside of all.

    A segment contains t in [from, to). They do not overlap, and stand in the order of time. t is
    counted from the start of the run; it is when a packet is sent, or when a `signal` is read.
    """

    delay: Seconds
    segments: tuple[Segment, ...] = ()

    @classmethod
    def completed(cls, table: Table) -> Table:
        """The table with the times of its segments in s."""
        given = table.get("segments")
        if not isinstance(given, list | tuple):
            return table
        return {**table, "segments": [_in_seconds(x, i) for i, x in enumerate(given)]}

    def __post_init__(self) -> None:
        """Check delays and times. Raises ScenarioError."""
        check_delay("delay", self.delay)
        before = 0.0
        for i, segment in enumerate(self.segments):
            _check(segment, f"segments[{i}]", before)
            before = segment.end

    @property
    def minimum(self) -> float:
        """The shortest delay, s."""
        return min(self._delays())

    @property
    def maximum(self) -> float:
        """The longest delay of a packet that arrives, s."""
        return max(self._delays())

    def _delays(self) -> list[float]:
        return [self.delay, *(x.delay for x in self.segments if x.delay is not None)]

    @property
    def mean(self) -> float:
        """The delay outside of all segments, s: it lasts."""
        return self.delay

    @property
    def loses_packets(self) -> bool:
        """True if a segment loses packets."""
        return any(x.lost for x in self.segments)

    def limit(self, period: Fraction) -> int | None:
        """Unlimited."""
        return None

    def stream(self, period: Fraction, rng: Generator) -> Delays:
        """The delays in order; nothing is drawn."""
        firsts, values = [0], [self.delay]
        for x in self.segments:
            firsts += [ceil(decimal_fraction(t) / period - _NONE) for t in (x.begin, x.end)]
            values += [x.value, self.delay]
        return Pieces(np.array(firsts, np.int64), np.array(values))

    def facts(self) -> dict[str, Any]:
        """The name, and the keys, SI."""
        segments = [x.facts() for x in self.segments]
        return {"law": "segments", "delay": self.delay, "segments": segments}


class Pieces:
    """Delays that are constant from sample to sample: `values` (n,), s, NaN: lost.

    Each holds from the sample `firsts` (n,) on, ascending from 0, to the next one.
    """

    def __init__(self, firsts: np.ndarray[Any, np.dtype[np.int64]], values: FloatArray) -> None:
        self._firsts, self._values, self._sample = firsts, values, 0

    def take(self, n: int) -> FloatArray:
        """The next `n` delays, (n,), s."""
        first, self._sample = self._sample, self._sample + n
        edges = np.append(self._firsts, self._sample)
        counts = np.diff(np.clip(edges, first, self._sample))
        taken: FloatArray = np.repeat(self._values, counts)
        return taken


def _in_seconds(segment: Any, i: int) -> Any:
    if not isinstance(segment, dict):
        return segment
    return {
        k: si(v, f"segments[{i}].{k}") if k in _TIMES and isinstance(v, str) else v
        for k, v in segment.items()
    }


def _check(segment: Segment, name: str, before: float) -> None:
    """Raise ScenarioError for a segment that is none, or begins at a time before `before` (s)."""
    if (segment.delay is None) != segment.lost:
        raise ScenarioError(f"{name}: expected either delay or lost = true")
    if segment.delay is not None:
        check_delay(f"{name}.delay", segment.delay)
    if not (isfinite(segment.end) and 0 <= segment.begin < segment.end):
        raise ScenarioError(
            f"{name}: from {segment.begin:g} s to {segment.end:g} s; expected a time of 0 or more,"
            " and a later one"
        )
    if segment.begin < before:
        raise ScenarioError(
            f"{name} begins at {segment.begin:g} s, before the one before it ends, {before:g} s;"
            " expected segments one after the other"
        )
