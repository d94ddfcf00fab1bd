"""Loss in bursts of Pareto length.

A chain of two states advances with each packet and keeps its state with probability
``stay[state]``. A packet outside of a burst begins a burst of L packets with::

    L = floor(scale·((1 - u)^(-1/shape) - 1)),  u ~ U[0, 1)        P(L ≥ k) = (1 + k/scale)^(-shape)

shape and scale of its state; for L = 0 the packet arrives. One packet arrives after each burst.

Source: NetFI, arXiv 2603.06824.
"""

from __future__ import annotations

from fractions import Fraction
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.links.keys import Keyed
from cosim.links.laws import FloatArray
from cosim.links.losses import Losses
from cosim.links.markov import Chain, stationary
from cosim.links.reachability import BoolArray

if TYPE_CHECKING:
    from numpy.random import Generator

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
