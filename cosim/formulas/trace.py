"""Recorded rows, or a piece of a long run, with the values of formulas on them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf
from typing import Any, Protocol, final

import numpy as np

from cosim.base.convert import Struct
from cosim.formulas import windows
from cosim.formulas.syntax import TimeInterval
from cosim.formulas.terms import Lookup
from cosim.formulas.windows import Array, Rows

#: Times that differ by this share of the mean step are the same.
SAME = 1e-6


@final
class TraceRow(Struct, frozen=True):
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

    def decisive(self, formula: Robust) -> TraceRow | None:
        """The row whose comparison decides that; None where no recorded one does."""
        row = formula.decisive(self, 0)
        return None if row is None or row == self.rows else TraceRow(row, float(self.t[row]))

    def rest(self, formula: Robust, empty: float) -> float:
        """The value of an operator without an end over rows that are not kept; `empty`: of none."""
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
