"""Observed manipulability: the response of a robot to a force, and its growth over time.

    M^t = ‖y‖₂ / ‖f‖₂ over [0, t],   y = response - response(0)

A robot is infinitely manipulable if M^t can grow beyond every bound. The rate of growth depends on
the force as well: the slope d log M^t/d log t is 1 under a constant push, 1/2 when the hand has
come to rest without force, and 0 if M^t has a limit. Integrals use the trapezoidal rule.

Source: the paper, Definition 1.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import nan
from typing import TypeAlias, final

import numpy as np

from cosim.predict.facts import Array
from cosim.record.piecewise import AtTimes, RunningIntegral

#: Points a decade of time at which slopes are taken.
_PER_DECADE = 40
#: Times (n,), s, and values (n,) of rows, in pieces that can be iterated over more than once.
Curve: TypeAlias = Iterable[tuple[Array, Array]]


@final
class RunningManipulability:
    """:func:`manipulability` of rows that come in pieces."""

    def __init__(self) -> None:
        self._start: Array | None = None
        self._above, self._below = RunningIntegral(), RunningIntegral()

    def add(self, t: Array, force: Array, response: Array) -> Array:
        """Take the next rows, and return M^t of each, (n,)."""
        if self._start is None:
            self._start = response[0].copy()
        y = response - self._start
        above = self._above.add((y**2).sum(axis=1), t)
        below = self._below.add((force**2).sum(axis=1), t)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.where(below > 0, np.sqrt(above / below), np.nan))


def manipulability(t: Array, force: Array, response: Array) -> Array:
    """M^t, (n,), in units of response over force; NaN as long as no force has acted.

    `t` (n,) s, `force`, `response` (n, m).
    """
    return RunningManipulability().add(t, force, response)


def growth(M: Curve, start: float, stop: float) -> float:
    """Slope d log M/d log t between two times (s), a pure number; NaN without data.

    A least-squares fit over log t.
    """
    times, values = _even(M, start, stop)
    if len(times) < 3:
        return nan
    return float(np.polyfit(np.log(times), np.log(values), 1)[0])


def local_growth(M: Curve, stop: float) -> tuple[Array, Array]:
    """(t, d log M/d log t) for a drawing, both (k,); each slope is over a quarter of a decade.

    `stop`: the end of the run, s. Both results are empty if there are too few rows.
    """
    times, values = _even(M, 0.0, stop)
    reach = _PER_DECADE // 8
    if len(times) <= 2 * reach:
        return np.empty(0), np.empty(0)
    rise = np.log(values[2 * reach :] / values[: -2 * reach])
    return times[reach:-reach], rise / np.log(times[2 * reach :] / times[: -2 * reach])


def _even(M: Curve, start: float, stop: float) -> tuple[Array, Array]:
    """M at times evenly spread over log t, where it is a number above 0."""

    def good(t: Array, values: Array) -> Array:
        found = np.isfinite(values) & (values > 0) & (t > max(start, 0.0) * (1 - 1e-9))
        return np.asarray(found & (t <= stop) & (t > 0))

    count, first, last = 0, nan, nan
    for t, values in M:
        rows = t[good(t, values)]
        if len(rows):
            first, last = (first if count else float(rows[0])), float(rows[-1])
            count += len(rows)
    if count < 3:
        return np.empty(0), np.empty(0)
    times = np.geomspace(first, last, max(4, int(_PER_DECADE * np.log10(last / first))))
    found = AtTimes(np.log(times))
    for t, values in M:
        rows = good(t, values)
        found.add(np.log(t[rows]), np.log(values[rows]))
    return times, np.exp(found.values)
