"""Outages: loss models in seconds. During an outage all packets are lost.

Source: own construction; random outages follow each other after exponentially distributed times.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from math import ceil, inf, isfinite
from typing import TYPE_CHECKING

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.links.keys import Keyed, Rate, Seconds, Table
from cosim.links.laws import BoolArray, FloatArray, decimal_fraction
from cosim.links.losses import Losses
from cosim.links.semantics import Cycle

if TYPE_CHECKING:
    from numpy.random import Generator

AHEAD = 64  # outages drawn at once


class Outage(Keyed, frozen=True, tag="outage"):
    """Everything sent in [start + i·every, start + i·every + length), i = 0, 1, …, is lost (s)."""

    length: Seconds
    every: Seconds
    start: Seconds

    @classmethod
    def chosen(cls, table: Table) -> type[Keyed]:
        """In cycles, at random, or of random length, as the keys say. Raises ScenarioError."""
        keys = set(table) - {"law", "length"}
        if keys == {"longest", "pause"}:
            return UniformOutage
        if keys == {"rate"}:
            return RandomOutage
        if "every" not in keys or keys & {"rate", "longest", "pause"}:
            raise ScenarioError(
                'loss.law = "outage" needs either every (and start) or rate, or longest and pause'
            )
        return cls

    @classmethod
    def completed(cls, table: Table) -> Table:
        """The first outage begins after one cycle unless `start` is given."""
        return {"start": table["every"], **table}

    def __post_init__(self) -> None:
        """Refuse what never ends or never begins. Raises ScenarioError."""
        _check_length(self.length)
        if not (isfinite(self.every) and self.every > self.length):
            raise ScenarioError(
                f"every = {self.every:g} s; expected more than the outage's length,"
                f" {self.length:g} s"
            )
        if not (isfinite(self.start) and self.start >= 0):
            raise ScenarioError(f"start = {self.start:g} s; expected 0 or more")

    @property
    def share(self) -> float:
        """length/every."""
        return self.length / self.every

    @property
    def longest(self) -> float:
        """The length, s."""
        return self.length

    def stream(self, period: Fraction, rng: Generator) -> Losses:
        """Nothing is drawn."""
        return _Outage(self, period)


class _Outage:
    def __init__(self, model: Outage, period: Fraction) -> None:
        self._cycle, self._sample = Cycle(period, model.every), 0
        self._begins = ceil(decimal_fraction(model.start) / period)  # no packet before is lost
        start = decimal_fraction(model.start) % decimal_fraction(model.every)
        self._from = self._cycle.parts(start)
        self._parts = self._cycle.parts(start + decimal_fraction(model.length)) - self._from

    def take(self, n: int) -> BoolArray:
        phase = self._cycle.phases(self._sample, n) - self._from
        lost: BoolArray = phase % self._cycle.ratio.denominator < self._parts
        lost[: max(0, self._begins - self._sample)] = False
        self._sample += n
        return lost


class RandomOutage(Keyed, frozen=True, tag="outage"):
    """Outages of `length` (s); from the end of one to the next, a time ~ Exp(rate), rate in 1/s.

    The link starts up. Two outages can follow each other so closely that nothing arrives between.
    """

    length: Seconds
    rate: Rate

    def __post_init__(self) -> None:
        """Check the times and the rate. Raises ScenarioError."""
        _check_length(self.length)
        if not (isfinite(self.rate) and self.rate > 0):
            raise ScenarioError(f"rate = {self.rate:g} 1/s; expected more than 0")

    @property
    def share(self) -> float:
        """An outage's part of a round, length / (length + 1/rate)."""
        return self.length / (self.length + 1 / self.rate)

    @property
    def longest(self) -> float:
        """inf: unbounded."""
        return inf

    def stream(self, period: Fraction, rng: Generator) -> Losses:
        """One draw an outage. Raises ScenarioError for more than 10000 of them a sample."""
        if float(period) > 10**4 * (self.length + 1 / self.rate):
            raise ScenarioError(
                f"length = {self.length:g} s, rate = {self.rate:g} 1/s; expected at most 10000"
                f" outages in a sampling period of {float(period):g} s"
            )

        def draw(n: int) -> tuple[FloatArray, FloatArray]:
            return rng.exponential(1 / self.rate, n), np.full(n, self.length)

        return _Alternating(draw, period)


class _Alternating:
    """Up and down in turn. Carry: the outages that are not over. Drawn in the same portions.

    `draw(n)`: the next n times up and the lengths of the outages after them, (n,) each, s.
    """

    def __init__(
        self, draw: Callable[[int], tuple[FloatArray, FloatArray]], period: Fraction
    ) -> None:
        self._draw, self._period = draw, float(period)
        self._sample = 0
        self._starts, self._ends = np.empty(0), np.empty(0)  # (outages,), s
        self._end = 0.0  # of the last outage drawn, s

    def take(self, n: int) -> BoolArray:
        t = self._period * np.arange(self._sample, self._sample + n, dtype=np.float64)
        self._sample += n
        if not n:
            return np.empty(0, bool)
        starts, ends = [self._starts], [self._ends]
        while self._end <= t[-1]:
            up, length = self._draw(AHEAD)
            drawn: FloatArray = np.cumsum(up + length)
            drawn += self._end
            self._end = float(drawn[-1])
            ends.append(drawn)
            starts.append(drawn - length)
        begun, over = np.concatenate(starts), np.concatenate(ends)
        last = np.searchsorted(begun, t, side="right") - 1  # the last that began, -1: none
        kept = slice(max(0, last[-1]), None)
        self._starts, self._ends = begun[kept], over[kept]
        lost: BoolArray = (last >= 0) & (t < over[np.maximum(last, 0)])
        return lost


class UniformOutage(Keyed, frozen=True, tag="outage", rename={"shortest": "length"}):
    """Outages of random length, U[shortest, longest] (s), `pause` (s) from one to the next.

    The link starts up, for `pause`.
    """

    shortest: Seconds
    longest: Seconds
    pause: Seconds

    def __post_init__(self) -> None:
        """Check the lengths and the pause. Raises ScenarioError."""
        _check_length(self.longest)
        if not 0 <= self.shortest <= self.longest:
            raise ScenarioError(
                f"length = {self.shortest:g} s; expected from 0 to longest = {self.longest:g} s"
            )
        if not (isfinite(self.pause) and self.pause > 0):
            raise ScenarioError(f"pause = {self.pause:g} s; expected a time greater than 0")

    @property
    def share(self) -> float:
        """E L/(E L + pause), E L = (shortest + longest)/2."""
        mean = 0.5 * (self.shortest + self.longest)
        return mean / (mean + self.pause)

    def stream(self, period: Fraction, rng: Generator) -> Losses:
        """One draw an outage. Raises ScenarioError for more than 10000 of them a sample."""
        if float(period) > 10**4 * self.pause:
            raise ScenarioError(
                f"pause = {self.pause:g} s; expected at most 10000 outages in a sampling period of"
                f" {float(period):g} s"
            )

        def draw(n: int) -> tuple[FloatArray, FloatArray]:
            length = self.shortest + (self.longest - self.shortest) * rng.random(n)
            return np.full(n, self.pause), length

        return _Alternating(draw, period)


def _check_length(length: float) -> None:
    if not (isfinite(length) and length > 0):
        raise ScenarioError(f"length = {length:g} s; expected a time greater than 0")
