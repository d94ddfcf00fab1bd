"""Loss models, which select the packets that never arrive. Any delay law can be combined with one.

A loss model is a frozen value like a law. :meth:`Loss.stream` starts the losses of one link, which
are generated in chunks whose sizes do not change them. :class:`Lossy` combines a model with a delay
law and uses separate random numbers: with or without loss, the arriving packets have the same
delays.

:class:`ParetoBursts`: a chain of two states advances with each packet and keeps its state with
probability ``stay[state]``. A packet outside of a burst begins a burst of L packets with::

    L = floor(scale·((1 - u)^(-1/shape) - 1)),  u ~ U[0, 1)        P(L ≥ k) = (1 + k/scale)^(-shape)

shape and scale of its state; for L = 0 the packet arrives. One packet arrives after each burst.

The semantics of the link define the effect of a lost packet: `last-arrival`, `newest-stamp` and
`playout` hold the present sample; `signal` and `fifo` reject a law with losses. `outages` has loss
models that are specified in seconds instead of packets.

Source: E. N. Gilbert, "Capacity of a burst-noise channel", Bell System Technical Journal 39(5),
1960; E. O. Elliott, "Estimates of error rates for codes on burst-noise channels", Bell System
Technical Journal 42(5), 1963; parameters as in tc-netem(8). Bursts: NetFI,
arXiv 2603.06824.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import inf
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.links.keys import Keyed, Ratio, Table
from cosim.links.laws import BoolArray, Delays, FloatArray, Law
from cosim.links.markov import Chain, stationary

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


#: Terms of the sums over the length of a burst, packets.
_TERMS = 100_000


class ParetoBursts(Keyed, frozen=True, tag="pareto-bursts"):
    """The loss model above: `stay`, `shape` and `scale` of the first and the second state, (2,)."""

    stay: tuple[float, float]
    shape: tuple[float, float]
    scale: tuple[float, float]

    def __post_init__(self) -> None:
        """Check the chain and the Pareto laws. Raises ScenarioError."""
        for p in self.stay:
            if not 0 < p < 1:
                raise ScenarioError(f"stay: found {p:g}; expected probabilities between 0 and 1")
        for p in self.shape:
            if not 1.5 <= p <= 100:
                raise ScenarioError(f"shape: found {p:g}; expected from 1.5 to 100")
        for p in self.scale:
            if not 0 < p <= 1000:
                raise ScenarioError(f"scale: found {p:g}; expected more than 0, up to 1000")

    @property
    def transitions(self) -> FloatArray:
        """(2, 2): from one packet to the next."""
        a, b = self.stay
        return np.array([[a, 1 - a], [1 - b, b]])

    def _embedded(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Shares (2,) of the states, E L and P(L > 0) for packets that may begin a burst.

        A packet that begins L lost ones is followed by one that arrives: L + 1 packets, also for
        L = 0. So the next such packet is L + 1 later, and its state follows from P^(L + 1) =
        Π + μ^(L + 1)·(I - Π), μ = stay[0] + stay[1] - 1, with the stationary shares Π.
        """
        k = np.arange(1, _TERMS + 1)
        reach = [(1 + k / b) ** (-a) for a, b in zip(self.shape, self.scale, strict=True)]
        length = np.array([x.sum() for x in reach])  # E L
        begins = np.array([x[0] for x in reach])
        mu = sum(self.stay) - 1
        # E μ^(L+1) = μ·(1 + Σ_k P(L ≥ k)·(μ^k - μ^(k-1)))
        steps = mu**k - mu ** (k - 1)
        g = np.array([mu * (1 + float(x @ steps)) for x in reach])
        fixed = np.tile(stationary(self.transitions), (2, 1))
        chain = fixed + g[:, None] * (np.eye(2) - fixed)
        return stationary(chain), length, begins

    @property
    def share(self) -> float:
        """E L/(1 + E L) in the long run."""
        share, length, _ = self._embedded()
        lost = float(share @ length)
        return lost / (1 + lost)

    @property
    def burst(self) -> float:
        """Mean number of packets lost in a row, E L/P(L > 0)."""
        share, length, begins = self._embedded()
        return float(share @ length) / float(share @ begins)

    @property
    def longest(self) -> float:
        """inf: unbounded."""
        return inf

    def stream(self, period: Fraction, rng: Generator) -> Losses:
        """Two draws a packet, from two generators."""
        return _ParetoBursts(self, *rng.spawn(2))


class _ParetoBursts:
    """Carry: packets until the next may begin a burst; all but the last of them are lost."""

    def __init__(self, model: ParetoBursts, states: Generator, lengths: Generator) -> None:
        self._chain, self._rng = Chain(model.transitions, states), lengths
        self._shape, self._scale = np.array(model.shape), np.array(model.scale)
        self._busy = 0

    def take(self, n: int) -> BoolArray:
        state, u = self._chain.take(n), self._rng.random(n)
        tail = (1 - u) ** (-1 / self._shape[state]) - 1
        lengths = (self._scale[state] * tail).astype(np.int64).tolist()
        lost = np.zeros(n, bool)
        lost[: max(0, self._busy - 1)] = True
        k = self._busy
        while k < n:
            lost[k : k + lengths[k]] = True
            k += lengths[k] + 1
        self._busy = k - n
        return lost
