"""Times at which a link is written and read, and six rules for the sample that a read holds.

A rule (the semantics) selects one of the samples that have arrived.

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
``queue``
    Packets wait at the receiver, in the order in which they arrive, in a queue of `depth`. A read
    takes the first (`take` one), or takes all and holds the last (all); of an empty queue it keeps
    what it holds. If a packet arrives at a full queue, the first leaves it (`drop` oldest), or it
    is dropped itself (newest).

Rounding: T is rounded **up** to whole ticks for packets and to the **nearest** sample for
`signal`, where a tie goes to the older sample (so that a constant delay stays constant; rounding
halves to even would make it alternate). A tolerance of 1e-9 tick applies: 0.3 s / 5 ms is 60 ticks.

This module has what must be known of the rules before a run; the rows are made in C (``tables.c``).

Source: the paper, eq. (61), for `signal`; the rules for packets are our own construction.
"""

from __future__ import annotations

from fractions import Fraction
from math import ceil, floor, gcd, isfinite
from typing import Any, Literal, Protocol

import numpy as np

from cosim.base.convert import Struct
from cosim.base.errors import ScenarioError
from cosim.links.keys import Drop, Take
from cosim.links.laws import IntArray, Law, decimal_fraction

Ordering = Literal["last-arrival", "newest-stamp", "fifo"]
#: Samples that a queue can hold, at most.
DEEPEST = 100_000


class Rule(Protocol):
    """A semantics: declared facts of the rows that ``tables.c`` makes of a law."""

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


class SignalSemantics(Struct, frozen=True):
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
        return max(0, grid.up(_nearest(law.minimum, grid) - grid.n_s + 1))

    def greatest(self, law: Law, grid: Grid) -> int:
        """Most ticks between a look and the sample read."""
        return _nearest(law.maximum, grid)

    def asks(self, grid: Grid, rows: int) -> tuple[Fraction, int]:
        """One delay a look."""
        return grid.receiving_period, rows


def _nearest(T: float, grid: Grid) -> int:
    """floor(T/h + n_s/2) ticks: what is nearest to K - T/h lies at most this far back."""
    return floor(T / grid.h + (0.5 * grid.n_s + TOLERANCE))


class PacketSemantics(Struct, frozen=True):
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


class PlayoutSemantics(Struct, frozen=True):
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


class QueueSemantics(Struct, frozen=True):
    """Packets wait in a queue of `depth`; a look takes one, or all and holds the last."""

    depth: int
    drop: Drop = "oldest"
    take: Take = "one"

    def __post_init__(self) -> None:
        """Check the depth. Raises ScenarioError."""
        if not 1 <= self.depth <= DEEPEST:
            raise ScenarioError(f"depth = {self.depth}; expected 1 to {DEEPEST} samples")

    def facts(self) -> dict[str, Any]:
        """Its name, its depth (samples), and what it drops and takes."""
        return {
            "semantics": "queue",
            "depth": self.depth,
            "drop": self.drop,
            "take": self.take,
        }

    def check(self, law: Law, grid: Grid) -> None:
        """Refuse nothing: what is lost does not enter the queue."""

    def least(self, law: Law, grid: Grid) -> int:
        """Least delay in ticks, at a look."""
        return grid.up(grid.ticks(law.minimum))

    def greatest(self, law: Law, grid: Grid) -> int:
        """Greatest delay in ticks, and the looks until it is the turn of the last in the queue.

        One that drops the oldest has the last `depth` arrivals, which are at most n_s·depth and the
        jitter apart, if none is lost.
        """
        most = grid.ticks(law.maximum)
        looks = self.longest(law, grid) if self.take == "one" else 1
        waits = looks * grid.n_r
        if self.drop == "oldest" and not law.loses_packets:
            waits = min(waits, most - grid.ticks(law.minimum) + self.depth * grid.n_s)
        return most + waits - 1

    def asks(self, grid: Grid, rows: int) -> tuple[Fraction, int]:
        """One delay a sample sent."""
        return grid.sending_period, grid.sent(rows)

    def longest(self, law: Law, grid: Grid) -> int:
        """No more samples wait at a time.

        If no more are sent than taken, these are what may arrive before one is taken: the arrivals
        in `t` ticks are at most (t + jitter)/n_s + 1.
        """
        if self.take == "one" and self.grows(grid):
            return self.depth
        jitter = grid.ticks(law.maximum) - grid.ticks(law.minimum)
        return min(self.depth, (grid.n_r - 1 + jitter) // grid.n_s + 1)

    def grows(self, grid: Grid, share: float = 1.0) -> bool:
        """True if more samples arrive than are taken, where a `share` of those sent arrives."""
        return self.take == "one" and share * grid.n_r > grid.n_s * (1 + TOLERANCE)


TOLERANCE = 1e-9  # ticks; 0.3 s / 5 ms is 60 of them, not 61


class Grid(Struct, frozen=True):
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


class Cycle(Struct, frozen=True):
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
