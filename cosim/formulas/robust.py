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
-inf. What is not recorded may have any value: :class:`cosim.formulas.trace.RecordedTrace`.
"""

from __future__ import annotations

from math import inf
from typing import final

import numpy as np

from cosim.base.convert import Struct
from cosim.formulas import windows
from cosim.formulas.syntax import TimeInterval
from cosim.formulas.terms import Term, value
from cosim.formulas.trace import RecordedTrace, Robust
from cosim.formulas.windows import Array

_FIRST = slice(0, 1)


class _AtOnce:
    """A formula that needs its parts at its own time only."""

    __slots__ = ()

    needed = 0.0

    def behind(self, trace: RecordedTrace, row: int) -> float:
        """See :class:`Robust`: nothing."""
        return 0.0


@final
class HeldInequality(_AtOnce, Struct, frozen=True):
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
class Not(_AtOnce, Struct, frozen=True):
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
class Both(_AtOnce, Struct, frozen=True):
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
class Extreme(Struct, frozen=True):
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
        """The function of two values, and the value of none, in the unit of the requirement."""
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
        """See :class:`Robust`; in the unit of the requirement."""
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
class Until(Struct, frozen=True):
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
        """See :class:`Robust`; in the unit of the requirement."""
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
