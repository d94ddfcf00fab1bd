"""Delays with a long tail: shifted gamma and shifted lognormal, cut off at a declared maximum.

A network has a shortest transit time (the wire) and a tail (the queues). The theory requires
bounded delays (Theorems 4 and 5), so each law declares its `maximum`, and a larger draw is replaced
by it. The `mean` is that of the bounded law, in closed form.

NumPy draws the random numbers; another version of NumPy or another processor may round them
differently. The table stored with a run replays the delays bit for bit.

Source: own construction from the gamma and lognormal distributions.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import erfc, exp, isfinite, lgamma, log, sqrt
from typing import TYPE_CHECKING

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.links.laws import Delays, FloatArray, Formula, check_delay, check_hold, hold_delays

if TYPE_CHECKING:
    from numpy.random import Generator

SIGMA_MAXIMUM = 10.0  # beyond it every delay is the shift or the maximum


@dataclass(frozen=True, slots=True)
class Gamma(Formula):
    """T(t) = min(shift + scale·g_i, maximum), g_i ~ Gamma(shape), i = floor(t / hold).

    Uncut, mean and variance are shift + shape·scale and shape·scale². `shift`, `scale`,
    `maximum`: s; `hold` (s) as in :class:`~cosim.links.laws.Uniform`, None: every sample.
    """

    LAW = "gamma"

    shift: float
    shape: float
    scale: float
    maximum: float
    hold: float | None = None

    def __post_init__(self) -> None:
        """Check the parameters of the distribution. Raises ScenarioError."""
        _check_tail(self.shift, self.maximum, self.hold)
        _check_positive("shape", self.shape)
        _check_positive("scale", self.scale, " s")

    @property
    def minimum(self) -> float:
        """The shift, s."""
        return self.shift

    @property
    def mean(self) -> float:
        """E T = shift + shape·scale·P(shape + 1, x) + (maximum - shift)·(1 - P(shape, x)), s.

        x = (maximum - shift)/scale; P is the regularised lower incomplete gamma function.
        """
        c = self.maximum - self.shift
        below = self.shape * self.scale * _lower_gamma(self.shape + 1, c / self.scale)
        return self.shift + below + c * (1 - _lower_gamma(self.shape, c / self.scale))

    def stream(self, period: Fraction, rng: Generator) -> Delays:
        """One draw a hold interval, whether a sample falls into it or not."""

        def draw(n: int) -> FloatArray:
            return np.minimum(self.shift + self.scale * rng.gamma(self.shape, size=n), self.maximum)

        return hold_delays(draw, self.hold, period)


@dataclass(frozen=True, slots=True)
class Lognormal(Formula):
    """T(t) = min(shift + median·exp(sigma·g_i), maximum), g_i ~ N(0, 1), i = floor(t / hold).

    `shift`, `maximum`: s; `median` (s) is that of T - shift; `sigma` is the standard deviation of
    ln(T - shift); `hold` (s) as in :class:`~cosim.links.laws.Uniform`, None: every sample.
    """

    LAW = "lognormal"

    shift: float
    median: float
    sigma: float
    maximum: float
    hold: float | None = None

    def __post_init__(self) -> None:
        """Check the parameters of the distribution. Raises ScenarioError."""
        _check_tail(self.shift, self.maximum, self.hold)
        _check_positive("median", self.median, " s")
        _check_positive("sigma", self.sigma)
        if self.sigma > SIGMA_MAXIMUM:
            raise ScenarioError(f"sigma = {self.sigma:g}; expected at most {SIGMA_MAXIMUM:g}")

    @property
    def minimum(self) -> float:
        """The shift, s."""
        return self.shift

    @property
    def mean(self) -> float:
        """E T = shift + median·exp(sigma²/2)·Φ(x - sigma) + (maximum - shift)·Φ(-x), s.

        x = ln((maximum - shift)/median)/sigma; Φ is the normal distribution function.
        """
        c = self.maximum - self.shift
        x = log(c / self.median) / self.sigma
        below = self.median * exp(self.sigma**2 / 2) * _normal(x - self.sigma)
        return self.shift + below + c * _normal(-x)

    def stream(self, period: Fraction, rng: Generator) -> Delays:
        """One draw a hold interval, whether a sample falls into it or not."""

        def draw(n: int) -> FloatArray:
            tail = self.median * np.exp(self.sigma * rng.standard_normal(n))
            return np.minimum(self.shift + tail, self.maximum)

        return hold_delays(draw, self.hold, period)


def _check_tail(shift: float, maximum: float, hold: float | None) -> None:
    check_delay("shift", shift)
    check_delay("maximum", maximum)
    if maximum <= shift:
        raise ScenarioError(
            f"maximum = {maximum:g} s is not more than shift = {shift:g} s; expected room for"
            " the tail"
        )
    check_hold(hold)


def _check_positive(name: str, value: float, unit: str = "") -> None:
    if not (isfinite(value) and value > 0):
        raise ScenarioError(f"{name} = {value:g}{unit}; expected more than 0")


def _lower_gamma(a: float, x: float) -> float:
    """P(a, x) = x^a e^-x / Γ(a + 1) · Σ x^n / ((a + 1)…(a + n)): all terms are positive."""
    if x > a and a * log(x / a) - (x - a) < -745:
        return 1.0  # 1 - P is below the least number (Chernoff)
    term = total = 1.0
    n = 0
    while term > 1e-17 * total:
        n += 1
        term *= x / (a + n)
        total += term
    return min(1.0, exp(a * log(x) - x - lgamma(a + 1) + log(total)))


def _normal(x: float) -> float:
    return 0.5 * erfc(-x / sqrt(2))
