"""Markov chains: delays that stay at a level for a time (route, load, handover), then jump.

The chain itself, :class:`Chain`, also drives the Gilbert–Elliott loss in `losses`.

Source: own construction from a homogeneous Markov chain that starts in its stationary distribution.
"""

from __future__ import annotations

from fractions import Fraction
from math import isfinite, isqrt
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.links.keys import Keyed, Seconds, Table
from cosim.links.laws import (
    BoolArray,
    Delays,
    FloatArray,
    Formula,
    IntArray,
    Law,
    LawSource,
    check_delay,
    hold_delays,
)

if TYPE_CHECKING:
    from numpy.random import Generator

Row = tuple[float, ...]
Levels = tuple[Seconds, ...]


class Markov(Formula, frozen=True, tag="markov"):
    """T(t) = levels[x_i], i = floor(t / step): P(x_{i+1} = b | x_i = a) = transitions[a][b].

    `levels` (m,), s; `transitions` (m, m), rows sum to 1, and every level can be reached from
    every other; `step`, s. x_0 is drawn from the stationary distribution, so that the shares of
    the levels hold from the start. See :meth:`dwelling` for mean times instead of probabilities.
    """

    levels: Levels
    transitions: tuple[Row, ...]
    step: Seconds

    def __post_init__(self) -> None:
        """Check the levels and the transition matrix. Raises ScenarioError."""
        if len(self.levels) < 2:
            raise ScenarioError(f"{len(self.levels)} levels; expected two or more")
        for a, level in enumerate(self.levels):
            check_delay(f"levels[{a}]", level)
        _check_step(self.step)
        _check_transitions(self.transitions, len(self.levels))

    @classmethod
    def chosen(cls, table: Table) -> type[Keyed]:
        """The chain by its transitions or by its mean times. Raises ScenarioError."""
        if ("transitions" in table) == ("dwell" in table):
            raise ScenarioError('delay.law = "markov" needs either transitions or dwell')
        return cls if "transitions" in table else DwellingLaw

    @staticmethod
    def dwelling(levels: Row, dwell: Row, step: float) -> Markov:
        """The chain that stays `dwell[a]` (s) on level a in the mean, then takes any other.

        It leaves in a step with probability step/dwell[a]; all others are equally likely. `dwell`
        has one value a level, or one for all. Raises ScenarioError.
        """
        m = len(levels)
        if len(dwell) not in (1, m):
            raise ScenarioError(f"{len(dwell)} dwell times for {m} levels; expected 1 or {m}")
        _check_step(step)
        for time in dwell:
            if not (isfinite(time) and time >= step):
                raise ScenarioError(
                    f"dwell = {time:g} s; expected at least one step, {step:g} s (and an end)"
                )
        leave = [step / time for time in (dwell if len(dwell) == m else dwell * m)]
        transitions = tuple(
            tuple(1 - leave[a] if a == b else leave[a] / (m - 1) for b in range(m))
            for a in range(m)
        )
        return Markov(levels, transitions, step)

    @property
    def minimum(self) -> float:
        """The least level, s."""
        return min(self.levels)

    @property
    def maximum(self) -> float:
        """The greatest level, s."""
        return max(self.levels)

    @property
    def shares(self) -> FloatArray:
        """π (m,): the share of time on each level, π = π·transitions."""
        return stationary(np.array(self.transitions))

    @property
    def mean(self) -> float:
        """π·levels, s."""
        return float(self.shares @ np.array(self.levels))

    def stream(self, period: Fraction, rng: Generator) -> Delays:
        """One step of the chain every `step`, whether a sample falls into it or not."""
        chain, levels = Chain(np.array(self.transitions), rng), np.array(self.levels)

        def draw(n: int) -> FloatArray:
            level: FloatArray = levels[chain.take(n)]
            return level

        return hold_delays(draw, self.step, period, "step")


class DwellingLaw(LawSource, frozen=True, tag="markov"):
    """The keys of :meth:`Markov.dwelling`."""

    levels: Levels
    dwell: Seconds | Levels
    step: Seconds

    def law(self, folder: Path) -> Law:
        """The chain with transitions."""
        dwell = self.dwell if isinstance(self.dwell, tuple) else (self.dwell,)
        return Markov.dwelling(self.levels, dwell, self.step)


