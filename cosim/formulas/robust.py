"""Formulas of signal temporal logic with their robustness on recorded rows.

Signals hold their value from a recorded row to the next one. A formula has a robustness at each
row, which holds in the same way (Donzé & Maler 2010, Fainekos & Pappas 2009):

==================  ===========================================================================
``large >= small``  the least entry of large - small; -inf where it is not a finite number, and
                    inf if the comparison is negated, so that this violates the requirement
``not a``           -a
``a and b``         min(a, b); ``a or b``: max(a, b); ``a implies b``: max(-a, b)
``always a``        min of a(s) over the closed interval [t + begin, t + end] of s
``eventually a``    max of a(s) over it
``a until b``       max over s in it of min(b(s), min of a over [t, s))
==================  ===========================================================================

The rows of an interval are those in it and the one that holds at its begin. An interval without an
end reaches to the last time at which the formula in it can be judged: until its own intervals, its
*tail*, end where the run ends. An interval without rows makes ``always`` inf and ``eventually``
-inf. What is not recorded may have any value: :class:`RecordedTrace`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any, Protocol, final

import numpy as np

from cosim.formulas import windows
from cosim.formulas.syntax import TimeInterval
from cosim.formulas.terms import Lookup, Term, value
from cosim.formulas.windows import Array, Rows

#: Times that differ by this share of the mean step are the same.
SAME = 1e-6
_FIRST = slice(0, 1)


@final
@dataclass(frozen=True, slots=True)
class Row:
    """A row of a run: its number and its time, s."""

    number: int
    time: float


@final
class RecordedTrace:
    """Recorded signals with the values of formulas on them.

    `t`: times of the rows, (n,), s; `lookup`: their values; `end`: of the run, s. `beyond`: None;
    or a row behind the last one stands for all that is not recorded, and is -1: as bad as possible,
    or 1: as good as possible. `step`: the mean step of the run, s, if `t` lacks rows.

    A long run is read from its end in pieces, each a trace of its `own` rows, which keeps of the
    rows behind them what a formula needs: :meth:`earlier`.
    """

    def __init__(
        self,
        t: Array,
        lookup: Lookup,
        end: float,
        beyond: int | None = None,
        step: float | None = None,
    ) -> None:
        self.lookup, self.rows, self.beyond = lookup, len(t), beyond
        span = float(t[-1] - t[0]) / max(1, len(t) - 1) if step is None else step
        self._same = SAME * span if span > 0 else SAME
        self.t = t if beyond is None else np.append(t, t[-1] + 4.0 * self._same)
        self._end = float(t[-1]) if beyond is None else max(end, float(t[-1]))
        self.own = slice(0, len(self.t))
        self._open = beyond is not None
        self._kept: dict[int, Array] = {}
        self._rest: dict[int, float] = {}
        self._windows: dict[tuple[Any, ...], tuple[Rows, Rows]] = {}
        self._values: dict[tuple[int, bool], Array] = {}

    def window(self, interval: TimeInterval, tail: float, rows: slice) -> tuple[Rows, Rows]:
        """The first and last row of an interval from each of `rows` on; `tail`: of the formula in
        it.
        """
        key = interval, tail, rows.start, rows.stop
        if key not in self._windows:
            self._windows[key] = self._window(interval, tail, self.t[rows])
        return self._windows[key]

    def _window(self, interval: TimeInterval, tail: float, t: Array) -> tuple[Rows, Rows]:
        same = self._same
        begin = t + (interval.begin + same)
        first = windows.last_at(self.t, begin)
        if interval.end == inf:
            end = self._end - tail
            last = np.full(len(t), self.rows_until(tail) - 1)
        else:
            end = inf if self._open else self._end
            last = windows.last_at(self.t, t + (interval.end + same))
        last[begin - 2.0 * same > end] = -1  # it begins behind the end
        return first, last

    def rows_until(self, tail: float) -> int:
        """The number of rows at which a formula can be judged that needs `tail` s behind them."""
        return int(np.searchsorted(self.t, self._end - tail + self._same, side="right"))

    def values(self, formula: Robust, only_first: bool) -> Array:
        """The robustness of a formula at each row, (n,), or at the first one, (1,)."""
        key = id(formula), only_first
        if key not in self._values:
            found = formula.over(self, only_first)
            if self._kept and not only_first:
                found = np.concatenate((found[self.own], self._kept[id(formula)]))
            self._values[key] = found
        return self._values[key]

    def at_first(self, formula: Robust) -> float:
        """The robustness of a formula at the first row."""
        return self.at(formula, 0)

    def decisive(self, formula: Robust) -> Row | None:
        """The row whose comparison decides that; None where no recorded one does."""
        row = formula.decisive(self, 0)
        return None if row is None or row == self.rows else Row(row, float(self.t[row]))

    def rest(self, formula: Robust, empty: float) -> float:
        """What an operator without an end makes of rows that are not kept; `empty`: of none."""
        return self._rest.get(id(formula), empty)

    def earlier(self, t: Array, lookup: Lookup, formulas: Sequence[Robust]) -> RecordedTrace:
        """The trace of the rows just before these, with what formulas need of these."""
        parts = [node for formula in formulas for node in nodes(formula)]
        reach = self.t[0] + max(node.needed for node in parts) + 4.0 * self._same
        count = int(np.searchsorted(self.t, reach, side="right"))
        found = RecordedTrace(t, lookup, self._end)
        found.t, found.own = np.concatenate((t, self.t[:count])), slice(0, len(t))
        found._same, found._end, found._open = self._same, self._end, self._open
        found._kept = {id(node): self.values(node, False)[:count] for node in parts}
        found._rest = {id(node): node.behind(self, count) for node in parts}
        return found

    def within(self, interval: TimeInterval, tail: float, time: float) -> slice:
        """The own rows of an interval from a time on, s; `tail` as in :meth:`window`.

        It begins below 0 where the interval begins before these rows.
        """
        begin = time + (interval.begin + self._same)
        last, end = self.rows_until(tail), self._end - tail
        if interval.end < inf:
            end = inf if self._open else self._end
            behind = time + (interval.end + self._same)
            last = int(np.searchsorted(self.t, behind, side="right"))
        if begin - 2.0 * self._same > end:
            return slice(0, 0)
        own = self.t[self.own]
        return slice(int(np.searchsorted(own, begin, side="right")) - 1, min(last, len(own)))

    def at(self, formula: Robust, row: int) -> float:
        """The robustness of a formula at a row."""
        if row == 0 and (id(formula), False) not in self._values:
            return float(self.values(formula, True)[0])
        return float(self.values(formula, False)[row])


class Robust(Protocol):
    """A formula that has a robustness, in the unit of its requirement."""

    def over(self, trace: RecordedTrace, only_first: bool) -> Array:
        """The robustness at each row, (n,), or at the first one, (1,)."""

    def decisive(self, trace: RecordedTrace, row: int) -> int | None:
        """The row whose comparison decides the robustness at `row`; None: there is none."""

    @property
    def tail(self) -> float:
        """The time behind a row that its robustness needs at least, s."""

    @property
    def parts(self) -> tuple[Robust, ...]:
        """The formulas that it is made of."""

    @property
    def needed(self) -> float:
        """The time behind a row at which it needs its parts, s."""

    def behind(self, trace: RecordedTrace, row: int) -> float:
        """The value for :meth:`RecordedTrace.rest` of the rows from `row` on."""


def nodes(formula: Robust) -> Iterator[Robust]:
    """A formula and all that it is made of."""
    yield formula
    for part in formula.parts:
        yield from nodes(part)


class _AtOnce:
    """A formula that needs its parts at its own time only."""

    __slots__ = ()

    needed = 0.0

    def behind(self, trace: RecordedTrace, row: int) -> float:
        """See :class:`Robust`: nothing."""
        return 0.0


@final
@dataclass(frozen=True, slots=True)
class HeldInequality(_AtOnce):
    """`margin >= 0` for every entry; its unit is `scale` in SI. `negated`: by an odd number of
    ``not`` around it.
    """

    margin: Term
    scale: float = 1.0
    negated: bool = False

    tail = 0.0
    parts = ()

    def over(self, trace: RecordedTrace, only_first: bool) -> Array:
        """Robustness by row (n,) or (1,): :class:`Robust`."""
        x = value(self.margin, trace.lookup)
        if len(x) == 1:
            least = x[0]
            finite = np.isfinite(least)
        else:
            least, finite = x.min(axis=0), np.isfinite(x).all(axis=0)
        worst = inf if self.negated else -inf
        found = least / self.scale if self.scale != 1.0 else least
        if not finite.all():
            found = np.where(finite, found, worst)
        if len(found) != trace.rows:
            found = np.full(trace.rows, found[0])
        if trace.beyond is not None:
            found = np.append(found, -trace.beyond * worst)
        return np.asarray(found[:1] if only_first else found)

    def decisive(self, trace: RecordedTrace, row: int) -> int | None:
        """See :class:`Robust`."""
        return row


@final
@dataclass(frozen=True, slots=True)
class Not(_AtOnce):
    """The negation of a formula."""

    of: Robust

    @property
    def parts(self) -> tuple[Robust, ...]:
        """See :class:`Robust`."""
        return (self.of,)

    @property
    def tail(self) -> float:
        """See :class:`Robust`, s."""
        return self.of.tail

    def over(self, trace: RecordedTrace, only_first: bool) -> Array:
        """Robustness by row (n,) or (1,): :class:`Robust`."""
        return -trace.values(self.of, only_first)

    def decisive(self, trace: RecordedTrace, row: int) -> int | None:
        """See :class:`Robust`."""
        return self.of.decisive(trace, row)


@final
@dataclass(frozen=True, slots=True)
class Both(_AtOnce):
    """The conjunction of two formulas, or with `either` the disjunction."""

    left: Robust
    right: Robust
    either: bool = False

    @property
    def parts(self) -> tuple[Robust, ...]:
        """See :class:`Robust`."""
        return self.left, self.right

    @property
    def tail(self) -> float:
        """See :class:`Robust`, s."""
        return max(self.left.tail, self.right.tail)

    def over(self, trace: RecordedTrace, only_first: bool) -> Array:
        """Robustness by row (n,) or (1,): :class:`Robust`."""
        combine = np.maximum if self.either else np.minimum
        return np.asarray(combine(*(trace.values(x, only_first) for x in (self.left, self.right))))

    def decisive(self, trace: RecordedTrace, row: int) -> int | None:
        """See :class:`Robust`."""
        left, right = trace.at(self.left, row), trace.at(self.right, row)
        takes_left = left >= right if self.either else left <= right
        return (self.left if takes_left else self.right).decisive(trace, row)


@final
@dataclass(frozen=True, slots=True)
class Extreme:
    """``always``, or with `eventually` that, within an interval."""

    of: Robust
    interval: TimeInterval
    eventually: bool = False

    @property
    def tail(self) -> float:
        """See :class:`Robust`, s."""
        return self.interval.needed + self.of.tail

    def over(self, trace: RecordedTrace, only_first: bool) -> Array:
        """Robustness by row (n,) or (1,): :class:`Robust`."""
        combine, empty = self.combine
        x = trace.values(self.of, False)
        first, last = trace.window(self.interval, self.of.tail, _FIRST if only_first else trace.own)
        if only_first:
            return np.array([combine.reduce(x[first[0] : last[0] + 1], initial=empty)])
        found = windows.extremes(x, first, last, combine, empty)
        rest = trace.rest(self, empty)
        return found if rest == empty else np.asarray(combine(found, rest))

    @property
    def combine(self) -> tuple[np.ufunc, float]:
        """The function of two values, and the value of none."""
        return (np.maximum, -inf) if self.eventually else (np.minimum, inf)

    @property
    def parts(self) -> tuple[Robust, ...]:
        """See :class:`Robust`."""
        return (self.of,)

    @property
    def needed(self) -> float:
        """See :class:`Robust`, s."""
        return self.interval.needed

    def behind(self, trace: RecordedTrace, row: int) -> float:
        """See :class:`Robust`."""
        combine, empty = self.combine
        if self.interval.end < inf:
            return empty
        x = trace.values(self.of, False)[row : trace.rows_until(self.of.tail)]
        return float(combine.reduce(x, initial=trace.rest(self, empty)))

    def decisive(self, trace: RecordedTrace, row: int) -> int | None:
        """See :class:`Robust`."""
        only = slice(row, row + 1)
        first, last = (int(x[0]) for x in trace.window(self.interval, self.of.tail, only))
        if last < first:
            return None
        x = trace.values(self.of, False)[first : last + 1]
        best = np.argmax(x) if self.eventually else np.argmin(x)
        return self.of.decisive(trace, first + int(best))


@final
@dataclass(frozen=True, slots=True)
class Until:
    """`left` holds until `right` does, within an interval."""

    left: Robust
    right: Robust
    interval: TimeInterval

    @property
    def tail(self) -> float:
        """See :class:`Robust`, s."""
        return self.interval.needed + self._inner

    @property
    def _inner(self) -> float:
        return max(self.left.tail, self.right.tail)

    def over(self, trace: RecordedTrace, only_first: bool) -> Array:
        """Robustness by row (n,) or (1,): :class:`Robust`.

        For bounded intervals by Donzé, Ferrère & Maler 2013, lemma 2: always `left` before the
        interval, eventually `right` in it, and until without an end.
        """
        if only_first:
            return np.array([self._at(trace, 0)[0]])
        left, right = trace.values(self.left, False), trace.values(self.right, False)
        first, last = trace.window(self.interval, self._inner, trace.own)
        behind = int(last.max()) + 1  # the last row of any interval
        if not behind:
            return np.full(len(first), -inf)
        ends = windows.until(left[:behind], right[:behind], trace.rest(self, -inf))
        before = windows.extremes(left, np.arange(len(first)), first - 1, np.minimum, inf)
        found = np.minimum(before, ends[np.minimum(first, behind - 1)])
        if self.interval.end < inf:
            most = windows.extremes(right, first, last, np.maximum, -inf)
            found = np.minimum(found, most)
        return np.where(last < first, -inf, found)

    @property
    def parts(self) -> tuple[Robust, ...]:
        """See :class:`Robust`."""
        return self.left, self.right

    @property
    def needed(self) -> float:
        """See :class:`Robust`, s."""
        return self.interval.needed

    def behind(self, trace: RecordedTrace, row: int) -> float:
        """See :class:`Robust`."""
        rest, end = trace.rest(self, -inf), trace.rows_until(self._inner)
        if self.interval.end < inf or end <= row:
            return rest
        left, right = (trace.values(part, False)[row:end] for part in self.parts)
        return float(windows.until(left, right, rest)[0])

    def decisive(self, trace: RecordedTrace, row: int) -> int | None:
        """See :class:`Robust`."""
        _, at, of = self._at(trace, row)
        return None if of is None else of.decisive(trace, at)

    def _at(self, trace: RecordedTrace, row: int) -> tuple[float, int, Robust | None]:
        """The robustness at a row, and the row and formula that decide it."""
        only = slice(row, row + 1)
        first, last = (int(x[0]) for x in trace.window(self.interval, self._inner, only))
        if last < first:
            return -inf, row, None
        left = trace.values(self.left, False)[row:last]
        right = trace.values(self.right, False)[first : last + 1]
        before = np.append(inf, np.minimum.accumulate(left))[first - row :]
        each = np.minimum(right, before)
        best = int(np.argmax(each))
        if right[best] <= before[best]:
            return float(each[best]), first + best, self.right
        worst = int(np.argmin(left[: first - row + best]))
        return float(each[best]), row + worst, self.left
