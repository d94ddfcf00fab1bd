"""The packets of one direction: matched stamps in order of sending, with what was lost between.

Stamps are integers of ns until the last step, so that a table that was recorded comes out exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bridge.captures.samples import StreamRows
from bridge.ping.clocks import Floats
from bridge.ping.exchanges import NONE, Integers
from bridge.ping.listening import GAP
from cosim.base.copies import replace
from cosim.base.errors import ScenarioError

Marks = NDArray[np.bool_]

#: Largest part of the median period by which 90 % of the periods may differ from it if lost samples
#: are to be seen as gaps.
REGULAR = 0.25
#: Largest share of samples in a period that has one already, of a regular sender.
TAKEN = 0.01
#: A gap in the numbers longer than this is another start of the sender.
RESTART = 100_000


@dataclass(frozen=True, slots=True, eq=False)
class RecordedWay:
    """Packets of one direction in order of sending: `sent` and `received` (n,), ns of the clocks of
    sender and receiver, `received` NONE: lost.

    `how`: the sense in which losses are known (in words), empty: they are not. `repeated`:
    duplicates left out; `equal`: samples left out that have the stamp of another; `overtaken`:
    samples that arrived after one that was sent later; `unstamped`: samples without a stamp.
    """

    sent: Integers
    received: Integers
    how: str = ""
    repeated: int = 0
    equal: int = 0
    overtaken: int = 0
    unstamped: int = 0

    @property
    def lost(self) -> Marks:
        """The packets that were lost, (n,)."""
        found: Marks = self.received == NONE
        return found

    @property
    def there(self) -> tuple[Integers, Integers]:
        """Sent and received of the packets that arrived, (m,) each, ns."""
        arrived = ~self.lost
        return self.sent[arrived], self.received[arrived]

    @property
    def seconds(self) -> Floats:
        """Times of sending from the first, (n,), s."""
        found: Floats = (self.sent - self.sent[0]) * 1e-9
        return found

    @property
    def period(self) -> float:
        """The median time between two packets, s."""
        return float(np.median(np.diff(self.sent))) * 1e-9

    def remarks(self) -> list[str]:
        """The samples that were left out, in sentences."""
        found = [
            (self.unstamped, "samples have no stamp, and are left out"),
            (self.repeated, "samples came twice; the first of each counts"),
            (self.equal, "samples have the stamp of another, and are left out"),
            (self.overtaken, "samples arrived after one that was sent later"),
        ]
        return [f"{n} {what}" for n, what in found if n]


def one_way(rows: StreamRows, stamps: Integers) -> RecordedWay:
    """The samples of a stream by their own stamps of sending, `stamps` (n,), ns, NONE: not said.

    Raises ScenarioError where fewer than three samples have two stamps.
    """
    usable = (stamps != NONE) & (stamps != 0)
    unstamped = int(np.sum(~usable))
    rows, sent = rows.where(usable), stamps[usable]
    order = np.argsort(sent, kind="stable")
    rows, sent = rows.where(order), sent[order]
    numbers = rows.sequence if sent.size and np.all(rows.sequence != NONE) else None
    again = _again(sent, rows.key if numbers is None else numbers)
    rows, sent = rows.where(~again), sent[~again]
    equal = np.concatenate([[False], np.diff(sent) == 0])
    rows, sent = rows.where(~equal), sent[~equal]
    if int(np.sum(rows.t != NONE)) < 3:
        raise ScenarioError(
            f"{int(np.sum(rows.t != NONE))} samples have a stamp of sending and one of arrival; "
            "expected at least three"
        )
    found = RecordedWay(
        sent, rows.t, repeated=int(again.sum()), equal=int(equal.sum()), unstamped=unstamped
    )
    arrivals = rows.t[rows.t != NONE]
    late = int(np.sum(arrivals < np.maximum.accumulate(arrivals)))
    found = replace(found, overtaken=late)
    if found.lost.any():
        return replace(found, how="by empty cells")
    return _with_losses(found, None if numbers is None else rows.sequence)


def _again(sent: Integers, key: Integers) -> Marks:
    """Samples (n,) in order of sending that repeat the one before: same stamp, same number or
    content.
    """
    same = (np.diff(sent) == 0) & (np.diff(key) == 0)
    return np.concatenate([[False], same]) if sent.size else np.zeros(0, dtype=bool)


def _with_losses(way: RecordedWay, numbers: Integers | None) -> RecordedWay:
    """The same with rows for lost packets, by their numbers, or by gaps of a regular stream."""
    steps = np.diff(way.sent)
    if numbers is not None and (missing := _missing(numbers)) is not None:
        return _inserted(way, missing, "by their numbers")
    median = float(np.median(steps))
    if np.quantile(np.abs(steps - median), 0.9) > REGULAR * median:
        return way
    missing = np.where(steps > GAP * median, np.rint(steps / median).astype(np.int64) - 1, 0)
    return _inserted(way, missing, "by gaps in a regular stream")


def _missing(numbers: Integers) -> Integers | None:
    """The count of numbers left out after each sample but the last, (n - 1,); None if numbers do
    not count the samples of this stream. A smaller number, or a large gap, is another start.
    """
    steps = np.diff(numbers)
    if not steps.size or np.median(steps) != 1:
        return None
    return np.where((steps > 1) & (steps < RESTART), steps - 1, 0)


def _inserted(way: RecordedWay, missing: Integers, how: str) -> RecordedWay:
    """The same with `missing` (n - 1,) lost packets after each, evenly between its neighbours."""
    missing = np.minimum(missing, np.maximum(np.diff(way.sent) - 1, 0))
    after = np.repeat(np.arange(missing.size), missing)
    if not after.size:
        return replace(way, how=how)
    first = np.cumsum(missing) - missing
    k = np.arange(after.size) - first[after] + 1
    gap = way.sent[after + 1] - way.sent[after]
    between = way.sent[after] + k * gap // (missing[after] + 1)
    sent = np.concatenate([way.sent, between])
    received = np.concatenate([way.received, np.full(between.size, NONE)])
    order = np.argsort(sent, kind="stable")
    return replace(way, sent=sent[order], received=received[order], how=how)


def periodic_way(rows: StreamRows, period_ns: int) -> RecordedWay:
    """Samples of a sender that is known to send every `period_ns`, by its own clock, as if each had
    been sent at a multiple of it; losses are the multiples that have none.

    Raises ScenarioError for fewer than three samples, and where arrivals are not that regular.
    """
    arrived = np.sort(rows.t[rows.t != NONE])
    if arrived.size < 3:
        raise ScenarioError(f"{arrived.size} samples; expected at least three")
    steps = np.maximum(np.rint(np.diff(arrived) / period_ns), 0).astype(np.int64)
    place = np.concatenate([[0], np.cumsum(steps)])
    # Jitter turns 1 + 1 into 0 + 2 or 2 + 0: the sample between them has the place that is free.
    place[1:-1] += (steps[:-1] == 0) & (steps[1:] == 2)
    place[1:-1] -= (steps[:-1] == 2) & (steps[1:] == 0)
    again = np.concatenate([[False], np.diff(place) == 0])
    if again.sum() > TAKEN * place.size:
        raise ScenarioError(
            f"{int(again.sum())} of {place.size} samples came when their period had one already; "
            f"expected arrivals within half of {period_ns * 1e-6:.6g} ms: is --period right?"
        )
    place, arrived = place[~again], arrived[~again]
    sent = np.arange(int(place[-1]) + 1) * period_ns + arrived[0]
    received = np.full(sent.size, NONE)
    received[place] = arrived
    return RecordedWay(sent, received, "by gaps in the period", repeated=int(again.sum()))
