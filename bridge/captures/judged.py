"""The delays of recorded directions, freed of the difference of two clocks where there is one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf

import numpy as np

from bridge.captures.ways import RecordedWay
from bridge.ping.clocks import (
    DRIFT,
    ClockEstimate,
    Floats,
    estimate_both_ways,
    estimate_one_way,
)
from bridge.ping.exchanges import Integers
from cosim.base.errors import ScenarioError

#: Intervals of time of which the fastest packets are compared, and what a drift has to exceed: in
#: deviations of these from a line, and in s over the whole recording.
INTERVALS, CLEAR, VISIBLE = 16, 10.0, 1e-5


@dataclass(frozen=True, slots=True)
class ClockKnowledge:
    """Knowledge of the clocks: `clocks` same, differ or auto (told by the stamps); the least and
    the largest delay that is possible, s.
    """

    clocks: str = "auto"
    least: float = 0.0
    most: float = inf


@dataclass(frozen=True, slots=True, eq=False)
class JudgedWays:
    """The delays of each direction, (n,) each, s, NaN: lost, in order of sending.

    `clock`: the receiver's clock less the sender's, less `base` (ns), at times of the receiver's
    clock from `origin` (ns); None: one clock. `below`, `above`: by how much delays there may be
    less and more, s; `why`: in words, why two clocks are taken for one or not; `least`: the delay
    that the fastest samples are taken to have had where only one direction is known, s.
    """

    delays: tuple[Floats, ...]
    clock: ClockEstimate | None
    base: int
    origin: int
    below: float
    above: float
    why: str
    least: float = 0.0

    @property
    def offset(self) -> tuple[float, float, float]:
        """Least, estimated and largest difference of the clocks at the origin, s."""
        if self.clock is None:
            return 0.0, 0.0, 0.0
        low, middle, high = (float(x[0]) for x in self.clock.offsets(np.zeros(1)))
        base = self.base * 1e-9
        return base + low, base + middle, base + high


def judge(ways: Sequence[RecordedWay], known: ClockKnowledge) -> JudgedWays:
    """The delays of one direction, or of the way there and the way back.

    Raises ScenarioError where no clock that runs steadily explains the stamps.
    """
    there = ways[0]
    sent, received = there.there
    F = received - sent
    base = int(np.median(F))
    if len(ways) == 2 and known.clocks == "differ":
        why = "the clocks are compared by packets of both directions"
    else:
        why = _why(F, sent, known.clocks)
    if not why:
        growth, clear = _drift(F, sent)
        said = "the stamps of both ends are taken for those of one clock"
        if clear:
            said += f"; delays change by {1e3 * growth:+.3g} ms a second: does a queue grow?"
        delays = tuple(_plain(way) for way in ways)
        return JudgedWays(delays, None, 0, int(received[0]), 0.0, 0.0, said)
    origin = int(received.min())
    x, f = _at(received, origin), _at(F, base)
    order = np.argsort(x, kind="stable")
    if len(ways) == 1:
        clock = estimate_one_way(x[order], f[order], known.least, known.most)
        low, middle, high = clock.offsets(x)
        below, above = high - middle, middle - low
        return JudgedWays(
            (_filled(there, f - middle),), clock, base, origin,
            float(below.max()), float(above.max()), why, known.least,
        )  # fmt: skip
    back = ways[1]
    left, came = back.there
    y, b = _at(left, origin), _at(came - left, -base)
    other = np.argsort(y, kind="stable")
    try:
        clock = estimate_both_ways(x[order], f[order], y[other], b[other])
    except ValueError:
        raise ScenarioError(
            "packets arrive before they were sent, whatever the clocks; expected two recordings "
            "of steady clocks, the first of the end that sends (with --back STREAM: receives) it"
        ) from None
    low, middle, high = clock.offsets(x)
    middle_back = clock.offsets(y)[1]
    return JudgedWays(
        (_filled(there, f - middle), _filled(back, b + middle_back)), clock, base, origin,
        float((high - middle).max()), float((middle - low).max()), why,
    )  # fmt: skip


def _at(t: Integers, origin: int) -> Floats:
    """Times (n,), ns, from `origin`, ns, in s."""
    return np.asarray((t - origin) * 1e-9, dtype=np.float64)


def _plain(way: RecordedWay) -> Floats:
    """The delays by the stamps, (n,), s."""
    sent, received = way.there
    return _filled(way, _at(received - sent, 0))


def _filled(way: RecordedWay, delay: Floats) -> Floats:
    found = np.full(way.sent.size, np.nan)
    found[~way.lost] = delay
    return found


def _why(F: Integers, sent: Integers, clocks: str) -> str:
    """The reason to take the stamps of both ends for those of two clocks; empty: one clock.

    `F` (n,): received less sent, `sent` (n,), in order, ns. Delays that grow faster than clocks
    drift are delays. Raises ScenarioError for a clock that does not run at the speed of the other.
    """
    if clocks == "same":
        if int(F.min()) < 0:
            raise ScenarioError(
                f"{int(np.sum(F < 0))} samples arrived up to {-int(F.min()) * 1e-9:.6g} s before "
                "they were sent; expected --clocks differ"
            )
        return ""
    drift, clear = _drift(F, sent)
    apart = int(np.abs(np.median(F))) > 86_400 * 10**9
    if clear and abs(drift) > DRIFT:
        if int(F.min()) >= 0 and not apart and clocks == "auto":
            return ""
        raise ScenarioError(
            f"one second of the sender's clock is {1 + drift:.6g} s of the receiver's, as "
            "simulated time is on a machine that is slower or faster; expected a difference below "
            f"{DRIFT:g}: record with one clock"
        )
    if apart:
        return "the stamps are of another clock, simulated time perhaps: more than a day apart"
    if int(F.min()) < 0:
        return (
            f"the clocks differ: {int(np.sum(F < 0))} samples arrived before they were sent, "
            f"up to {-int(F.min()) * 1e-9:.6g} s"
        )
    if clear:
        return "the clocks differ: the fastest samples drift"
    return "the clocks differ, as told by --clocks" if clocks == "differ" else ""


def _drift(F: Integers, sent: Integers) -> tuple[float, bool]:
    """The slope of the fastest samples over time, s/s, and True if it is clearly not 0."""
    if F.size < 4 * INTERVALS:
        return 0.0, False
    edges = np.linspace(0, F.size, INTERVALS + 1).astype(np.int64)
    rows = [a + int(np.argmin(F[a:b])) for a, b in pairwise(edges.tolist())]
    t, y = _at(sent[rows], int(sent[0])), _at(F[rows], int(F.min()))
    slope, level = np.polyfit(t - t.mean(), y, 1)
    rest = float(np.std(y - level - slope * (t - t.mean())))
    change = abs(float(slope)) * float(t[-1] - t[0])
    return float(slope), change > max(CLEAR * rest, VISIBLE)
