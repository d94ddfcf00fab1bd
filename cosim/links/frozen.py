"""Frozen delay traces: delays whose bytes are the same on every machine and in every version.

A comparison with a published table requires exactly the same delays. A law and a seed do not
guarantee this, because another version of NumPy or another processor may round a logarithm
differently. These traces are therefore computed with integers only, by the following algorithm,
which any language can implement. Each has the SHA-256 sum of its CSV text, which
:meth:`FrozenTrace.text` checks.

Random numbers: SplitMix64. Word i = 1, 2, … of stream s is, modulo 2^64, with x = seed + (s·2^40 +
i)·0x9E3779B97F4A7C15::

    x = (x xor x >> 30)·0xBF58476D1CE4E5B9;  x = (x xor x >> 27)·0x94D049BB133111EB
    word = (x xor x >> 31) >> 32;  u = floor(word·10^6 / 2^32)          0 … 999999

Row k = 0, 1, …, 23999 is a packet sent at 5·k ms. Its delay in µs is the sum of

* `quantiles` at u of word 1 + floor(k / hold) of stream 0: the value between two knots (u, µs) is
  a + floor((b - a)(u - u_a)/(u_b - u_a));
* a level, low + floor((high - low)·u/10^6), u of word 1 + floor(k / rows) of stream 1;
* `spike` µs where k modulo `rows` is in one of the windows.

``queue``: packets leave in order: T_k is at least T_(k-1) - 5000 µs, including lost packets. A
packet is lost in the bad one of two states. The state is good before the first row and changes
before row k if u of word 1 + k of stream 2 is below `enter` (in the good state) or `leave`.

CSV: UTF-8, lines end with LF; the header ``t_send,delay``; t_send in s with 3 decimals, the delay
in s with 6, empty for a lost packet. :func:`cosim.links.traces.read_trace` reads this format, and
Parquet files with the same two columns.

Source: own construction; SplitMix64 is by G. L. Steele, D. Lea, C. H. Flood, "Fast splittable
pseudorandom number generators", OOPSLA 2014.
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import ScenarioError
from cosim.links.laws import IntArray
from cosim.links.reachability import BoolArray
from cosim.links.traces import DelayTrace

#: Rows of a trace, and µs between two of them: 120 s.
ROWS, INTERVAL = 24_000, 5_000
_MILLION = 1_000_000

Knots = tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True)
class Levels:
    """A level, U[low, high] µs for `rows` rows each, and spikes in `windows` of [first, last)."""

    rows: int
    low: int
    high: int
    spike: int = 0
    windows: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True, slots=True)
class FrozenTrace:
    """A recipe; see the module for what its values mean. `sha256`: of the CSV text."""

    title: str
    seed: int
    quantiles: Knots
    sha256: str
    hold: int = 1
    queue: bool = False
    enter: int = 0
    leave: int = _MILLION
    levels: Levels | None = None

    def delays(self) -> IntArray:
        """The delays, (ROWS,), µs; -1 where the packet is lost."""
        k = np.arange(ROWS, dtype=np.int64)
        T = _interpolated(self.quantiles, uniform(self.seed, 0, k // self.hold))
        if self.levels is not None:
            T = T + _level(self.levels, self.seed, k)
        if self.queue:  # T_k + 5000 k never falls
            T = np.maximum.accumulate(T + INTERVAL * k) - INTERVAL * k
        return np.where(self._lost(), -1, T)

    def _lost(self) -> BoolArray:
        lost = np.zeros(ROWS, bool)
        if not self.enter:
            return lost
        bad = False
        for k, u in enumerate(uniform(self.seed, 2, np.arange(ROWS)).tolist()):
            bad = u >= self.leave if bad else u < self.enter
            lost[k] = bad
        return lost

    def text(self) -> str:
        """The CSV text. Raises ScenarioError where it has not the declared sum."""
        lines = ["t_send,delay"]
        for k, T in enumerate(self.delays().tolist()):
            ms = 5 * k
            delay = "" if T < 0 else f"{T // _MILLION}.{T % _MILLION:06d}"
            lines.append(f"{ms // 1000}.{ms % 1000:03d},{delay}")
        text = "\n".join(lines) + "\n"
        found = sha256(text.encode()).hexdigest()
        if found != self.sha256:
            raise ScenarioError(
                f"the trace {self.title!r} has the SHA-256 sum {found}; expected {self.sha256}"
            )
        return text

    def trace(self, *, lookup: str = "time", repeat: bool = False, name: str = "") -> DelayTrace:
        """The trace as a delay law; `lookup` and `repeat` as of DelayTrace.

        Raises ScenarioError where its text has not the declared sum.
        """
        self.text()
        T = self.delays()
        delay = np.where(T < 0, np.nan, T / _MILLION)
        return DelayTrace(np.arange(ROWS) * 5 / 1000, delay, lookup, repeat, name or self.title)


def uniform(seed: int, stream: int, index: NDArray[np.int64]) -> IntArray:
    """u, 0 to 999999, of word 1 + `index` (n,) of a stream, (n,): SplitMix64, see the module."""
    at = (index + 1).astype(np.uint64) + np.uint64(stream << 40)
    x = np.uint64(seed) + at * np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    word = (x ^ (x >> np.uint64(31))) >> np.uint64(32)
    return np.asarray((word * np.uint64(_MILLION) >> np.uint64(32)).astype(np.int64))


def _interpolated(knots: Knots, u: IntArray) -> IntArray:
    T = np.full(u.shape, knots[0][1], np.int64)
    for (u_a, a), (u_b, b) in pairwise(knots):
        T = np.where(u >= u_a, a + (b - a) * (u - u_a) // (u_b - u_a), T)
    return T


def _level(levels: Levels, seed: int, k: NDArray[np.int64]) -> IntArray:
    u = uniform(seed, 1, k // levels.rows)
    T = levels.low + (levels.high - levels.low) * u // _MILLION
    phase = k % levels.rows
    for first, last in levels.windows:
        T = T + np.where((phase >= first) & (phase < last), levels.spike, 0)
    return np.asarray(T)
