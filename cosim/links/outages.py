"""Outages: loss models in seconds. For a while nothing that is sent arrives, at all rates alike."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import ceil, inf, isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.links.grid import Cycle
from cosim.links.laws import FloatArray, decimal_fraction, facts_of
from cosim.links.losses import Losses
from cosim.links.reachability import BoolArray

if TYPE_CHECKING:
    from numpy.random import Generator

AHEAD = 64  # outages drawn at once


@dataclass(frozen=True, slots=True)
class Outage:
    """Everything sent in [start + i·every, start + i·every + length), i = 0, 1, …, is lost (s)."""

    length: float
    every: float
    start: float

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

    def facts(self) -> dict[str, Any]:
        """Name, length, every, start (s)."""
        return facts_of("outage", self)


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


@dataclass(frozen=True, slots=True)
class RandomOutage:
    """Outages of `length` (s); from the end of one to the next, a time ~ Exp(rate), rate in 1/s.

    The link starts up. Two outages can follow each other so closely that nothing arrives between.
    """

    length: float
    rate: float

    def __post_init__(self) -> None:
        """Refuse what is no time or no rate. Raises ScenarioError."""
        _check_length(self.length)
        if not (isfinite(self.rate) and self.rate > 0):
            raise ScenarioError(f"rate = {self.rate:g} 1/s; expected more than 0")

    @property
    def share(self) -> float:
        """An outage's part of a round, length / (length + 1/rate)."""
        return self.length / (self.length + 1 / self.rate)

    @property
    def longest(self) -> float:
        """There is no bound."""
        return inf

    def stream(self, period: Fraction, rng: Generator) -> Losses:
        """One draw an outage. Raises ScenarioError for more than 10000 of them a sample."""
        if float(period) > 10**4 * (self.length + 1 / self.rate):
            raise ScenarioError(
                f"length = {self.length:g} s, rate = {self.rate:g} 1/s; expected at most 10000"
                f" outages in a sampling period of {float(period):g} s"
            )
        return _RandomOutage(self, period, rng)

    def facts(self) -> dict[str, Any]:
        """Name, length (s), rate (1/s)."""
        return facts_of("outage", self)


class _RandomOutage:
    """Carry: the outages that are not over. Always drawn in the same portions."""

    def __init__(self, model: RandomOutage, period: Fraction, rng: Generator) -> None:
        self._model, self._period, self._rng = model, float(period), rng
        self._sample = 0
        self._starts = np.empty(0)  # (outages,), s
        self._end = 0.0  # of the last outage drawn, s

    def take(self, n: int) -> BoolArray:
        t = self._period * np.arange(self._sample, self._sample + n, dtype=np.float64)
        self._sample += n
        if not n:
            return np.empty(0, bool)
        drawn = [self._starts]
        while self._end <= t[-1]:
            up = self._rng.exponential(1 / self._model.rate, AHEAD)  # s
            ends: FloatArray = np.cumsum(up + self._model.length)
            ends += self._end
            self._end = float(ends[-1])
            drawn.append(ends - self._model.length)
        starts = np.concatenate(drawn)
        last = np.searchsorted(starts, t, side="right") - 1  # the last that began, -1: none
        self._starts = starts[max(0, last[-1]) :]
        lost: BoolArray = (last >= 0) & (t < starts[np.maximum(last, 0)] + self._model.length)
        return lost


def _check_length(length: float) -> None:
    if not (isfinite(length) and length > 0):
        raise ScenarioError(f"length = {length:g} s; expected a time greater than 0")
