"""Times at which a link's sender sends and its receiver reads, as ticks and parts of a cycle."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import ceil, gcd, isfinite

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.links.laws import IntArray, decimal_fraction

TOLERANCE = 1e-9  # ticks; 0.3 s / 5 ms is 60 of them, not 61


@dataclass(frozen=True, slots=True)
class Grid:
    """Times of sending and receiving: every n_s and n_r ticks of h (s)."""

    n_s: int
    n_r: int
    h: float

    def __post_init__(self) -> None:
        """Check the grid. Raises ScenarioError."""
        if self.n_s < 1 or self.n_r < 1:
            raise ScenarioError(f"periods {self.n_s}, {self.n_r} ticks; expected 1 or more")
        if not (isfinite(self.h) and self.h > 0):
            raise ScenarioError(f"base step {self.h:g} s; expected more than 0")

    @property
    def sending_period(self) -> Fraction:
        """Sending period n_s·h, s, exactly."""
        return self.n_s * decimal_fraction(self.h)

    @property
    def receiving_period(self) -> Fraction:
        """Receiving period n_r·h, s, exactly."""
        return self.n_r * decimal_fraction(self.h)

    def sent(self, rows: int) -> int:
        """Number of samples sent up to the last of `rows` reads."""
        return self.n_r * (rows - 1) // self.n_s + 1 if rows else 0

    def ticks(self, T: float) -> int:
        """ceil(T/h) of a finite time (s), forgiving 1e-9 tick."""
        return ceil(T / self.h - TOLERANCE)

    def up(self, ticks: int) -> int:
        """The next tick difference K - n_s·j that exists: a multiple of gcd(n_s, n_r)."""
        g = gcd(self.n_s, self.n_r)
        return -(-ticks // g) * g


@dataclass(frozen=True, slots=True)
class Cycle:
    """A cycle of `length` (s), read every `period` (s) from t = 0, in exact fractions.

    Looks are counted in parts: a look is `p` parts after the one before, and `q` parts are the
    cycle, p/q = period/length in lowest terms.
    """

    period: Fraction
    length: float

    @property
    def ratio(self) -> Fraction:
        """period/length, as close as a denominator of 10^9 allows."""
        return (self.period / decimal_fraction(self.length)).limit_denominator(10**9)

    def parts(self, t: Fraction) -> int:
        """The first part at or after t (s)."""
        return ceil(t / decimal_fraction(self.length) * self.ratio.denominator)

    def phases(self, first: int, n: int) -> IntArray:
        """(n,): the parts since the cycle began, of looks `first`, first + 1, …"""
        p, q = self.ratio.numerator, self.ratio.denominator
        phases: IntArray = (first * p % q + p % q * np.arange(n, dtype=np.int64)) % q
        return phases
