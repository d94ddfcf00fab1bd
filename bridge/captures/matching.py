"""Packets of two recordings of the two ends, matched by content.

Contents that occur once at each end are certain. One that occurs more often is matched with the
nearest of its kind where the certain ones around say it should be, if its kind is rarer than their
spread; the others are left out, and counted. Where there are no certain ones and both ends have one
clock, a packet arrived before the next one of its content was sent. A packet that the second end
never has was lost, from the first matched packet to the last.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bridge.captures.samples import StreamRows
from bridge.captures.ways import RecordedWay
from bridge.ping.clocks import Floats
from bridge.ping.exchanges import NONE, Integers
from cosim.base.errors import ScenarioError

#: Fewest certain pairs.
CERTAIN = 3


class MatchedWay(NamedTuple):
    """A direction; `ambiguous`: packets left out whose content repeats; `strange`: packets that
    only the receiver has; `window`: delays are taken to be shorter than this, s, 0: they need not.
    """

    way: RecordedWay
    ambiguous: int
    strange: int
    window: float = 0.0

    def remarks(self) -> list[str]:
        """The packets that were left out, in sentences."""
        found = list(self.way.remarks())
        if self.ambiguous:
            found.append(
                f"{self.ambiguous} packets have contents that repeat too often to be matched, and "
                "are left out"
            )
        if self.window:
            found.append(
                f"contents repeat after {1e3 * self.window:.3g} ms: longer delays are taken for "
                "shorter ones"
            )
        if self.strange:
            found.append(
                f"{self.strange} packets of the receiver are not in the sender's recording"
            )
        return found


def shared(a: StreamRows, b: StreamRows) -> int:
    """The number of contents that both streams have."""
    return int(np.intersect1d(a.key, b.key).size)


def matched(sender: StreamRows, receiver: StreamRows, one_clock: bool = False) -> MatchedWay:
    """The packets of a stream at its two ends; `one_clock`: their stamps are of one clock.

    Raises ScenarioError where contents cannot be matched.
    """
    a = sender.where(np.argsort(sender.t, kind="stable"))
    b = receiver.where(np.argsort(receiver.t, kind="stable"))
    keys, codes = np.unique(np.concatenate([a.key, b.key]), return_inverse=True)
    code_a, code_b = codes[: a.t.size], codes[a.t.size :]
    count_a = np.bincount(code_a, minlength=keys.size)
    count_b = np.bincount(code_b, minlength=keys.size)
    pairs = _certain(code_a, code_b, (count_a == 1) & (count_b == 1))
    if pairs[0].size < CERTAIN:
        pairs = _in_order(code_a, code_b, (count_a == count_b) & (count_a > 0))
        if not _plausible(a.t, b.t, pairs):
            pairs = (pairs[0][:0], pairs[1][:0])
        if not pairs[0].size and not one_clock:
            raise ScenarioError(
                f"{int(np.sum((count_a > 0) & (count_b > 0)))} contents are at both ends, and none "
                "of them tells its packet from others; expected a counter or a stamp in them"
            )
    received, ambiguous, window = _all_pairs(a.t, b.t, (code_a, code_b), (count_a, count_b), pairs)
    rows = np.flatnonzero(received != NONE)
    if rows.size < CERTAIN:
        raise ScenarioError(f"{rows.size} packets are at both ends; expected at least {CERTAIN}")
    inside = np.zeros(a.t.size, dtype=bool)
    inside[rows[0] : rows[-1] + 1] = True
    open_ = inside & ~ambiguous
    sent, received = a.t[open_], received[open_]
    arrivals = received[received != NONE]
    late = int(np.sum(arrivals < np.maximum.accumulate(arrivals)))
    equal = np.concatenate([[False], np.diff(sent) == 0])
    way = RecordedWay(
        sent[~equal], received[~equal], "by the other recording",
        repeated=int(np.sum(np.maximum(count_b - count_a, 0)[count_a > 0])),
        equal=int(equal.sum()), overtaken=late,
    )  # fmt: skip
    return MatchedWay(
        way, int(np.sum(ambiguous & inside)), int(np.sum(count_a[code_b] == 0)), window
    )


Pairs = tuple[Integers, Integers]  # rows of the sender, rows of the receiver


def _certain(code_a: Integers, code_b: Integers, once: np.ndarray) -> Pairs:
    where_b = np.zeros(once.size, dtype=np.int64)
    where_b[code_b] = np.arange(code_b.size)
    rows = np.flatnonzero(once[code_a])
    return rows, where_b[code_a[rows]]


def _in_order(code_a: Integers, code_b: Integers, wanted: np.ndarray) -> Pairs:
    """The first of a kind with the first, the second with the second, …"""
    rows_a, rows_b = np.flatnonzero(wanted[code_a]), np.flatnonzero(wanted[code_b])
    order_a = rows_a[np.argsort(code_a[rows_a], kind="stable")]
    order_b = rows_b[np.argsort(code_b[rows_b], kind="stable")]
    back = np.argsort(order_a)
    return order_a[back], order_b[back]


def _plausible(t_a: Integers, t_b: Integers, pairs: Pairs) -> bool:
    """True if delays of pairs spread less than packets are apart."""
    if pairs[0].size < CERTAIN:
        return False
    low, high = np.quantile(t_b[pairs[1]] - t_a[pairs[0]], (0.05, 0.95))
    return bool(high - low < np.median(np.diff(t_a)))


def _all_pairs(
    t_a: Integers, t_b: Integers, codes: Pairs, counts: Pairs, pairs: Pairs
) -> tuple[Integers, np.ndarray, float]:
    """The arrival of each packet of the sender (n,), ns, NONE: none; the ambiguous ones (n,); the
    time after which contents repeat, s, where there are no `pairs` to begin with, else 0.
    """
    received = np.full(t_a.size, NONE)
    received[pairs[0]] = t_b[pairs[1]]
    paired = np.zeros(counts[0].size, dtype=bool)
    paired[codes[0][pairs[0]]] = True
    rest = np.flatnonzero((counts[0] > 0) & (counts[1] > 0) & ~paired)
    ambiguous = np.zeros(t_a.size, dtype=bool)
    if not rest.size:
        return received, ambiguous, 0.0
    shortest = np.inf
    expected, spread = _expected(t_a, t_b, pairs)
    order_a, order_b = (np.argsort(code, kind="stable") for code in codes)
    ends_a, ends_b = (np.cumsum(count) for count in counts)
    for code in rest.tolist():
        rows_a = order_a[ends_a[code] - counts[0][code] : ends_a[code]]
        rows_b = order_b[ends_b[code] - counts[1][code] : ends_b[code]]
        at = expected[rows_a]
        apart = np.diff(at)
        if apart.size and apart.min() < 2 * spread:
            ambiguous[rows_a] = True
            continue
        reach = float(apart.min()) / 2 if apart.size else np.inf
        if not pairs[0].size and apart.size:
            at, shortest = at + reach, min(shortest, 2 * reach)
        came = t_b[rows_b]
        nearest = _nearest(at, came)
        good = np.abs(came[nearest] - at) <= reach
        received[rows_a[good]] = came[nearest[good]]
    return received, ambiguous, 1e-9 * shortest if shortest < np.inf else 0.0


def _nearest(at: Floats, came: Integers) -> Integers:
    """For each of `at` (n,) the nearest of `came` (m,), both in order."""
    right = np.clip(np.searchsorted(came, at), 1, came.size - 1)
    return np.where(at - came[right - 1] <= came[right] - at, right - 1, right)


def _expected(t_a: Integers, t_b: Integers, pairs: Pairs) -> tuple[Floats, float]:
    """The expected arrivals of the sender's packets by the pairs around them (n,), ns, and how far
    delays of these pairs are from each other, ns.
    """
    if pairs[0].size < CERTAIN:
        return t_a.astype(np.float64), 0.0
    delay = t_b[pairs[1]] - t_a[pairs[0]]
    base = int(np.median(delay))
    smooth = np.interp(t_a, t_a[pairs[0]], delay - base)
    spread = float(np.quantile(np.abs(np.diff(delay)), 0.99)) if delay.size > 1 else 0.0
    return t_a + base + smooth, spread
