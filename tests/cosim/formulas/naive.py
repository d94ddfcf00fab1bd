"""The robustness of a formula by its definition, row by row: slow, and short enough to be read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf

from cosim.formulas.syntax import (
    Arithmetic,
    Formula,
    Inequality,
    Literals,
    Name,
    Temporal,
    TimeInterval,
)


def robustness(
    formula: Formula, t: Sequence[float], x: Mapping[str, Sequence[float]], k: int = 0
) -> float:
    """The robustness at row `k` of signals `x` at the times `t`; comparisons of name and number."""
    if isinstance(formula, Inequality):
        large, small = (_number(side, x, k) for side in (formula.large, formula.small))
        return large - small
    if not isinstance(formula, Temporal):
        of = [robustness(part, t, x, k) for part in formula.of]
        return {
            "not": lambda: -of[0],
            "and": lambda: min(of),
            "or": lambda: max(of),
            "implies": lambda: max(-of[0], of[1]),
        }[formula.word]()
    inner = max(tail(part) for part in formula.of)
    rows = rows_in(formula.interval, t, k, t[-1] - inner)
    if formula.word == "always":
        return min((robustness(formula.of[0], t, x, j) for j in rows), default=inf)
    if formula.word == "eventually":
        return max((robustness(formula.of[0], t, x, j) for j in rows), default=-inf)
    left, right = formula.of
    found = -inf
    for j in rows:
        before = [robustness(left, t, x, i) for i in range(k, j)]
        found = max(found, min([robustness(right, t, x, j), *before]))
    return found


def tail(formula: Formula) -> float:
    """The time behind a row that the formula needs at least."""
    if isinstance(formula, Inequality):
        return 0.0
    inner = max(tail(part) for part in formula.of)
    if not isinstance(formula, Temporal):
        return inner
    interval = formula.interval
    return inner + (interval.begin if interval.end == inf else interval.end)


def rows_in(interval: TimeInterval, t: Sequence[float], k: int, last: float) -> list[int]:
    """The rows whose values hold somewhere in the interval from row `k` on, up to `last`."""
    begin = t[k] + interval.begin
    end = last if interval.end == inf else t[k] + interval.end
    if begin > (last if interval.end == inf else t[-1]):
        return []
    holds_until = [*t[1:], inf]
    return [j for j in range(len(t)) if t[j] <= end and holds_until[j] > begin]


def _number(side: object, x: Mapping[str, Sequence[float]], k: int) -> float:
    if isinstance(side, Name):
        return x[side.text][k]
    if isinstance(side, Arithmetic):  # the sign
        return -_number(side.of[0], x, k)
    assert isinstance(side, Literals)
    return side.values[0]
