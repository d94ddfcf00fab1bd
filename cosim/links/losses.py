"""Loss models, which select the packets that never arrive. Any delay law can be combined with one.

A loss model is a frozen value like a law. :meth:`Loss.stream` starts the losses of one link, which
are generated in chunks whose sizes do not change them. :class:`Lossy` combines a model with a delay
law and uses separate random numbers: with or without loss, the arriving packets have the same
delays.

The semantics of the link define the effect of a lost packet: `last-arrival`, `newest-stamp` and
`playout` hold the present sample; `signal` and `fifo` reject a law with losses. `outages` has loss
models that are specified in seconds instead of packets.

Source: E. N. Gilbert, "Capacity of a burst-noise channel", Bell System Technical Journal 39(5),
1960; E. O. Elliott, "Estimates of error rates for codes on burst-noise channels", Bell System
Technical Journal 42(5), 1963; parameters as in tc-netem(8).
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import inf
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.links.keys import Keyed, Ratio, Table
from cosim.links.laws import Delays, FloatArray, Law
from cosim.links.markov import Chain
from cosim.links.reachability import BoolArray

if TYPE_CHECKING:
    from numpy.random import Generator


class Losses(Protocol):
    """The losses of one link, in order."""

    def take(self, n: int) -> BoolArray:
        """True if each of the next `n` packets is lost, (n,)."""


class Loss(Protocol):
    """A loss model: declared facts and a way to draw."""

    @property
    def share(self) -> float:
        """The share of packets lost in the long run, below 1."""

    @property
    def longest(self) -> float:
        """No outage lasts longer, s; inf: there is no bound."""

    def stream(self, period: Fraction, rng: Generator) -> Losses:
        """The losses of packets sent at t = 0, period, 2·period, … (s), drawn from `rng`."""

    def facts(self) -> dict[str, Any]:
        """The metadata of a run: the model's name and its values, SI."""


class Independent(Keyed, frozen=True, tag="independent"):
    """Each packet is lost with probability p, whatever happened to the others."""

    p: Ratio

    def __post_init__(self) -> None:
        """Check that it is a probability. Raises ScenarioError."""
        if not 0 <= self.p < 1:
            raise ScenarioError(f"p = {self.p:g}; expected a probability from 0 to less than 1")

    @property
    def share(self) -> float:
        """The probability p."""
        return self.p

    @property
    def longest(self) -> float:
        """inf: unbounded, unless nothing is lost."""
        return inf if self.p else 0.0

    @property
    def burst(self) -> float:
        """Mean number of packets lost in a row, 1/(1 - p)."""
        return 1 / (1 - self.p)

    def stream(self, period: Fraction, rng: Generator) -> Losses:
        """One draw a packet."""
        return _Independent(self.p, rng)


class _Independent:
    def __init__(self, p: float, rng: Generator) -> None:
        self._p, self._rng = p, rng

    def take(self, n: int) -> BoolArray:
        return self._rng.random(n) < self._p


class GilbertElliott(
    Keyed, frozen=True, tag="gilbert-elliott", rename={"bad": "1-h", "good": "1-k"}
):
    """Two states with their own loss probabilities; after a packet G -> B with p, B -> G with r.

    In B a packet is lost with probability `bad` = 1-h, in G with `good` = 1-k: the names and the
    order of ``tc netem loss gemodel p r 1-h 1-k``. The model starts in its stationary
    distribution (netem starts in G). bad = 1, good = 0 is the simple Gilbert model.
    """

    p: Ratio
    r: Ratio
    bad: Ratio = 1.0
    good: Ratio = 0.0

    @classmethod
    def completed(cls, table: Table) -> Table:
        """The default of r is netem's, 1 - p."""
        p = table.get("p")
        return {"r": 1 - p, **table} if isinstance(p, int | float) else table

    def __post_init__(self) -> None:
        """Check the probabilities, and that each state can be left. Raises ScenarioError."""
        for name, value in (("p", self.p), ("r", self.r)):
            if not 0 < value <= 1:
                raise ScenarioError(
                    f"{name} = {value:g}; expected a probability of more than 0, up to 1"
                )
        if not 0 <= self.bad <= 1:
            raise ScenarioError(f"1-h = {self.bad:g}; expected a probability from 0 to 1")
        if not 0 <= self.good < 1:
            raise ScenarioError(
                f"1-k = {self.good:g}; expected a probability from 0 to less than 1"
            )

    @property
    def share(self) -> float:
        """(p·(1-h) + r·(1-k)) / (p + r)."""
        return (self.p * self.bad + self.r * self.good) / (self.p + self.r)

    @property
    def longest(self) -> float:
        """inf: unbounded, unless nothing is lost."""
        return inf if self.share else 0.0

    @property
    def burst(self) -> float:
        """Mean number of packets lost in a row: P(lost) / P(lost, the next is not).

        P(lost, the next is not) = Σ_ab π_a ℓ_a P_ab (1 - ℓ_b), ℓ = (1-k, 1-h). 1/r for the simple
        Gilbert model; nan where nothing is lost.
        """
        pi_bad = self.p / (self.p + self.r)
        after_good = (1 - self.p) * (1 - self.good) + self.p * (1 - self.bad)
        after_bad = self.r * (1 - self.good) + (1 - self.r) * (1 - self.bad)
        ends = (1 - pi_bad) * self.good * after_good + pi_bad * self.bad * after_bad
        return self.share / ends if self.share else float("nan")

    def stream(self, period: Fraction, rng: Generator) -> Losses:
        """Two draws a packet, from two generators."""
        return _GilbertElliott(self, *rng.spawn(2))


class _GilbertElliott:
    def __init__(self, model: GilbertElliott, states: Generator, losses: Generator) -> None:
        P = np.array([[1 - model.p, model.p], [model.r, 1 - model.r]])
        self._chain, self._rng = Chain(P, states), losses
        self._lost = np.array([model.good, model.bad])  # (2,), probability in G, B

    def take(self, n: int) -> BoolArray:
        return self._rng.random(n) < self._lost[self._chain.take(n)]


@dataclass(frozen=True, slots=True)
class Lossy:
    """The delays of `delay`, not a number where `loss` loses the packet."""

    delay: Law
    loss: Loss

    @property
    def minimum(self) -> float:
        """The bound of the delay law, s."""
        return self.delay.minimum

    @property
    def maximum(self) -> float:
        """The bound of the delay law, s."""
        return self.delay.maximum

    @property
    def mean(self) -> float:
        """The mean of the delay law, s; losses do not depend on delays."""
        return self.delay.mean

    @property
    def loses_packets(self) -> bool:
        """True if the delay law or the loss model loses packets."""
        return self.delay.loses_packets or self.loss.share > 0

    def limit(self, period: Fraction) -> int | None:
        """The limit of the delay law."""
        return self.delay.limit(period)

    def stream(self, period: Fraction, rng: Generator) -> Delays:
        """The delays, drawn from `rng` as without loss; the losses from a separate generator."""
        (own,) = rng.spawn(1)
        return _Lossy(self.delay.stream(period, rng), self.loss.stream(period, own))

    def facts(self) -> dict[str, Any]:
        """The facts of the delay law, and under `loss` those of the loss model."""
        return {**self.delay.facts(), "loss": self.loss.facts()}


class _Lossy:
    def __init__(self, delays: Delays, losses: Losses) -> None:
        self._delays, self._losses = delays, losses

    def take(self, n: int) -> FloatArray:
        return np.where(self._losses.take(n), np.nan, self._delays.take(n))
