"""A delay that is constant but for some segments of time, which the scenario lists.

::

    delay = { law = "segments", delay = "750 ms", segments = [
        { from = "0.63 s", to = "0.66 s", delay = "1.2 s" }, { from = 2, to = 2.1, lost = true } ] }
    delay = { law = "segments", delay = 0.75, rise = 0.5, fall = 1, segments = [ ... ] }

Source: own construction.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import ceil, inf, isfinite
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

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
    `rise`, `fall`: the fastest the delay rises and falls, s/s; None: at once. It then is on its way
    to the delay of the segment, also while packets are lost.
    """

    delay: Seconds
    segments: tuple[Segment, ...] = ()
    rise: float | None = None
    fall: float | None = None

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
        for name in ("rise", "fall"):
            speed = getattr(self, name)
            if speed is not None and not 0 < speed < inf:
                raise ScenarioError(f"{name}: found {speed:g} s/s; expected more than 0")
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
        times, values = [0.0], [self.delay]
        for x in self.segments:
            times += [x.begin, x.end]
            values += [x.value, self.delay]
        firsts = [ceil(decimal_fraction(t) / period - _NONE) for t in times]
        pieces = Pieces(np.array(firsts, np.int64), np.array(values))
        speeds = (self.rise or inf, self.fall or inf)
        return following(pieces, times, speeds, float(period))

    def facts(self) -> dict[str, Any]:
        """The name, and the keys, SI."""
        segments = [x.facts() for x in self.segments]
        speeds = {k: v for k in ("rise", "fall") if (v := getattr(self, k)) is not None}
        return {"law": "segments", "delay": self.delay, **speeds, "segments": segments}


class Pieces:
    """Delays that are constant from sample to sample: `values` (n,), s, NaN: lost.

    Each holds from the sample `firsts` (n,) on, ascending from 0, to the next one.
    """

    def __init__(self, firsts: NDArray[np.int64], values: FloatArray) -> None:
        self.firsts, self.values, self._sample = firsts, values, 0

    def take(self, n: int) -> FloatArray:
        """The next `n` delays, (n,), s."""
        first, self._sample = self._sample, self._sample + n
        edges = np.append(self.firsts, self._sample)
        counts = np.diff(np.clip(edges, first, self._sample))
        taken: FloatArray = np.repeat(self.values, counts)
        return taken


def following(
    pieces: Pieces, times: Sequence[float], speeds: tuple[float, float], period: float
) -> Delays:
    """Delays that follow `pieces` no faster than `speeds` up and down, s/s; inf: at once.

    `times`: when the pieces begin, s; `period`: of the samples, s.
    """
    if min(speeds) == inf or np.isnan(pieces.values).all():
        return pieces
    return _Following(pieces, times, speeds, period)


class _Following:
    """Pieces with ramps instead of jumps.

    At its time each leg leaves `starts` for `targets` (s) with `slopes` (s/s), all (n,); `firsts`
    (n,): their first samples.
    """

    def __init__(
        self, pieces: Pieces, times: Sequence[float], speeds: tuple[float, float], period: float
    ) -> None:
        self._pieces, self._period, self._sample = pieces, period, 0
        legs = _legs(pieces, times)
        self._firsts, self._times, self._targets = (np.array(x) for x in zip(*legs, strict=True))
        starts, slopes, now = [], [], legs[0][2]
        for (_, begin, target), end in zip(legs, [*self._times[1:], inf], strict=True):
            slope = speeds[0] if target > now else -speeds[1]
            starts.append(now)
            slopes.append(slope)
            now = _on_the_way(now, target, slope, end - begin)
        self._starts, self._slopes = np.array(starts), np.array(slopes)

    def take(self, n: int) -> FloatArray:
        """The next `n` delays, (n,), s."""
        k = np.arange(self._sample, self._sample + n)
        self._sample += n
        i = np.searchsorted(self._firsts, k, side="right") - 1
        since = np.maximum(0.0, k * self._period - self._times[i])
        slopes, targets = self._slopes[i], self._targets[i]
        with np.errstate(invalid="ignore"):  # 0 s at an infinite slope
            T = self._starts[i] + slopes * since
        T = np.where(slopes > 0, np.minimum(T, targets), np.maximum(T, targets))
        T = np.where(np.isinf(slopes), targets, T)
        taken: FloatArray = np.where(np.isnan(self._pieces.take(n)), np.nan, T)
        return taken


def _legs(pieces: Pieces, times: Sequence[float]) -> list[tuple[int, float, float]]:
    """(first sample, time, target) of each change of the delay to which it is on its way."""
    each = zip(pieces.firsts.tolist(), times, pieces.values.tolist(), strict=True)
    lasting = {time: (first, time, value) for first, time, value in each}  # the last one at a time
    found: list[tuple[int, float, float]] = []
    for first, time, target in lasting.values():
        if target == target and (not found or found[-1][2] != target):
            found.append((first, time, target))
    return [(0, 0.0, found[0][2]), *found[1:]]


def _on_the_way(now: float, target: float, slope: float, time: float) -> float:
    """The delay (s) after `time` (s)."""
    if isfinite(slope) and isfinite(time):
        there = now + slope * time
        return min(there, target) if slope > 0 else max(there, target)
    return target


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
