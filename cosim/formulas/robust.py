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
_FIRST, _ALL = slice(0, 1), slice(0, None)


@final
class RecordedTrace:
    """Recorded signals with the values of formulas on them.

    `t`: times of the rows, (n,), s; `lookup`: their values; `end`: of the run, s. `beyond`: None;
    or a row behind the last one stands for all that is not recorded, and is -1: as bad as possible,
    or 1: as good as possible. `step`: the mean step of the run, s, if `t` lacks rows.
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
            last = np.full(len(t), np.searchsorted(self.t, end + same, side="right") - 1)
        else:
            end = self._end if self.beyond is None else inf
            last = windows.last_at(self.t, t + (interval.end + same))
        last[begin - 2.0 * same > end] = -1  # it begins behind the end
        return first, last

    def values(self, formula: Robust, only_first: bool) -> Array:
        """The robustness of a formula at each row, (n,), or at the first one, (1,)."""
        key = id(formula), only_first
        if key not in self._values:
            self._values[key] = formula.over(self, only_first)
        return self._values[key]

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


@final
@dataclass(frozen=True, slots=True)
class HeldInequality:
    """`margin >= 0` for every entry; its unit is `scale` in SI. `negated`: by an odd number of
    ``not`` around it.
    """

    margin: Term
    scale: float = 1.0
    negated: bool = False

    tail = 0.0

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
class Not:
    """The negation of a formula."""

    of: Robust

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
class Both:
    """The conjunction of two formulas, or with `either` the disjunction."""

    left: Robust
    right: Robust
    either: bool = False

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
        combine = np.maximum if self.eventually else np.minimum
        empty = -inf if self.eventually else inf
        x = trace.values(self.of, False)
        first, last = trace.window(self.interval, self.of.tail, _FIRST if only_first else _ALL)
        if only_first:
            return np.array([combine.reduce(x[first[0] : last[0] + 1], initial=empty)])
        return windows.extremes(x, first, last, combine, empty)

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
        first, last = trace.window(self.interval, self._inner, _ALL)
        behind = int(last.max()) + 1  # the last row of any interval
        if not behind:
            return np.full(len(left), -inf)
        ends = windows.until(left[:behind], right[:behind])
        before = windows.extremes(left, np.arange(len(left)), first - 1, np.minimum, inf)
        found = np.minimum(before, ends[np.minimum(first, behind - 1)])
        if self.interval.end < inf:
            most = windows.extremes(right, first, last, np.maximum, -inf)
            found = np.minimum(found, most)
        return np.where(last < first, -inf, found)

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
