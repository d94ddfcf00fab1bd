"""The offset and drift between two clocks, from exchanges of four stamps, with hard bounds.

A question leaves at t1 and arrives at t2, the answer leaves at t3 and arrives at t4; t2 and t3 are
of the other clock, which is θ(t) = θ0 + γ (t - t̄) ahead of ours. With delays d_f and d_b

    F = t2 - t1 = d_f + θ,    B = t4 - t3 = d_b - θ.

Delays are not negative, so every exchange bounds the offset: -B <= θ <= F. (θ is that of some
moment between t1 and t4, so F and B are first increased by the largest drift times t4 - t1.) All
straight lines between the points (t4, -B) and (t1, F) are possible, and no data of this kind
distinguish them: the asymmetry of the fastest packets is unknown. The set of these lines is a
polygon in (θ0, γ). Its vertices bound each way at each instant; the middle at the drift that fits
best is the estimate that assumes that the fastest packets took equally long in both directions.

Source: NTP's exchange (RFC 5905); the line under all points after S. B. Moon, P. Skelly and
D. Towsley, "Estimation and removal of clock skew from network delay measurements", INFOCOM 1999;
both directions at once and the polygon: own construction.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import inf

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Largest drift between two clocks: crystals (100 ppm each) and slewing by time servers (500 ppm).
DRIFT = 1e-3
#: Longest time for which a drift is taken as constant, s.
PIECE = 300.0
#: Points of which hulls are computed; of more only the least of each interval of time.
POINTS = 4096


@dataclass(frozen=True, slots=True)
class OffsetLines:
    """The possible offsets θ(t) of another clock from `start` to `end`, s of our clock.

    `drift` (m,): of the vertices; `upper`, `lower` (m,): the largest and the least θ at `centre`
    with each drift, s; `theta`, `gamma`: the estimate at `centre`, s, and its drift.
    """

    start: float
    end: float
    centre: float
    drift: Floats
    upper: Floats
    lower: Floats
    theta: float
    gamma: float

    def estimate(self, t: Floats) -> Floats:
        """θ if the fastest packets took equally long both ways, (n,), s."""
        found: Floats = self.theta + self.gamma * (t - self.centre)
        return found

    def high(self, t: Floats) -> Floats:
        """No possible line is above this, (n,), s."""
        return np.asarray(_envelope(self.upper, self.drift, t - self.centre))

    def low(self, t: Floats) -> Floats:
        """No possible line is below this, (n,), s."""
        return -np.asarray(_envelope(-self.lower, -self.drift, t - self.centre))


def _envelope(level: Floats, slope: Floats, tau: Floats) -> Floats:
    best = np.full(tau.shape, -np.inf)
    for a, b in zip(level, slope, strict=True):
        np.maximum(best, a + b * tau, out=best)
    return best


@dataclass(frozen=True, slots=True)
class ClockEstimate:
    """Offsets in pieces of constant drift, in order. `steps`: times of our clock at which the other
    one jumped or changed its drift suddenly, s. `known`: an interval for θ from elsewhere, s.
    """

    pieces: tuple[OffsetLines, ...]
    steps: tuple[float, ...] = ()
    known: tuple[float, float] | None = None

    def offsets(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """Least, estimated and largest θ at the times `t` (n,), s; each (n,), s."""
        starts = np.array([p.start for p in self.pieces[1:]])
        at = np.searchsorted(starts, t, side="right")
        low, middle, high = np.empty(t.shape), np.empty(t.shape), np.empty(t.shape)
        for i, piece in enumerate(self.pieces):
            here = at == i
            low[here], high[here] = piece.low(t[here]), piece.high(t[here])
            middle[here] = piece.estimate(t[here])
        if self.known is not None:
            below, above = np.maximum(low, self.known[0]), np.minimum(high, self.known[1])
            if np.all(below <= above):
                low, high = below, above
                middle = np.clip(middle, low, high)
        return low, middle, high

    @property
    def drift(self) -> tuple[float, float, float]:
        """Least, estimated and largest drift of the longest piece, s/s."""
        longest = max(self.pieces, key=lambda p: p.end - p.start)
        return float(longest.drift.min()), longest.gamma, float(longest.drift.max())


def same_clock(start: float, end: float) -> ClockEstimate:
    """Two processes of one host from `start` to `end`, s: the offset is 0."""
    zero = np.zeros(1)
    return ClockEstimate((OffsetLines(start, end, start, zero, zero, zero, 0.0, 0.0),))


def estimate_clock(
    sent: Floats, forward: Floats, returned: Floats, backward: Floats,
    known: tuple[float, float] | None = None,
) -> ClockEstimate:  # fmt: skip
    """The offset of the other clock.

    `sent`, `returned` (n,): t1 and t4, s, in order of t1; `forward`, `backward` (n,): F and B, s;
    n >= 1. A piece that no line fits is halved until every half has one.
    """
    slack = DRIFT * (returned - sent)
    pieces = _pieces(sent, forward + slack, returned, backward + slack)
    return ClockEstimate(tuple(pieces), _steps(pieces), known)


def estimate_both_ways(
    arrived: Floats, forward: Floats, left: Floats, backward: Floats
) -> ClockEstimate:
    """The offset of the other clock, from packets of two directions that are no exchanges.

    `arrived` (n,): t2 with F (n,); `left` (m,): t3 with B (m,), s; each in order; n, m >= 1. Their
    times, and those of the estimate, are of the other clock: θ is there exactly what is in F and B.
    """
    pieces = _parts(arrived, forward, left, backward)
    return ClockEstimate(tuple(pieces), _steps(pieces))


def estimate_one_way(
    arrived: Floats, forward: Floats, least: float = 0.0, most: float = inf
) -> ClockEstimate:
    """The offset of the other clock, from one direction: `arrived` (n,), t2 in order, with F (n,),
    s, n >= 1; times as in :func:`estimate_both_ways`.

    Delays are known to be between `least` and `most`, s. The estimate is the line under all points
    F - `least`, so the fastest packets are taken to have had the least delay. Without `most` no
    line below it is excluded.
    """
    empty = np.empty(0)
    if most == inf:
        left, backward = empty, empty
    else:
        left, backward = arrived, most - forward
    pieces = _parts(arrived, forward - least, left, backward, one_way=True)
    return ClockEstimate(tuple(pieces), _steps(pieces))


def _steps(pieces: list[OffsetLines]) -> tuple[float, ...]:
    return tuple(b.start for a, b in pairwise(pieces) if not _continuous(a, b))


def _parts(
    sent: Floats, F: Floats, returned: Floats, B: Floats, one_way: bool = False
) -> list[OffsetLines]:
    """The pieces of :func:`_pieces` for points that belong to no exchange, halved by time.

    A piece without F or without B belongs to the one before it, and so does one too short to be
    halved that no line fits, since the clock jumped in it. Raises ValueError where these are more
    than the others.
    """
    found = list(_halves(sent, F, returned, B, one_way))
    pieces = [piece for piece in found if piece is not None]
    if 2 * len(pieces) <= len(found):
        raise ValueError("there is no line between the packets of both ways")
    return pieces


def _halves(
    sent: Floats, F: Floats, returned: Floats, B: Floats, one_way: bool
) -> Iterator[OffsetLines | None]:
    """The pieces in order, None where no line fits."""
    times = np.concatenate([sent, returned])
    start, end = float(times.min()), float(times.max())
    lines = None
    if end - start <= PIECE:
        lines = _lines(sent, F, returned, B, one_way)
    half = (start + end) / 2
    halves = [(sent <= half, returned <= half), (sent > half, returned > half)]
    whole = [h for h in halves if h[0].any() and (one_way or h[1].any())]
    smaller = all(a.sum() + b.sum() < times.size for a, b in whole)
    if lines is not None or not whole or not smaller:
        yield lines if lines is not None else _lines(sent, F, returned, B, one_way)
        return
    for a, b in whole:
        yield from _halves(sent[a], F[a], returned[b], B[b], one_way)


def _pieces(sent: Floats, F: Floats, returned: Floats, B: Floats) -> list[OffsetLines]:
    lines = None
    if sent[-1] - sent[0] <= PIECE:
        lines = _lines(sent, F, returned, B)
    if lines is not None:
        return [lines]
    half = sent.size // 2
    first, second = slice(None, half), slice(half, None)
    return [
        piece
        for part in (first, second)
        for piece in _pieces(sent[part], F[part], returned[part], B[part])
    ]


def _continuous(a: OffsetLines, b: OffsetLines) -> bool:
    t = np.array([b.start])
    return bool(a.low(t)[0] <= b.high(t)[0] and b.low(t)[0] <= a.high(t)[0])


def _lines(
    sent: Floats, F: Floats, returned: Floats, B: Floats, one_way: bool = False
) -> OffsetLines | None:
    """All lines between the points; None if there are none. The estimate is in the middle; with
    `one_way` it is the highest.
    """
    start, end = float(sent[0]), float(max(sent[-1], returned.max(initial=-inf)))
    centre = (start + end) / 2
    above = _lower_hull(sent - centre, F)  # (2, i)
    below = _lower_hull(returned - centre, B)  # (2, j): B + θ >= 0
    slopes = np.concatenate([_slopes(above), -_slopes(below), [-DRIFT, DRIFT]])
    drift = np.unique(np.clip(slopes, -DRIFT, DRIFT))

    def upper(g: Floats) -> Floats:
        return np.asarray((above[1] - g[:, None] * above[0]).min(axis=1))

    def lower(g: Floats) -> Floats:
        return np.asarray((-below[1] - g[:, None] * below[0]).max(axis=1, initial=-inf))

    drift = _where_positive(drift, upper(drift) - lower(drift))
    if not drift.size:
        return None
    high, low = upper(drift), lower(drift)
    # Less of it: more delay in total.
    fit = F.size * high + drift * (sent - centre).sum()
    if not one_way:
        fit -= B.size * low + drift * (returned - centre).sum()
    best = int(np.argmax(fit))
    theta = float(high[best]) if one_way else float(high[best] + low[best]) / 2
    return OffsetLines(start, end, centre, drift, high, low, theta, float(drift[best]))


def _where_positive(x: Floats, y: Floats) -> Floats:
    """The points of `x` (m,) where a concave, piecewise linear `y` (m,) is not negative,
    and where it is zero between them.
    """
    inside = y >= 0
    if not inside.any():
        return x[:0]
    first, last = int(np.argmax(inside)), x.size - 1 - int(np.argmax(inside[::-1]))
    ends = list(x[inside])
    for i, j in ((first - 1, first), (last, last + 1)):
        if i >= 0 and j < x.size:
            ends.append(x[i] + (x[j] - x[i]) * y[i] / (y[i] - y[j]))
    return np.unique(np.array(ends))


def _slopes(hull: Floats) -> Floats:
    return np.asarray(np.diff(hull[1]) / np.diff(hull[0]))


def _lower_hull(t: Floats, y: Floats) -> Floats:
    """The lower convex hull of points (n,), (n,): its vertices (2, m), t increasing."""
    if not t.size:
        return np.empty((2, 0))
    order = np.lexsort((y, t))
    t, y = t[order], y[order]
    first = np.concatenate([[True], np.diff(t) > 0])  # of points at one time, the lowest
    t, y = _thinned(t[first], y[first])
    kept: list[tuple[float, float]] = []
    for point in zip(t.tolist(), y.tolist(), strict=True):
        while len(kept) > 1 and _turns_down(kept[-2], kept[-1], point):
            kept.pop()
        kept.append(point)
    return np.array(kept).T


def _turns_down(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
    return (b[1] - a[1]) * (c[0] - a[0]) >= (c[1] - a[1]) * (b[0] - a[0])


def _thinned(t: Floats, y: Floats) -> tuple[Floats, Floats]:
    """The lowest point of each of `POINTS` intervals: fewer bounds, none of them wrong."""
    if t.size <= POINTS:
        return t, y
    edges = np.linspace(0, t.size, POINTS + 1).astype(np.int64)[:-1]
    lowest = np.minimum.reduceat(y, edges)
    keep = np.flatnonzero(y == np.repeat(lowest, np.diff(np.append(edges, t.size))))
    return t[keep], y[keep]
