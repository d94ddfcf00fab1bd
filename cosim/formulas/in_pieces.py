"""The robustness of a formula on a long run, which is read from its end in pieces.

Most operators look ahead in time, so the values of a formula in a piece need those behind it only:
as far as its intervals reach, or one number where an interval has no end
(:meth:`cosim.formulas.trace.RecordedTrace.earlier`). Memory grows with the intervals within
others, and not with the run. All values are least or greatest ones, so they have the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from math import inf
from typing import TypeAlias, final

import numpy as np

from cosim.formulas import windows
from cosim.formulas.robust import Both, Extreme, HeldInequality, Not, Until
from cosim.formulas.syntax import TimeInterval
from cosim.formulas.terms import Lookup
from cosim.formulas.trace import RecordedTrace, Robust, TraceRow, nodes
from cosim.formulas.windows import Array

#: Pieces with rows from a time on, s, of some signals, the last one first: times (n,) and values.
Pieces: TypeAlias = Callable[[Sequence[str], float], Iterable[tuple[Array, Lookup]]]


@final
class LongTrace:
    """A :class:`cosim.formulas.trace.RecordedTrace` of rows that are read in pieces.

    `rows`: how many there are; `begin`: the time of the first one, s; the rest as there.
    """

    def __init__(
        self,
        pieces: Pieces,
        rows: int,
        begin: float,
        end: float,
        beyond: int | None,
        step: float,
    ) -> None:
        self._pieces, self._rows, self._first = pieces, rows, TraceRow(0, begin)
        self._end, self._beyond, self._step = end, beyond, step
        self._judged: dict[tuple[int, int], tuple[float, tuple[Robust, TraceRow] | None]] = {}

    def at_first(self, formula: Robust) -> float:
        """The robustness of a formula at the first row."""
        return self._judge(formula, self._first)[0]

    def decisive(self, formula: Robust) -> TraceRow | None:
        """The row whose comparison decides it; None where no recorded one does."""
        at = self._first
        while not isinstance(formula, HeldInequality):
            decided = self._judge(formula, at)[1]
            if decided is None:
                return None
            formula, at = decided
        return at if at.number < self._rows else None

    def _judge(self, formula: Robust, at: TraceRow) -> tuple[float, tuple[Robust, TraceRow] | None]:
        """The robustness at a row, with the formula and the row that decide it."""
        key = id(formula), at.number
        if key not in self._judged:
            self._judged[key] = self._over(formula, at)
        return self._judged[key]

    def _over(self, formula: Robust, at: TraceRow) -> tuple[float, tuple[Robust, TraceRow] | None]:
        match formula:
            case Not():
                return -self._judge(formula.of, at)[0], (formula.of, at)
            case Both():
                left, right = (self._judge(part, at)[0] for part in formula.parts)
                first = left >= right if formula.either else left <= right
                return (left, (formula.left, at)) if first else (right, (formula.right, at))
            case Extreme():
                value, row = self._extreme(formula, at)
                return value, None if row is None else (formula.of, row)
            case Until():
                return self._until(formula, at)
        now = Extreme(formula, TimeInterval(0.0, 0.0))
        return self._extreme(now, at)[0], None

    def _extreme(self, formula: Extreme, at: TraceRow) -> tuple[float, TraceRow | None]:
        """The extreme of an interval, and its first row."""
        _, value = formula.combine
        found = None
        for trace, number, rows in self._within((formula.of,), formula.interval, at):
            x = trace.values(formula.of, False)[rows]
            if not len(x):
                continue
            best = int(np.argmax(x) if formula.eventually else np.argmin(x))
            if found is None or (x[best] >= value if formula.eventually else x[best] <= value):
                value, found = float(x[best]), _row(trace, number, rows.start + best)
        return value, found

    def _until(self, formula: Until, at: TraceRow) -> tuple[float, tuple[Robust, TraceRow] | None]:
        """The row that decides is the first one at which `right` has at least the value, or the
        least `left` before it.
        """
        value, first = -inf, None
        for trace, number, rows in self._within(formula.parts, formula.interval, at):
            if rows.start < rows.stop:
                left, right = (trace.values(part, False)[rows] for part in formula.parts)
                value, first = float(windows.until(left, right, value)[0]), number + rows.start
        if first is None:
            return -inf, None
        value = min(value, self._least(formula.left, at, first)[0])
        chosen, there = at, inf
        for trace, number, rows in self._within(formula.parts, formula.interval, at):
            right = trace.values(formula.right, False)[rows]
            enough = np.flatnonzero(right >= value)
            if len(enough):
                there = float(right[enough[0]])
                chosen = _row(trace, number, rows.start + int(enough[0]))
        before, least = self._least(formula.left, at, chosen.number)
        if least is None or there <= before:
            return value, (formula.right, chosen)
        return value, (formula.left, least)

    def _least(self, formula: Robust, at: TraceRow, stop: int) -> tuple[float, TraceRow | None]:
        """The least value of a formula in rows from `at` to before `stop`, and its first row."""
        value, found = inf, None
        for trace, number in self._walk((formula,), at.time) if stop > at.number else ():
            first = max(0, at.number - number)
            x = trace.values(formula, False)[first : min(trace.own.stop, max(0, stop - number))]
            if len(x) and x[best := int(np.argmin(x))] <= value:
                value, found = float(x[best]), _row(trace, number, first + best)
        return value, found

    def _within(
        self, parts: tuple[Robust, ...], interval: TimeInterval, at: TraceRow
    ) -> Iterator[tuple[RecordedTrace, int, slice]]:
        """Traces with the number of their first row, and their rows in an interval; backwards."""
        tail = max(part.tail for part in parts)
        for trace, number in self._walk(parts, at.time):
            rows = trace.within(interval, tail, at.time)
            yield trace, number, slice(max(0, rows.start), rows.stop)
            if rows.start >= 0:
                return

    def _walk(self, parts: tuple[Robust, ...], since: float) -> Iterator[tuple[RecordedTrace, int]]:
        """Traces of the pieces from a time on, s, with the number of the first row; backwards."""
        compared = [x for part in parts for x in nodes(part) if isinstance(x, HeldInequality)]
        names = dict.fromkeys(name for x in compared for name in x.margin.names)
        trace, number = None, self._rows
        for t, lookup in self._pieces(tuple(names), since):
            number -= len(t)
            if trace is None:
                trace = RecordedTrace(t, lookup, self._end, self._beyond, self._step)
            else:
                trace = trace.earlier(t, lookup, parts)
            yield trace, number


def _row(trace: RecordedTrace, number: int, place: int) -> TraceRow:
    """The row at a place of a trace, of which the first one has a number."""
    return TraceRow(number + place, float(trace.t[place]))
