"""Measures of a run: settle times, norms, manipulability and rates."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, log, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cosim.measure.manipulability import manipulability as observed
from cosim.measure.metrics import settle_time
from cosim.record import Run

Array = NDArray[np.float64]


def time_to_target(
    run: Run, names: Sequence[str], target: ArrayLike | str, band: float = 0.05
) -> float:
    """Last exit from the band, s: from then on every entry is within `band` of `target`.

    `target`: scalar, (m,) with one value an entry, or the name of a signal. `band` has the unit of
    the signals. inf if the last row is outside.
    """
    aim = run.array(target) if isinstance(target, str) else np.asarray(target, dtype=np.float64)
    error = np.max([np.abs(run.array(name) - aim).max(axis=1) for name in names], axis=0)
    return settle_time(error, run.t, band)


def spread(run: Run, names: Sequence[str]) -> Array:
    """Return the consensus error max over i, j and joints of |q_i - q_j| in each row, (n,), rad."""
    stacked = np.stack([run.array(name) for name in names])
    return np.asarray((stacked.max(axis=0) - stacked.min(axis=0)).max(axis=1))


def time_to_agreement(run: Run, names: Sequence[str], band: float = 0.05) -> float:
    """Last exit of the consensus error from the band, s; inf if it is outside at the end."""
    return settle_time(spread(run, names), run.t, band)


def norm(run: Run, name: str) -> float:
    """‖x‖₂ = sqrt(∫ |x|² dt) over the run, by trapezoids, in the unit of the signal times √s."""
    return sqrt(integral((run.array(name) ** 2).sum(axis=1), run.t)[-1])


def integral(y: Array, t: Array) -> Array:
    """∫ y dt from the first row to each, by trapezoids, (n,); `y` (n,), `t` (n,) s."""
    steps = np.diff(t) * (y[1:] + y[:-1]) / 2
    return np.concatenate(([0.0], np.cumsum(steps)))


def length(x: ArrayLike) -> float:
    """Euclidean norm |x| of a vector (m,), in its unit."""
    return float(np.linalg.norm(np.asarray(x)))


def final(run: Run, name: str) -> Array:
    """The last row of a signal, (m,)."""
    return np.array(run.array(name)[-1])


def at(run: Run, name: str, t: float) -> Array:
    """A signal at the recorded row nearest to `t` (s), (m,)."""
    return np.array(run.array(name)[row(run, t)])


def largest_error(found: ArrayLike, expected: ArrayLike) -> float:
    """The largest |found - expected| of the entries, in their unit; both scalar or (m,)."""
    return float(np.abs(np.asarray(found) - np.asarray(expected)).max())


def peak(run: Run, names: Sequence[str]) -> float:
    """Largest |x_i(t)| over entries and time, in the unit of the signals."""
    return max(float(np.abs(run.array(name)).max()) for name in names)


def manipulability(run: Run, force: str, response: Sequence[str]) -> Array:
    """Return M^t = ‖y‖₂ / ‖f‖₂ over [0, t], (n,), rad/(N.m).

    y is the mean of `response` minus its first value. NaN as long as the force is zero.
    """
    y = np.mean([run.array(name) for name in response], axis=0)
    return observed(run.t, run.array(force), y)


def growth(run: Run, force: str, response: Sequence[str], start: float, stop: float) -> float:
    """Slope d log M^t / d log t between two times (s): 1 and 1/2 are unbounded, 0 is finite."""
    M = manipulability(run, force, response)
    return log(M[row(run, stop)] / M[row(run, start)]) / log(stop / start)


def row(run: Run, t: float) -> int:
    """The row nearest to `t` (s)."""
    return int(np.abs(run.t - t).argmin())


def velocity(run: Run, name: str, window: float) -> Array:
    """Mean rate of a signal over the last `window` s, (m,)."""
    x, start = run.array(name), row(run, run.t[-1] - window)
    return np.asarray((x[-1] - x[start]) / (run.t[-1] - run.t[start]))


def decay(run: Run, name: str, target: float, start: float, stop: float) -> float:
    """Rate of exp(rate t) that |x - target| follows between two times (s), least squares, 1/s."""
    rows = slice(row(run, start), row(run, stop))
    error = np.abs(run.array(name)[rows, 0] - target)
    return float(np.polyfit(run.t[rows], np.log(error), 1)[0])


def oscillation_growth(run: Run, name: str, target: ArrayLike) -> float:
    """The growth rate of an oscillation about `target`, 1/s; `target` scalar or (m,).

    The logarithm of the ratio of the RMS values of the last and of the third quarter, divided by
    the length of a quarter.
    """
    x = run.array(name) - np.asarray(target)
    n = len(x) // 4
    before, after = (sqrt(float((part**2).mean())) for part in (x[2 * n : 3 * n], x[3 * n :]))
    return log(after / before) / (run.t[-1] / 4) if before > 0 else -inf


def largest_rise(values: Array) -> float:
    """Largest rise from any row to a later one, as a share of the first value; `values` (n,)."""
    return float((values - np.minimum.accumulate(values)).max() / values[0])
