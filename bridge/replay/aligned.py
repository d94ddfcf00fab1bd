"""Rows of two runs that belong together, in pieces.

The rows are those of the run with fewer rows in the common time; the other one holds its last value
(:mod:`bridge.replay.diff`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import inf
from typing import final

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import ScenarioError
from cosim.record import Run
from cosim.record.piecewise import PairwiseSum

Array = NDArray[np.float64]
#: Times of rows that are closer than this are one, s.
CLOSE = 1e-9
#: Values of both runs that are compared at once.
VALUES = 1 << 20


@dataclass(frozen=True, slots=True)
class CommonTime:
    """The common time of two runs: `rows` of the `grid` run from `begin` to `end`, s.

    `first`, `last`: the times of its first and last row there; `step`: the longest one of either
    run, s.
    """

    grid: Run
    begin: float
    end: float
    rows: int
    first: float
    last: float
    step: float


def common_time(a: Run, b: Run) -> CommonTime:
    """The common time of two runs. Raises ScenarioError where there is none."""
    if not len(a) or not len(b):
        raise ScenarioError("a run without rows", f"{a.path}, {b.path}")
    spans = a.span, b.span
    begin = max(span[0] for span in spans) - CLOSE
    end = min(span[1] for span in spans) + CLOSE
    found = [_inside(run, begin, end) for run in (a, b)]
    if not min(found)[0]:
        raise ScenarioError("the runs have no time in common", f"{a.path}, {b.path}")
    coarse = 0 if found[0][0] <= found[1][0] else 1
    rows, first, last, _ = found[coarse]
    step = max(found[0][3], found[1][3])
    return CommonTime((a, b)[coarse], begin, end, rows, first, last, step)


def _inside(run: Run, begin: float, end: float) -> tuple[int, float, float, float]:
    """The number of rows between two times, the times of the first and last one, s.

    Last: the longest step of the whole run, s.
    """
    rows, first, last, step, before = 0, inf, -inf, 0.0, np.empty(0)
    for piece in run.pieces(()):
        t = piece.t
        step = max(step, float(np.diff(np.concatenate((before, t))).max(initial=0.0)))
        before = t[-1:].copy()
        inside = t[(t >= begin) & (t <= end)]
        if len(inside):
            rows, first, last = rows + len(inside), min(first, inside[0]), float(inside[-1])
    return rows, float(first), last, step


@final
class _RunAtTimes:
    """A run at ascending times: the values of its last row until each."""

    def __init__(self, run: Run, names: Sequence[str]) -> None:
        self._pieces = run.pieces(names)
        self._t = np.empty(0)
        self._columns: dict[str, Array] = {name: np.empty(0) for name in names}

    def at(self, times: Array) -> dict[str, Array]:
        """The columns at the times (n,), s."""
        while not len(self._t) or self._t[-1] <= times[-1] + CLOSE:
            piece = next(self._pieces, None)
            if piece is None:
                break
            self._t = np.concatenate((self._t, piece.t))
            for name, x in self._columns.items():
                self._columns[name] = np.concatenate((x, piece.column(name)))
        rows = np.searchsorted(self._t, times + CLOSE, side="right") - 1
        found = {name: x[rows] for name, x in self._columns.items()}
        if len(rows):
            self._t = self._t[rows[-1] :]
            self._columns = {name: x[rows[-1] :] for name, x in self._columns.items()}
        return found


Together = tuple[Array, dict[str, Array], dict[str, Array]]


def together(a: Run, b: Run, common: CommonTime, names: Sequence[str]) -> Iterator[Together]:
    """Times (n,), s, and the columns of both runs at these, in pieces."""
    held, most = (
        (_RunAtTimes(a, names), _RunAtTimes(b, names)),
        max(1, VALUES // (1 + 2 * len(names))),
    )
    for piece in common.grid.pieces(()):
        t = piece.t[(piece.t >= common.begin) & (piece.t <= common.end)]
        for at in range(0, len(t), most):
            times = t[at : at + most]
            yield times, held[0].at(times), held[1].at(times)


def rows_within(count: int, span: float, period: float) -> int:
    """Rows in a period, s, of `count` rows that take `span`, s; one at least."""
    return max(1, round(period * (count - 1) / span)) if count > 1 else 1


@final
class Changes:
    """RMS and maximum of what a signal of `count` rows changes by within some `rows`.

    Changes that are not finite are left out; `finite`: how many are not, at most, known from an
    earlier pass.
    """

    def __init__(self, count: int, rows: int, finite: int | None = None) -> None:
        self._rows, self._before = rows, np.empty(0)
        expected = max(0, count - rows) if finite is None else finite
        self._expected, self._squares = expected, PairwiseSum(expected)
        self.finite, self.largest = 0, 0.0

    def add(self, x: Array) -> None:
        """Take the next rows, (n,), in the unit of the signal."""
        x = np.concatenate((self._before, x))
        if len(x) > self._rows:
            changes = np.abs(x[self._rows :] - x[: -self._rows])
            changes = changes[np.isfinite(changes)]
            self.finite += len(changes)
            self.largest = max(self.largest, float(changes.max(initial=0.0)))
            self._squares.add(changes * changes)
        self._before = x[-self._rows :].copy()

    @property
    def complete(self) -> bool:
        """True if as many changes were finite as expected; else another pass has the RMS."""
        return self.finite == self._expected

    @property
    def rms(self) -> float:
        """The RMS, in the unit of the signal."""
        return float(np.sqrt(self._squares.value / self.finite)) if self.finite else 0.0


def row_by_row(a: Run, b: Run, names: Sequence[str]) -> Iterator[dict[str, tuple[Array, Array]]]:
    """The columns (n,) of two runs by the number of the row, in their units, in pieces.

    As many rows as both have.
    """
    left, right = (_columns(run, names) for run in (a, b))
    x, y = next(left, None), next(right, None)
    while x is not None and y is not None:
        n = min(len(x["t"]), len(y["t"]))
        yield {name: (x[name][:n], y[name][:n]) for name in names}
        x, y = ({name: v[n:] for name, v in each.items()} for each in (x, y))
        x = x if len(x["t"]) else next(left, None)
        y = y if len(y["t"]) else next(right, None)


def _columns(run: Run, names: Sequence[str]) -> Iterator[dict[str, Array]]:
    for piece in run.pieces(names):
        yield {"t": piece.t} | {name: piece.column(name) for name in names}
