"""Paths: the delay of a channel over time; candidates: the paths of all channels, and values.

A path is piecewise constant. Its edges are ticks of the base step, so that it means the same for
every link of the channel, whatever its period.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from hashlib import sha256
from math import inf, isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.links.laws import Delays, FloatArray, IntArray
from cosim.links.segments import Pieces, Segment, Segments, following

#: Digits of a delay (s) that count: microseconds.
DIGITS = 6
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class DelayPath:
    """The delay `values` (n,), s, NaN: lost, each from tick `edges` (n,) on; the first is 0."""

    edges: Ints
    values: FloatArray

    @staticmethod
    def constant(delay: float) -> DelayPath:
        """The same delay (s) throughout."""
        return DelayPath(np.zeros(1, np.int64), np.array([round(delay, DIGITS)]))

    @staticmethod
    def of(edges: Any, values: Any) -> DelayPath:
        """A path whose equal neighbours are joined; of equal edges the last one counts."""
        e, v = np.asarray(edges, np.int64), np.round(np.asarray(values, np.float64), DIGITS)
        last = np.append(np.diff(e) > 0, True)
        e, v = e[last], v[last]
        same = (v[1:] == v[:-1]) | (np.isnan(v[1:]) & np.isnan(v[:-1]))
        new = np.append(True, ~same)
        return DelayPath(e[new], v[new])

    @staticmethod
    def sampled(values: FloatArray, step: int) -> DelayPath:
        """A path with `values` (n,) one every `step` ticks; the last one stays."""
        return DelayPath.of(step * np.arange(len(values), dtype=np.int64), values)

    @staticmethod
    def changed(delay: float, pieces: Sequence[Piece]) -> DelayPath:
        """`delay` (s), but for these pieces, which do not overlap and are in order."""
        edges, values = [0], [delay]
        for piece in pieces:
            edges += [piece.begin, piece.end]
            values += [piece.value, delay]
        return DelayPath.of(edges, values)

    def pieces(self, delay: float, end: int) -> list[Piece]:
        """The pieces before tick `end` whose value is not `delay` (s)."""
        ends = np.append(self.edges[1:], max(end, int(self.edges[-1]) + 1))
        return [
            Piece(int(a), min(int(b), end), float(v))
            for a, b, v in zip(self.edges, ends, self.values, strict=True)
            if v != delay and a < end
        ]

    def at(self, ticks: IntArray) -> FloatArray:
        """The values at `ticks` (n,)."""
        found: FloatArray = self.values[np.searchsorted(self.edges, ticks, side="right") - 1]
        return found

    @cached_property
    def key(self) -> bytes:
        """Equal for equal paths."""
        return self.edges.tobytes() + self.values.tobytes()


@dataclass(frozen=True, slots=True)
class Piece:
    """The delay `value` (s, NaN: lost) in the ticks from `begin` to before `end`."""

    begin: int
    end: int
    value: float


@dataclass(frozen=True, eq=False)
class Candidate:
    """A network to try, and values: a path for each channel, and the choice of each axis.

    `axes`: the quantile of each axis in (0, 1), None: the value of the scenario. `ticks`: length
    of the run. `says`: what it is, in words; no part of its identity.
    """

    paths: tuple[DelayPath, ...]
    axes: tuple[float | None, ...]
    ticks: int
    says: str = ""

    @cached_property
    def key(self) -> str:
        """Its name: a hash of everything that its run follows from."""
        digest = sha256(repr((self.axes, self.ticks)).encode())
        for path in self.paths:
            digest.update(len(path.key).to_bytes(8, "little") + path.key)
        return digest.hexdigest()[:16]


@dataclass(frozen=True, eq=False)
class PathLaw:
    """A path as a delay law, with the bounds of its channel: plans of all candidates are alike.

    `h`: the base step, s, exactly; `speeds`: the fastest the delay rises and falls, s/s. The rows
    are those of the law "segments" with the same delays.
    """

    path: DelayPath
    h: Fraction
    minimum: float
    maximum: float
    loses_packets: bool
    speeds: tuple[float, float] = (inf, inf)

    @property
    def mean(self) -> float:
        """The mean of the delays that arrive, each value counted once, s."""
        return float(np.nanmean(self.path.values))

    def limit(self, period: Fraction) -> int | None:
        """Unlimited."""
        return None

    def stream(self, period: Fraction, rng: Any) -> Delays:
        """The delays in order; nothing is drawn."""
        n = int(period / self.h)
        pieces = Pieces(-(-self.path.edges // n), self.path.values)
        times = [float(edge * self.h) for edge in self.path.edges.tolist()]
        return following(pieces, times, self.speeds, float(period))

    def facts(self) -> dict[str, Any]:
        """No facts: they are not kept of a run in memory."""
        return {}


def as_law(law: PathLaw, delay: float, ticks: int) -> Segments:
    """The law in a run of `ticks` ticks as a scenario has it: `delay` (s) outside of segments."""
    found = [
        Segment(
            float(x.begin * law.h),
            float(x.end * law.h),
            None if np.isnan(x.value) else x.value,
            bool(np.isnan(x.value)),
        )
        for x in law.path.pieces(delay, ticks)
    ]
    rise, fall = (speed if found and isfinite(speed) else None for speed in law.speeds)
    return Segments(delay, tuple(found), rise, fall)
