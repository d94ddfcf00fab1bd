"""Families of candidates, the simple ones first; each is drawn from (seed, its name, the pass).

=========  =========================================================================================
constant   the same delay throughout: on all channels, then another on each
wave       square waves and sawteeth of any period: a link that fills and empties
draw       what the scenario's own laws, presets and recorded paths do, cut and shifted
segment    constant segments of 0.1 to 2 s
single     a single changed segment: at any time, long and short, on one channel or on all
=========  =========================================================================================

Two more have modules of their own: :mod:`cosim.falsify.greedy`, and :mod:`cosim.falsify.optimizer`,
which learns from its runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import count, islice, product
from typing import TYPE_CHECKING

import numpy as np

from cosim.base.random_numbers import generator
from cosim.falsify.bounds import MovingChannel
from cosim.falsify.evaluation import Problem
from cosim.falsify.paths import Candidate, DelayPath, Piece
from cosim.links.laws import FloatArray, decimal_fraction

if TYPE_CHECKING:
    from numpy.random import Generator

#: Candidates that are known before the results of any of them.
ROUND = 64
#: Lengths of segments, s.
SHORTEST, LONGEST = 0.1, 2.0
#: Lengths of single changed segments, s.
SINGLE = (0.03, 0.1, 0.3, 1.0)
#: Levels of a ramp at most.
LEVELS = 256
#: Sets of channels that are moved together are all subsets up to so many channels.
SUBSETS = 3

Family = Callable[["Space", int], Iterator[Candidate]]


@dataclass(frozen=True, slots=True)
class Space:
    """The space of candidates of a `problem`; `seed`: of all that is drawn."""

    problem: Problem
    seed: int

    def random(self, family: str, turn: int) -> Generator:
        """The generator of a family in a pass."""
        return generator(self.seed, f"falsify:{family}:{turn}")

    @property
    def channels(self) -> tuple[MovingChannel, ...]:
        """The channels that may move."""
        return self.problem.channels

    @property
    def ticks(self) -> int:
        """The length of a run."""
        return self.problem.ticks

    def candidate(
        self, paths: Sequence[DelayPath], says: str, axes: Sequence[float | None] = ()
    ) -> Candidate:
        """A candidate with these paths, and quantiles of axes, numbers without a unit.

        By default the values are those of the scenario.
        """
        chosen = tuple(axes) or self.problem.nominal.axes
        return Candidate(tuple(paths), chosen, self.ticks, says)

    def axes(self, random: Generator, share: float = 0.5) -> tuple[float | None, ...]:
        """Values of all axes: in a `share` of cases those of the scenario, else at random.

        A third of those at random are at an end.
        """
        n = len(self.problem.axes)
        if not n or (self.channels and random.random() < share):
            return (None,) * n
        return tuple(
            float(random.choice((0.001, 0.999)) if random.random() < 1 / 3 else random.random())
            for _ in range(n)
        )


def bisected() -> Iterator[float]:
    """Numbers without a unit: 0, 1, 1/2, 1/4, 3/4, 1/8, …, soon one near any from 0 to 1."""
    yield from (0.0, 1.0)
    for k in count(1):
        yield from (i / 2**k for i in range(1, 2**k, 2))


def constant(space: Space, turn: int) -> Iterator[Candidate]:
    """The same delay on all channels, then one for each, and with it the axes."""
    random = space.random("constant", turn)
    for u in islice(bisected(), 33 if turn == 0 else 0):
        paths = [DelayPath.constant(_level(c, u)) for c in space.channels]
        if paths:
            yield space.candidate(paths, f"constant delays, {_range(space.channels, u)}")
    for axes in islice(_corners(len(space.problem.axes)), 64 if turn == 0 else 0):
        yield space.candidate([c.base for c in space.channels], "other values", axes)
    if 2 <= len(space.channels) <= 3 and turn == 0:
        for us in product((0.0, 0.25, 0.5, 0.75, 1.0), repeat=len(space.channels)):
            yield _constants(space, us, space.problem.nominal.axes)
    while True:
        us = tuple(random.random(len(space.channels)).tolist())
        yield _constants(space, us, space.axes(random))


def _constants(space: Space, us: Sequence[float], axes: Sequence[float | None]) -> Candidate:
    paths = [DelayPath.constant(_level(c, u)) for c, u in zip(space.channels, us, strict=True)]
    values = ", ".join(f"{1e3 * p.values[0]:.4g}" for p in paths)
    return space.candidate(paths, f"constant delays, {values} ms", axes)


def _level(channel: MovingChannel, u: float) -> float:
    return channel.low + u * (channel.high - channel.low)


def _range(channels: Sequence[MovingChannel], u: float) -> str:
    levels = sorted({f"{1e3 * _level(c, u):.4g}" for c in channels})
    return f"{' and '.join(levels)} ms"


def _corners(n: int) -> Iterator[tuple[float | None, ...]]:
    """Each axis at each end, then all axes at their ends."""
    for i in range(n):
        for u in (0.001, 0.999):
            yield tuple(u if j == i else None for j in range(n))
    if n > 1:
        yield from product((0.001, 0.999), repeat=min(n, 6))


# ---- waves --------------------------------------------------------------------------------------


def wave(space: Space, turn: int) -> Iterator[Candidate]:
    """Square waves and sawteeth between the bounds, periods from two samples to half the run.

    Where packets may be lost, also outages that come again after a sample or more.
    """
    random = space.random("wave", turn)
    shapes: tuple[str, ...] = ("square", "rising", "falling")
    if any(c.longest_loss for c in space.channels):
        shapes += ("losing",)
    while space.channels:
        shape = shapes[int(random.integers(len(shapes)))]
        shortest = min(2 * c.step for c in space.channels)
        period = int(np.exp(random.uniform(np.log(shortest), np.log(max(4, space.ticks // 2)))))
        low, high = sorted(random.random(2).tolist()) if random.random() < 0.3 else (0.0, 1.0)
        opposite = random.random() < 0.3
        phase = float(random.random())
        moved = _moved(space, random)
        paths = [
            _wave(c, (low, high), shape, (period, (phase + opposite * 0.5 * i) % 1), space.ticks)
            if i in moved else c.base
            for i, c in enumerate(space.channels)
        ]  # fmt: skip
        says = f"a {shape} wave with a period of {period * space.problem.h:.4g} s"
        if shape == "losing":
            says = "outages one after the other"
        yield space.candidate(paths, says, space.axes(random, 0.8))


def _moved(space: Space, random: Generator) -> set[int]:
    """Numbers of the channels that move: in half of the cases all."""
    n = len(space.channels)
    if n == 1 or random.random() < 0.5:
        return set(range(n))
    return set(random.choice(n, int(random.integers(1, n + 1)), replace=False).tolist())


def _wave(
    channel: MovingChannel,
    between: tuple[float, float],
    shape: str,
    time: tuple[int, float],
    ticks: int,
) -> DelayPath:
    """`time`: the period in ticks, and the phase in periods."""
    (low, high), (period, phase) = (_level(channel, u) for u in between), time
    if shape == "losing":
        gap = max(1, round(low * period / channel.step)) * channel.step
        edges = np.arange(int(phase * gap), ticks, channel.longest_loss + gap)
        lost = [Piece(a, a + channel.longest_loss, float("nan")) for a in edges.tolist()]
        return DelayPath.changed(channel.nominal, lost) if channel.longest_loss else channel.base
    if shape == "square":
        half = max(channel.step, period // 2)
        edges = np.arange(-int(phase * 2 * half), ticks, half)
        values = np.where(np.arange(len(edges)) % 2 == 0, high, low)
        return DelayPath.of(np.maximum(edges, 0), values)
    step = max(channel.step, period // LEVELS // channel.step * channel.step)
    k = np.arange(0, ticks, step)
    share = (k / period + phase) % 1.0
    share = share if shape == "rising" else 1.0 - share
    return DelayPath.of(k, low + (high - low) * share)


# ---- laws ---------------------------------------------------------------------------------------


def draw(space: Space, turn: int) -> Iterator[Candidate]:
    """Delays that a law of each channel draws, from some place on, shifted within the bounds."""
    random = space.random("draw", turn)
    while any(c.laws for c in space.channels):
        shift = float(random.random()) if random.random() < 0.5 else -1.0
        paths = [
            _drawn(c, random, shift, space.ticks) if c.laws else c.base for c in space.channels
        ]
        yield space.candidate(paths, "delays drawn by a law of the links", space.axes(random, 0.8))


def _drawn(channel: MovingChannel, random: Generator, shift: float, ticks: int) -> DelayPath:
    law = channel.laws[int(random.integers(len(channel.laws)))]
    n, period = -(-ticks // channel.step), channel.step * decimal_fraction(channel.h)
    limit = law.limit(period)
    cut = int(random.integers(n)) if law.limit(period) is None else 0
    stream = law.stream(period, random)
    stream.take(cut)
    T = stream.take(n if limit is None else min(n, limit))
    T = np.where(np.isfinite(T), T, np.nan)
    if shift >= 0 and np.isfinite(T).any():
        lowest, highest = float(np.nanmin(T)), float(np.nanmax(T))
        room = channel.low - lowest, channel.high - highest
        T = T + min(room) + shift * (max(room) - min(room))
    return DelayPath.sampled(T, channel.step)


# ---- segments -----------------------------------------------------------------------------------


def segment(space: Space, turn: int) -> Iterator[Candidate]:
    """Constant segments on every channel; half of their values are at an end of the bounds."""
    random = space.random("segment", turn)
    while space.channels:
        longest = float(np.exp(random.uniform(np.log(SHORTEST), np.log(LONGEST))))
        sparse = float(random.choice((0.0, 0.0, 0.5, 0.9)))
        moved = _moved(space, random)
        paths = [
            _segments(c, random, longest, sparse, space.ticks) if i in moved else c.base
            for i, c in enumerate(space.channels)
        ]
        says = f"constant segments of up to {longest:.3g} s"
        yield space.candidate(paths, says, space.axes(random, 0.8))


def _segments(
    channel: MovingChannel, random: Generator, longest: float, sparse: float, ticks: int
) -> DelayPath:
    n = int(ticks * channel.h / longest * 2) + 2
    lengths = random.uniform(0.5, 1.0, n) * longest / channel.h
    edges = np.concatenate(([0], np.cumsum(np.maximum(channel.step, lengths.astype(np.int64)))))
    edges = edges[edges < ticks]
    values = random_values(channel, random, len(edges))
    values = np.where(random.random(len(edges)) < sparse, channel.nominal, values)
    return DelayPath.of(edges, values)


def random_values(channel: MovingChannel, random: Generator, n: int) -> FloatArray:
    """`n` delays of a channel, (n,), s: half of them at an end of the bounds; some lost, if any."""
    u = random.random(n)
    u = np.where(random.random(n) < 0.5, np.round(u), u)
    values: FloatArray = channel.low + u * (channel.high - channel.low)
    if channel.longest_loss:
        values = np.where(random.random(n) < 0.3, np.nan, values)
    return values


def single(space: Space, turn: int) -> Iterator[Candidate]:
    """A single changed segment; times are spread over the run, long segments first."""
    random = space.random("single", turn)
    for k in count():
        if not space.channels:
            return
        length = SINGLE[len(SINGLE) - 1 - k % len(SINGLE)]
        u = (0.5 + 0.6180339887498949 * k + float(random.random()) * 0.05 + 0.37 * turn) % 1.0
        begin = int(u * space.ticks)
        end = min(space.ticks, begin + max(1, round(length / space.problem.h)))
        which = int(random.integers(-1, len(space.channels)))
        up = bool(random.integers(2))
        lost = random.random() < 0.3
        paths = []
        for i, c in enumerate(space.channels):
            one = Piece(begin, end, c.high if up else c.low)
            if lost and c.longest_loss:
                one = Piece(begin, begin + max(end - begin, c.longest_loss), float("nan"))
            changed = DelayPath.changed(c.nominal, [one])
            paths.append(changed if which in (-1, i) else c.base)
        says = f"one segment of {length:g} s at {begin * space.problem.h:.4g} s"
        yield space.candidate(paths, says)
