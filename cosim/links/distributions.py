"""Distributions of delays: gamma and lognormal, normal and hyperexponential, all bounded.

A network has a shortest transit time (the wire) and a tail (the queues). The theory requires
bounded delays (Theorems 4 and 5), so each law declares its `maximum`, and a larger draw is replaced
by it. The `mean` is that of the bounded law, in closed form.

NumPy draws the random numbers; another version of NumPy or another processor may round them
differently. The table stored with a run replays the delays bit for bit.

Source: own construction from these distributions; `presets` names the studies that use them.
"""

from __future__ import annotations

from fractions import Fraction
from math import erfc, exp, isfinite, lgamma, log, pi, sqrt
from typing import TYPE_CHECKING

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.links.keys import Ratio, Seconds, Table
from cosim.links.laws import Delays, FloatArray, Formula, check_delay, check_hold, hold_delays

if TYPE_CHECKING:
    from numpy.random import Generator

SIGMA_MAXIMUM = 10.0  # beyond it every delay is the shift or the maximum


class Gamma(Formula, frozen=True, tag="gamma"):
    """T(t) = min(shift + scale·g_i, maximum), g_i ~ Gamma(shape), i = floor(t / hold).

    Uncut, mean and variance are shift + shape·scale and shape·scale². `shift`, `scale`,
    `maximum`: s; `hold` (s) as in :class:`~cosim.links.laws.Uniform`, None: every sample.
    """

    shift: Seconds
    shape: Ratio
    scale: Seconds
    maximum: Seconds
    hold: Seconds | None = None

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


class Lognormal(Formula, frozen=True, tag="lognormal"):
    """T(t) = min(shift + median·exp(sigma·g_i), maximum), g_i ~ N(0, 1), i = floor(t / hold).

    `shift`, `maximum`: s; `median` (s) is that of T - shift; `sigma` is the standard deviation of
    ln(T - shift); `hold` (s) as in :class:`~cosim.links.laws.Uniform`, None: every sample.
    """

    shift: Seconds
    median: Seconds
    sigma: Ratio
    maximum: Seconds
    hold: Seconds | None = None

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


class Normal(Formula, frozen=True, tag="normal", rename={"centre": "mean"}):
    """T(t) = mean + sd·g_i, g_i ~ N(0, 1), cut to [minimum, maximum], i = floor(t / hold).

    `centre` and `sd` (s) are mean and standard deviation of the uncut law. `hold` (s) as in
    :class:`~cosim.links.laws.Uniform`, None: every sample.
    """

    centre: Seconds
    sd: Seconds
    minimum: Seconds
    maximum: Seconds
    hold: Seconds | None = None

    @classmethod
    def completed(cls, table: Table) -> Table:
        """The least delay is 0 unless it is given."""
        return {"minimum": 0.0, **table}

    def __post_init__(self) -> None:
        """Check the parameters of the distribution. Raises ScenarioError."""
        check_delay("mean", self.centre)
        check_delay("minimum", self.minimum)
        check_delay("maximum", self.maximum)
        _check_positive("sd", self.sd, " s")
        if not self.minimum < self.maximum:
            raise ScenarioError(
                f"maximum = {self.maximum:g} s is not more than minimum = {self.minimum:g} s"
            )
        check_hold(self.hold)

    @property
    def mean(self) -> float:
        """E T = m + s·(a Φ(a) + b Φ(-b) + φ(a) - φ(b)), s.

        m = centre, s = sd, a = (minimum - m)/s, b = (maximum - m)/s; φ and Φ are density and
        distribution function of the standard normal law.
        """
        a, b = ((x - self.centre) / self.sd for x in (self.minimum, self.maximum))
        return self.centre + self.sd * (
            a * _normal(a) + b * _normal(-b) + _density(a) - _density(b)
        )

    def stream(self, period: Fraction, rng: Generator) -> Delays:
        """One draw a hold interval, whether a sample falls into it or not."""

        def draw(n: int) -> FloatArray:
            T = self.centre + self.sd * rng.standard_normal(n)
            return np.clip(T, self.minimum, self.maximum)

        return hold_delays(draw, self.hold, period)


class Hyperexponential(Formula, frozen=True, tag="hyperexponential"):
    """T(t) = min(shift + e_i, maximum): e_i ~ Exp with mean means[j] by chance weights[j].

    i = floor(t / hold); `shift`, `means`, `maximum`, `hold`: s, `hold` as in
    :class:`~cosim.links.laws.Uniform`. `weights` sum to 1.
    """

    shift: Seconds
    weights: tuple[float, ...]
    means: tuple[Seconds, ...]
    maximum: Seconds
    hold: Seconds | None = None

    def __post_init__(self) -> None:
        """Check the parameters of the distribution. Raises ScenarioError."""
        _check_tail(self.shift, self.maximum, self.hold)
        if len(self.weights) != len(self.means) or not self.means:
            raise ScenarioError(
                f"{len(self.weights)} weights and {len(self.means)} means; expected as many of both"
            )
        if not all(w >= 0 for w in self.weights) or abs(sum(self.weights) - 1) > 1e-9:
            raise ScenarioError(
                f"weights = {list(self.weights)}; expected probabilities that sum to 1"
            )
        for mean in self.means:
            if not (isfinite(mean) and mean > 0):
                raise ScenarioError(f"means: found {mean:g} s; expected more than 0")

    @property
    def minimum(self) -> float:
        """The shift, s."""
        return self.shift

    @property
    def mean(self) -> float:
        """E T = shift + Σ_j weights[j]·means[j]·(1 - exp(-(maximum - shift)/means[j])), s."""
        c = self.maximum - self.shift
        parts = zip(self.weights, self.means, strict=True)
        return self.shift + sum(w * m * (1 - exp(-c / m)) for w, m in parts)

    def stream(self, period: Fraction, rng: Generator) -> Delays:
        """Two draws a hold interval, from two generators."""
        which, size = rng.spawn(2)
        ends, means = np.cumsum(self.weights)[:-1], np.array(self.means)

        def draw(n: int) -> FloatArray:
            scale = means[np.searchsorted(ends, which.random(n), side="right")]
            T: FloatArray = self.shift + scale * size.standard_exponential(n)
            return np.minimum(T, self.maximum)

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


def _density(x: float) -> float:
    return exp(-x * x / 2) / sqrt(2 * pi)
