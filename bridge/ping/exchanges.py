"""The record of a ping: for each question its stamps, in bounded memory, and what else came."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, final

import numpy as np
from numpy.typing import NDArray

Integers = NDArray[np.int64]

#: Most questions that are kept; of a longer measurement the last ones.
CAPACITY = 1_000_000
#: A stamp that is not known.
NONE = np.iinfo(np.int64).min
_STAMPS = ("due", "t1", "call", "t2", "wake_there", "t3", "t4", "wake_here", "heard", "count")


class Arrival(NamedTuple):
    """Data that arrived at `t_ns` of our monotonic clock, `wake_ns` before it could be processed.

    With a kernel stamp `t_ns` is that of the kernel; without one `wake_ns` is 0 or what is known.
    `sender`: where an answer goes to, None where there is only one place.
    """

    data: bytes
    t_ns: int
    wake_ns: int = 0
    sender: object = None


class PingPath(Protocol):
    """Two ends of which this is one."""

    def send(self, data: bytes, to: object = None) -> None:
        """Send; `to`: the `sender` of an arrival. Raises RunError where that is not possible."""

    def receive(self, until_ns: int) -> Sequence[Arrival]:
        """The arrivals so far, or the first ones before `until_ns`; empty if there are none."""

    def close(self) -> None:
        """Let go of it."""


@dataclass(frozen=True, slots=True)
class ReceivedAnswer:
    """An answer: to question `k` (its low `bits`), with the stamps of the responder, ns.

    `t2`, `t3`: received and sent, of its clock, NONE if it does not say; `wake`: from arrival to
    processing; `heard`: different questions it had heard by then in its count `count`, NONE if it
    does not say; `host`: of its clock, 0: unknown; `date`, `error`: of its clock, ns.
    """

    k: int
    t2: int = NONE
    t3: int = NONE
    wake: int = 0
    heard: int = NONE
    host: int = 0
    date: int = 0
    error: int = -1
    count: int = 0


class PingCodec(Protocol):
    """The form of questions and answers on a path."""

    def question(self, k: int, t1_ns: int) -> bytes:
        """The data of question `k`, sent at `t1_ns`."""

    def answer(self, data: bytes, sent: int) -> ReceivedAnswer | None:
        """The answer in `data`, None for anything else; `sent`: questions sent so far."""


@final
class Exchanges:
    """Questions and their answers. Rows are in the order of the questions.

    `what`: the path in words; `size`: bytes of a question's payload; `strange`: data that were no
    answer to a question; `refused`: questions that the system did not take.
    """

    def __init__(self, what: str, expected: int, size: int, period_ns: int) -> None:
        self.what, self.size, self.period_ns = what, size, period_ns
        self._capacity = max(1, min(expected, CAPACITY))
        self._rows = np.full((self._capacity, len(_STAMPS)), NONE, dtype=np.int64)
        self.sent = self.received = self.duplicates = self.strange = self.reordered = 0
        self.refused = 0
        self._highest = -1
        self._before = 0
        self.other: ReceivedAnswer | None = None
        self.last_rtt_ns = 0

    @property
    def first(self) -> int:
        """Number of the first question that is kept."""
        return max(0, self.sent - self._capacity)

    @property
    def whole(self) -> bool:
        """True if the very first question of the measurement is kept."""
        return self.first == 0 and self._before == 0

    def asked(self, due_ns: int, t1_ns: int, call_ns: int) -> None:
        """A question was sent: due, before the call, and how long the call took."""
        row = self._rows[self.sent % self._capacity]
        row[:] = NONE
        row[:3] = due_ns, t1_ns, call_ns
        self.sent += 1

    def answered(self, answer: ReceivedAnswer, arrival: Arrival) -> None:
        """An answer has come."""
        if not self.first <= answer.k < self.sent:
            self.strange += 1
            return
        row = self._rows[answer.k % self._capacity]
        if row[6] != NONE:
            self.duplicates += 1
            return
        row[3:] = (
            answer.t2, answer.wake, answer.t3, arrival.t_ns, arrival.wake_ns, answer.heard,
            answer.count,
        )  # fmt: skip
        self.received += 1
        self.reordered += answer.k < self._highest
        self._highest = max(self._highest, answer.k)
        self.other = answer
        self.last_rtt_ns = arrival.t_ns + arrival.wake_ns - int(row[1])

    def stamp(self, name: str) -> Integers:
        """One stamp of each question that is kept, (n,), ns, a copy; NONE where it is unknown."""
        column = self._rows[:, _STAMPS.index(name)]
        start = self.first % self._capacity
        if self.sent <= self._capacity:
            return np.array(column[: self.sent])
        return np.roll(column, -start)

    def between(self, first: int, last: int) -> Exchanges:
        """A copy of the questions from `first` up to, without, `last`, all of which are kept."""
        part = Exchanges(self.what, last - first, self.size, self.period_ns)
        rows = np.arange(first, last) % self._capacity
        part._rows[:] = self._rows[rows]
        part.sent, part._before = last - first, self._before + first
        part.received = int(np.count_nonzero(part._rows[:, _STAMPS.index("t4")] != NONE))
        part.other = self.other
        return part
