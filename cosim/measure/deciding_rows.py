"""The rows of a long run that can decide a requirement, found in pieces.

The robustness of ``always`` or ``eventually`` of comparisons is that of one row: the least or the
greatest of an interval. So the least and the greatest of each piece of the run are enough, with the
rows at the ends of pieces and of intervals.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf

import numpy as np

from cosim.formulas.robust import SAME, Both, Extreme, HeldInequality, Not, RecordedTrace, Robust
from cosim.formulas.terms import Lookup
from cosim.formulas.windows import Rows
from cosim.record.piecewise import pieces
from cosim.record.signals import Array, Signals


def deciding_rows(
    formula: Robust, names: Sequence[str], signals: Signals, step: float
) -> tuple[Array, Lookup]:
    """Times (n,), s, and values of the signals `names` at rows which decide a formula.

    All rows where there is one piece only, and for a formula with intervals within intervals.
    `step`: the mean step of all rows, s.
    """
    outer = _outer(formula)
    if outer is None:
        return _all(signals)
    times: list[Array] = []
    values: dict[str, list[Array]] = {name: [] for name in names}
    for piece in pieces(signals, names):
        if piece is signals:
            return _all(signals)
        rows = _rows(outer, piece, float(times[0][0] if times else piece.t[0]), step)
        times.append(piece.t[rows])
        for name, found in values.items():
            found.append(piece.array(name)[rows].T)
    whole = {name: np.concatenate(found, axis=1) for name, found in values.items()}
    return np.concatenate(times), whole.__getitem__


def _all(signals: Signals) -> tuple[Array, Lookup]:
    def lookup(name: str) -> Array:
        return np.asarray(signals.array(name), dtype=np.float64).T

    return np.asarray(signals.t, dtype=np.float64), lookup


def _outer(formula: Robust) -> list[Extreme] | None:
    """The outermost operators with an interval; None where there are others in one."""
    match formula:
        case HeldInequality():
            return []
        case Extreme():
            return [formula] if _outer(formula.of) == [] else None
        case Not():
            return _outer(formula.of)
        case Both():
            left, right = _outer(formula.left), _outer(formula.right)
            return None if left is None or right is None else left + right
    return None


def _rows(outer: Sequence[Extreme], piece: Signals, begin: float, step: float) -> Rows:
    """Indices of the rows of a piece that may decide; `begin` of the run and its `step`, s."""
    t, lookup = _all(piece)
    trace = RecordedTrace(t, lookup, inf, step=step)
    found = {0, len(t) - 1}
    for extreme in outer:
        found |= set(_candidates(extreme, trace, begin, SAME * step if step > 0 else SAME))
    return np.array(sorted(found), np.intp)


def _candidates(extreme: Extreme, trace: RecordedTrace, begin: float, same: float) -> Iterator[int]:
    """The ends of an interval, and the least and the greatest row in it."""
    ends = begin + np.array([extreme.interval.begin, extreme.interval.end]) + same
    first, last = (int(k) for k in np.searchsorted(trace.t, ends, side="right") - 1)
    if last < 0 or begin + extreme.interval.begin > trace.t[-1] + 2.0 * same:
        return
    first = max(first, 0)
    x = trace.values(extreme.of, False)[first : last + 1]
    yield from (first, last, first + int(np.argmin(x)), first + int(np.argmax(x)))
