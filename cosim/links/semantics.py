"""Semantics: five rules by which a receiver selects one of the samples that have arrived.

Sample j is sent at tick n_s·j and the receiver reads at ticks K = n_r·r; T is the delay and h the
base step. A row of the table is the sample held at a read (-1: none yet). A sample that arrives in
a tick is available to a read in the same tick.

``signal``
    ξ(t - T(t)) of the theory: T at *reception*; the sample that exists and is nearest to t - T.
``last-arrival``
    Packets. Sample j arrives at tick n_s·j + ceil(T/h), T at its *sending*. The newest arrival
    is held even if it is stale; of two that arrive in the same tick, the later sent is held.
    (This is the only rule for which a finer base step changes the link: it separates arrivals.)
``newest-stamp``
    As before, but a sample sent no later than the held one is ignored.
``fifo``
    In order: no sample arrives before the samples sent before it. A lost packet is an error,
    because an ordered stream repeats it after a time that the law does not define. Use delays
    that include the repetitions.
``playout``
    Holds the sample sent b ago (the newest at or before K - ceil(b/h)) if it has arrived;
    otherwise the held sample does not change. If b is at least every T, the delay is always b.

Rounding: T is rounded **up** to whole ticks for packets and to the **nearest** sample for
`signal`, where a tie goes to the older sample (so that a constant delay stays constant; rounding
halves to even would make it alternate). A tolerance of 1e-9 tick applies: 0.3 s / 5 ms is 60 ticks.

Source: the paper, eq. (61), for `signal`; the rules for packets are our own construction.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import isfinite
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.links.grid import TOLERANCE, Grid
from cosim.links.laws import FloatArray, IntArray, Law, draws

if TYPE_CHECKING:
    from numpy.random import Generator

Ordering = Literal["last-arrival", "newest-stamp", "fifo"]


class RowStream(Protocol):
    """The rows of one link, in order."""

    def take(self, n: int) -> IntArray:
        """The next `n` rows, (n,): the sample held at each look, -1: none yet."""


class Rule(Protocol):
    """A semantics: declared facts and the rows it makes of a law."""

    def facts(self) -> dict[str, Any]:
        """The metadata of a run, in the form of a scenario."""

    def check(self, law: Law, grid: Grid) -> None:
        """Refuse a law that this rule cannot follow. Raises ScenarioError."""

    def least(self, law: Law, grid: Grid) -> int:
        """No row holds a sample sent fewer ticks before."""

    def greatest(self, law: Law, grid: Grid) -> int:
        """No row newly holds (one that differs from the row before) a sample sent earlier, ticks.

        A bound; a sample that stays held gets older than this.
        """

    def asks(self, grid: Grid, rows: int) -> tuple[Fraction, int]:
        """The delays it takes from a law for `rows` rows: their period (s) and number."""

    def stream(self, law: Law, grid: Grid, rng: Generator) -> RowStream:
        """The rows from the first read on."""


@dataclass(frozen=True, slots=True)
class SignalSemantics:
    """j = the nearest to (K - T/h)/n_s among the samples sent: ξ(t - T(t)), paper Sec. V, VI."""

    def facts(self) -> dict[str, Any]:
        """Its name."""
        return {"semantics": "signal"}

    def check(self, law: Law, grid: Grid) -> None:
        """Refuse lost packets: T(t) cannot be missing at a look. Raises ScenarioError."""
        if law.loses_packets:
            raise ScenarioError(
                'packets are lost, but semantics = "signal" reads one history continuously;'
                ' expected "last-arrival", "newest-stamp" or "playout"'
            )

    def least(self, law: Law, grid: Grid) -> int:
        """Least ticks between a look and the sample read."""
        return max(0, grid.up(int(_nearest(law.minimum, grid)) - grid.n_s + 1))

    def greatest(self, law: Law, grid: Grid) -> int:
        """Most ticks between a look and the sample read."""
        return int(_nearest(law.maximum, grid))

    def asks(self, grid: Grid, rows: int) -> tuple[Fraction, int]:
        """One delay a look."""
        return grid.receiving_period, rows

    def stream(self, law: Law, grid: Grid, rng: Generator) -> RowStream:
        """The rows from the first read on."""
        return _SignalRows(law, grid, rng)


def _nearest(T: FloatArray | float, grid: Grid) -> FloatArray:
    """floor(T/h + n_s/2) ticks: what is nearest to K - T/h lies at most this far back."""
    back: FloatArray = np.floor(T / grid.h + (0.5 * grid.n_s + TOLERANCE))
    return back


class _SignalRows:
    def __init__(self, law: Law, grid: Grid, rng: Generator) -> None:
        self._delays, self._grid, self._row = law.stream(grid.receiving_period, rng), grid, 0

    def take(self, n: int) -> IntArray:
        n_s, n_r, row = self._grid.n_s, self._grid.n_r, self._row
        self._row += n
        drawn, which = draws(self._delays, n)
        back = _nearest(drawn, self._grid).astype(np.int64)
        if n_r % n_s == 0:  # the receiver reads when the sender sends
            ratio = n_r // n_s
            j: IntArray = np.arange(ratio * row, ratio * (row + n), ratio, dtype=np.int64)
            j -= (back // n_s)[which]
        else:
            K = n_r * np.arange(row, row + n, dtype=np.int64)
            j = np.minimum(
                -((back[which] - K) // n_s), K // n_s
            )  # ceil(j/n_s), if it has been sent
        return np.maximum(j, -1, out=j)


@dataclass(frozen=True, slots=True)
class PacketSemantics:
    """Packets that arrive ceil(T/h) ticks after they were sent, and the order that counts."""

    order: Ordering

    def facts(self) -> dict[str, Any]:
        """Its name."""
        return {"semantics": self.order}

    def check(self, law: Law, grid: Grid) -> None:
        """Refuse lost packets in an ordered stream. Raises ScenarioError."""
        if law.loses_packets and self.order == "fifo":
            raise ScenarioError(
                'packets are lost, but semantics = "fifo" is a reliable stream; expected delays'
                ' that include repetitions, or "last-arrival", "newest-stamp" or "playout"'
            )

    def least(self, law: Law, grid: Grid) -> int:
        """Least delay in ticks, at a look."""
        return grid.up(grid.ticks(law.minimum))

    def greatest(self, law: Law, grid: Grid) -> int:
        """Greatest delay in ticks, and the wait for the next look."""
        return grid.ticks(law.maximum) + grid.n_r - 1

    def asks(self, grid: Grid, rows: int) -> tuple[Fraction, int]:
        """One delay a sample sent."""
        return grid.sending_period, grid.sent(rows)

    def stream(self, law: Law, grid: Grid, rng: Generator) -> RowStream:
        """The rows from the first read on."""
        return _PacketRows(law, grid, rng, self.order)


class _PacketRows:
    """Carry: packets still on their way, and what is held."""

    def __init__(self, law: Law, grid: Grid, rng: Generator, order: Ordering) -> None:
        self._delays, self._grid, self._order = law.stream(grid.sending_period, rng), grid, order
        self._row, self._held = 0, -1
        self._sent = 0  # packets sent so far
        self._arrived = 0  # tick in which the last packet arrives (fifo)
        self._arrival = np.empty(0, np.int64)  # (on the way,), ticks
        self._index = np.empty(0, np.int64)  # (on the way,), ascending

    def take(self, n: int) -> IntArray:
        if n == 0:
            return np.empty(0, np.int64)
        n_r, row = self._grid.n_r, self._row
        arrival, index = self._due(n_r * (row + n - 1))
        self._row += n
        look = -(-arrival // n_r) - row  # the first look that sees it, relative to `row`
        if self._order == "last-arrival":
            rows = _hold(_last(look, arrival - n_r * (row + look), index, n), self._held)
        else:
            rows = np.full(n, self._held, np.int64)
            np.maximum.at(rows, look, index)
            np.maximum.accumulate(rows, out=rows)
        self._held = int(rows[-1])
        return rows

    def _due(self, K: int) -> tuple[IntArray, IntArray]:
        """Arrival ticks and indices of the packets that arrive up to tick K and did not before."""
        index = np.arange(self._sent, K // self._grid.n_s + 1, dtype=np.int64)
        self._sent += index.size
        T = self._delays.take(index.size)
        arrives = np.isfinite(T)
        if not arrives.all():
            index, T = index[arrives], T[arrives]
        arrival = self._grid.n_s * index + self._grid.ticks_up(T).astype(np.int64)
        if self._order == "fifo" and index.size:
            np.maximum.accumulate(arrival, out=arrival)
            np.maximum(arrival, self._arrived, out=arrival)
            self._arrived = int(arrival[-1])
        arrival = np.concatenate((self._arrival, arrival))
        index = np.concatenate((self._index, index))
        due = arrival <= K
        self._arrival, self._index = arrival[~due], index[~due]
        return arrival[due], index[due]


def _last(look: IntArray, tick: IntArray, index: IntArray, n: int) -> IntArray:
    """Of what arrived for each of `n` looks the last by (tick, index); -1 where nothing did.

    `tick` (packets,) is relative to the look, in (-n_r, 0].
    """
    key = np.full(n, -1, np.int64)
    np.maximum.at(key, look, (tick + 2**31 - 1 << 32) + index)
    return np.where(key >= 0, key & 0xFFFFFFFF, -1)


def _hold(fresh: IntArray, held: int) -> IntArray:
    """`fresh` (n,), each -1 replaced by what was there before it; `held`: before the first."""
    if fresh[0] < 0:
        fresh[0] = held
    source = np.where(fresh >= 0, np.arange(fresh.size), 0)
    rows: IntArray = fresh[np.maximum.accumulate(source)]
    return rows


@dataclass(frozen=True, slots=True)
class PlayoutSemantics:
    """Plays the newest sample sent at or before t - buffer (s) if it has arrived, else holds."""

    buffer: float

    def __post_init__(self) -> None:
        """Check the length of the buffer. Raises ScenarioError."""
        if not (isfinite(self.buffer) and self.buffer >= 0):
            raise ScenarioError(f"playout = {self.buffer:g} s; expected a time of 0 or more")

    def facts(self) -> dict[str, Any]:
        """Its name and its buffer (s)."""
        return {"semantics": "playout", "playout": self.buffer}

    def check(self, law: Law, grid: Grid) -> None:
        """Refuse a buffer for which every packet comes too late. Raises ScenarioError."""
        if self.least(law, grid) > self.greatest(law, grid):
            raise ScenarioError(
                f"playout = {self.buffer:g} s delivers no sample: no delay is shorter than"
                f" {law.minimum:g} s"
            )

    def least(self, law: Law, grid: Grid) -> int:
        """The buffer in ticks, or the least delay if that is longer."""
        return grid.up(max(grid.ticks(self.buffer), grid.ticks(law.minimum)))

    def greatest(self, law: Law, grid: Grid) -> int:
        """The buffer in ticks, and the time until the next sample takes over."""
        return grid.ticks(self.buffer) + grid.n_s - 1

    def asks(self, grid: Grid, rows: int) -> tuple[Fraction, int]:
        """One delay a sample that may be played."""
        last = grid.n_r * (rows - 1) - grid.ticks(self.buffer)
        return grid.sending_period, max(0, last // grid.n_s + 1) if rows else 0

    def stream(self, law: Law, grid: Grid, rng: Generator) -> RowStream:
        """The rows from the first read on."""
        return _PlayoutRows(law, grid, rng, grid.ticks(self.buffer))


class _PlayoutRows:
    """Carry: the delay of the sample being played, and what is held."""

    def __init__(self, law: Law, grid: Grid, rng: Generator, buffer: int) -> None:
        self._delays, self._grid, self._buffer = law.stream(grid.sending_period, rng), grid, buffer
        self._row, self._held = 0, -1
        self._first = 0  # sample whose delay stands first in `_T`
        self._T = np.empty(0)  # (samples,), s

    def take(self, n: int) -> IntArray:
        if n == 0:
            return np.empty(0, np.int64)
        n_s, n_r = self._grid.n_s, self._grid.n_r
        K = n_r * np.arange(self._row, self._row + n, dtype=np.int64)
        self._row += n
        j = (K - self._buffer) // n_s  # (n,), to be played
        last = int(j[-1])
        if last < 0:
            return np.full(n, -1, np.int64)
        missing = last + 1 - self._first - self._T.size
        T = np.concatenate((self._T, self._delays.take(missing)))
        late = self._grid.ticks_up(T)[np.maximum(j, 0) - self._first]  # (n,), ticks; lost: nan, inf
        in_time = (j >= 0) & (late <= K - n_s * j)
        rows = _hold(np.where(in_time, j, -1), self._held)
        self._first, self._T, self._held = last, T[-1:], int(rows[-1])
        return rows
