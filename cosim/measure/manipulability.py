"""Observed manipulability: the response of a robot to a force, and its growth over time.

    M^t = ‖y‖₂ / ‖f‖₂ over [0, t],   y = response - response(0)

A robot is infinitely manipulable if M^t can grow beyond every bound. The rate of growth depends on
the force as well: the slope d log M^t/d log t is 1 under a constant push, 1/2 when the hand has
come to rest without force, and 0 if M^t has a limit. Integrals use the trapezoidal rule.

Source: the paper, Definition 1.
"""

from __future__ import annotations

import numpy as np

from cosim.predict.facts import Array

#: Points a decade of time at which slopes are taken.
_PER_DECADE = 40


def running_integral(y: Array, t: Array) -> Array:
    """∫ y dt from the first row to each, (n,), by trapezoids; `y`, `t` (n,)."""
    steps = np.diff(t) * (y[1:] + y[:-1]) / 2
    return np.concatenate(([0.0], np.cumsum(steps)))


def manipulability(t: Array, force: Array, response: Array) -> Array:
    """M^t, (n,), in units of response over force; NaN as long as no force has acted.

    `t` (n,) s, `force`, `response` (n, m).
    """
    y = response - response[0]
    above = running_integral((y**2).sum(axis=1), t)
    below = running_integral((force**2).sum(axis=1), t)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(below > 0, np.sqrt(above / below), np.nan))


def growth(t: Array, M: Array, start: float, stop: float) -> float:
    """Slope d log M/d log t between two times (s), a pure number; NaN without data.

    A least-squares fit over log t. `t` (n,) s; `M` (n,).
    """
    times, values = _even(t, M, start, stop)
    if len(times) < 3:
        return float("nan")
    return float(np.polyfit(np.log(times), np.log(values), 1)[0])


def local_growth(t: Array, M: Array) -> tuple[Array, Array]:
    """(t, d log M/d log t) for a drawing, both (k,); each slope is over a quarter of a decade.

    `t` (n,) s; `M` (n,). Both results are empty if there are too few rows.
    """
    times, values = _even(t, M, 0.0, float(t[-1]))
    reach = _PER_DECADE // 8
    if len(times) <= 2 * reach:
        return np.empty(0), np.empty(0)
    rise = np.log(values[2 * reach :] / values[: -2 * reach])
    return times[reach:-reach], rise / np.log(times[2 * reach :] / times[: -2 * reach])


def _even(t: Array, M: Array, start: float, stop: float) -> tuple[Array, Array]:
    """M at times evenly spread over log t, where it is a number above 0."""
    good = np.isfinite(M) & (M > 0) & (t > max(start, 0.0) * (1 - 1e-9)) & (t <= stop)
    good &= t > 0
    if good.sum() < 3:
        return np.empty(0), np.empty(0)
    t, M = t[good], M[good]
    count = max(4, int(_PER_DECADE * np.log10(t[-1] / t[0])))
    times = np.geomspace(t[0], t[-1], count)
    return times, np.exp(np.interp(np.log(times), np.log(t), np.log(M)))
