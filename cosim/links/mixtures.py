"""Delays that published studies use: normal, hyperexponential, and sums of independent laws.

Every law declares a `maximum`, which replaces any larger draw; the `mean` is that of the bounded
law, in closed form. NumPy draws the random numbers, see :mod:`cosim.links.skewed`.

Source: own construction from the normal and exponential distributions; `presets` names the studies.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import erfc, exp, isfinite, pi, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.links.laws import (
    Delays,
    FloatArray,
    Formula,
    Law,
    check_delay,
    check_hold,
    hold_delays,
)

if TYPE_CHECKING:
    from numpy.random import Generator


@dataclass(frozen=True, slots=True)
class Normal(Formula):
    """T(t) = mean + sd·g_i, g_i ~ N(0, 1), cut to [minimum, maximum], i = floor(t / hold).

    `centre` and `sd` (s) are mean and standard deviation of the uncut law. `hold` (s) as in
    :class:`~cosim.links.laws.Uniform`, None: every sample.
    """

    LAW = "normal"

    centre: float
    sd: float
    minimum: float
    maximum: float
    hold: float | None = None

    def __post_init__(self) -> None:
        """Check the parameters of the distribution. Raises ScenarioError."""
        check_delay("mean", self.centre)
        check_delay("minimum", self.minimum)
        check_delay("maximum", self.maximum)
        if not (isfinite(self.sd) and self.sd > 0):
            raise ScenarioError(f"sd = {self.sd:g} s; expected more than 0")
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
        return self.centre + self.sd * (a * _below(a) + b * _below(-b) + _density(a) - _density(b))

    def stream(self, period: Fraction, rng: Generator) -> Delays:
        """One draw a hold interval, whether a sample falls into it or not."""

        def draw(n: int) -> FloatArray:
            T = self.centre + self.sd * rng.standard_normal(n)
            return np.clip(T, self.minimum, self.maximum)

        return hold_delays(draw, self.hold, period)

    def facts(self) -> dict[str, Any]:
        """The law's name and its values, as a scenario writes them, SI."""
        return {
            "law": self.LAW, "mean": self.centre, "sd": self.sd, "minimum": self.minimum,
            "maximum": self.maximum, "hold": self.hold,
        }  # fmt: skip


def _density(x: float) -> float:
    return exp(-x * x / 2) / sqrt(2 * pi)


def _below(x: float) -> float:
    return 0.5 * erfc(-x / sqrt(2))


@dataclass(frozen=True, slots=True)
class Hyperexponential(Formula):
    """T(t) = min(shift + e_i, maximum): e_i ~ Exp with mean means[j] by chance weights[j].

    i = floor(t / hold); `shift`, `means`, `maximum`, `hold`: s, `hold` as in
    :class:`~cosim.links.laws.Uniform`. `weights` sum to 1.
    """

    LAW = "hyperexponential"

    shift: float
    weights: tuple[float, ...]
    means: tuple[float, ...]
    maximum: float
    hold: float | None = None

    def __post_init__(self) -> None:
        """Check the parameters of the distribution. Raises ScenarioError."""
        check_delay("shift", self.shift)
        check_delay("maximum", self.maximum)
        if self.maximum <= self.shift:
            raise ScenarioError(
                f"maximum = {self.maximum:g} s is not more than shift = {self.shift:g} s; expected"
                " room for the tail"
            )
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
        check_hold(self.hold)

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


@dataclass(frozen=True, slots=True)
class Sum:
    """T(t) = Σ_j T_j(t) of independent laws, none of which loses packets."""

    parts: tuple[Law, ...]

    def __post_init__(self) -> None:
        """Refuse nothing, and what loses packets. Raises ScenarioError."""
        if not self.parts:
            raise ScenarioError("of names no delay law; expected one or more")
        if any(law.loses_packets for law in self.parts):
            raise ScenarioError(
                "a law of the sum loses packets; expected laws without losses, and the key loss"
            )

    @property
    def minimum(self) -> float:
        """The sum of the minima, s."""
        return sum(law.minimum for law in self.parts)

    @property
    def maximum(self) -> float:
        """The sum of the maxima, s."""
        return sum(law.maximum for law in self.parts)

    @property
    def mean(self) -> float:
        """The sum of the means, s."""
        return sum(law.mean for law in self.parts)

    @property
    def loses_packets(self) -> bool:
        """Never."""
        return False

    def limit(self, period: Fraction) -> int | None:
        """The least limit of the parts."""
        limits = [x for x in (law.limit(period) for law in self.parts) if x is not None]
        return min(limits, default=None)

    def stream(self, period: Fraction, rng: Generator) -> Delays:
        """Each part draws from a generator of its own."""
        own = rng.spawn(len(self.parts))
        return _Added([p.stream(period, r) for p, r in zip(self.parts, own, strict=True)])

    def facts(self) -> dict[str, Any]:
        """The facts of the parts."""
        return {"law": "sum", "of": [law.facts() for law in self.parts]}


class _Added:
    def __init__(self, streams: list[Delays]) -> None:
        self._streams = streams

    def take(self, n: int) -> FloatArray:
        total = np.zeros(n)
        for stream in self._streams:
            total += stream.take(n)
        return total