class Chain:
    """States x_0, x_1, … of 0 … m-1: x_0 ~ stationary, x_{k+1} ~ P[x_k]. One draw per state.

    `P` (m, m), irreducible. Vectorized over blocks: the result of every initial state within a
    block is computed for all blocks at the same time, then the blocks are joined. All values are
    integers, so the sizes of chunks have no effect.
    """

    def __init__(self, P: FloatArray, rng: Generator) -> None:
        self._rng = rng
        self._steps = [_thresholds(row) for row in P]  # m times (m - 1,)
        self._start = _thresholds(stationary(P))
        self._state = -1  # not started

    def take(self, n: int) -> IntArray:
        """The next `n` states, (n,)."""
        u = self._rng.random(n)
        x = np.empty(n, np.int64)
        started = self._state >= 0
        if n and not started:
            x[0] = self._state = int(np.searchsorted(self._start, u[0], side="right"))
        walked = slice(0 if started else 1, n)
        x[walked] = self._walk(u[walked])
        if n:
            self._state = int(x[-1])
        return x

    def _walk(self, u: FloatArray) -> IntArray:
        n, m = u.size, len(self._steps)
        if not n:
            return np.empty(0, np.int64)
        length = isqrt(n - 1) + 1
        blocks = -(-n // length)
        to = np.zeros((m, blocks * length), np.int64)  # where u leads from each state
        for a, thresholds in enumerate(self._steps):
            to[a, :n] = np.searchsorted(thresholds, u, side="right")
        # `to` (length, m, blocks); reached[k, a, b]: the state after k + 1 steps of block b, from a
        to = np.ascontiguousarray(to.reshape(m, blocks, length).transpose(2, 0, 1))
        block = np.arange(blocks)
        reached = np.empty((length, m, blocks), np.int64)
        x = np.repeat(np.arange(m), blocks).reshape(m, blocks)
        for k in range(length):
            x = np.take(to[k], x * blocks + block)
            reached[k] = x
        entry = np.empty(blocks, np.int64)
        state = self._state
        for b, ends in enumerate(reached[-1].T.tolist()):
            entry[b] = state
            state = ends[state]
        out: IntArray = reached[:, entry, block].T.ravel()[:n]
        return out


def stationary(P: FloatArray) -> FloatArray:
    """π (m,) with π·P = π and Σπ = 1, of an irreducible chain P (m, m)."""
    m = P.shape[0]
    A = np.vstack((P.T - np.eye(m), np.ones(m)))
    share: FloatArray = np.linalg.lstsq(A, np.append(np.zeros(m), 1.0), rcond=None)[0]
    return np.maximum(share, 0.0)


def _thresholds(probabilities: FloatArray) -> FloatArray:
    """(m - 1,): u ~ U[0, 1) gives state b where it is the number of thresholds <= u.

    What comes after the last possible state is never given, whatever the sum rounds to.
    """
    thresholds = np.cumsum(probabilities)
    thresholds[np.flatnonzero(probabilities)[-1] :] = 1.0
    return thresholds[:-1]


def _check_step(step: float) -> None:
    if not (isfinite(step) and step > 0):
        raise ScenarioError(f"step = {step:g} s; expected a time greater than 0")


def _check_transitions(transitions: tuple[Row, ...], m: int) -> None:
    if len(transitions) != m or any(len(row) != m for row in transitions):
        raise ScenarioError(
            f"transitions of {len(transitions)} rows, {[len(row) for row in transitions]} values;"
            f" expected {m} rows of {m}, one per level"
        )
    for a, row in enumerate(transitions):
        if not all(0 <= p <= 1 for p in row) or abs(sum(row) - 1) > 1e-9:
            raise ScenarioError(
                f"transitions[{a}] = {list(row)}; expected probabilities that sum to 1"
            )
    unreached = np.argwhere(~closure(np.array(transitions) > 0))
    if unreached.size:
        a, b = unreached[0].tolist()
        raise ScenarioError(
            f"levels[{b}] is never reached from levels[{a}]; expected every level to be reached"
            " from every other"
        )


def closure(edges: BoolArray) -> BoolArray:
    """(n, n): whether a path of any length, also zero, leads from a to b; edges[a, b]: one step."""
    reaches: BoolArray = edges | np.eye(edges.shape[0], dtype=bool)
    for _ in range(edges.shape[0].bit_length()):  # paths twice as long each time
        reaches = (reaches.astype(np.int64) @ reaches.astype(np.int64)) > 0
    return reaches
