"""Intervals of quantiles of delays that depend on each other.

At a threshold x the share F(x) of delays below it is a mean of zeros and ones. If they depend on
each other, its variance is r(x) times F (1 - F) / n, as if there were only n / r(x) independent
delays. The means of batches show r: a batch longer than a queue, an episode of congestion or the
stay on one of two routes has what depends on each other inside. How long that is, is not known; so
batches of 1, 2, 4 ... delays are taken, down to :data:`BATCHES` of them, and of all the largest r,
increased by Student's t for their number. The interval of a quantile q has the thresholds at which
|F(x) - q| <= 1.96 sqrt(q (1 - q) r(x) / n); r is taken where the interval ends, since the slow
part of a mixture is often above the quantile.

Source: C. Alexopoulos and A. Seila, "Output data analysis", in Handbook of Simulation, 1998, for
batch means; the largest of several lengths and the search for the end: own construction.
"""

from __future__ import annotations

from math import inf

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Fewest batches, and most of them (what is shorter cannot show more).
BATCHES, FINEST = 8, 1 << 16
#: Fewer independent delays than this give no interval.
FEWEST = 20
_NORMAL = 1.959964
#: Distances from the quantile, in its logit, at which dependence is looked for.
_DISTANCES = (0.0, 0.1, 0.2, 0.4, 0.7, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0)


def interval(delay: Floats, ordered: Floats, q: float) -> tuple[float, float, float]:
    """The interval that contains the quantile `q` with 95 % confidence, and how many independent
    delays would tell as much about it. `delay` (n,), s, in the order of time; `ordered`: sorted.

    An end is infinite where too few independent delays are beyond it.
    """
    low, first = _end(delay, ordered, q, -1)
    high, second = _end(delay, ordered, q, 1)
    return low, high, min(first, second)


def _end(delay: Floats, ordered: Floats, q: float, sign: int) -> tuple[float, float]:
    """The lower (`sign` -1) or upper end of an interval, and the number of independent delays."""
    n, inflation = delay.size, 1.0
    for distance in _DISTANCES:
        p = 1 / (1 + (1 - q) / q * np.exp(-sign * distance))
        row = int(n * p)
        if not 3 <= row < n - 3:
            break
        inflation = max(inflation, dependence(delay <= ordered[row]))
        if abs(p - q) > _spread(q, inflation, n):
            break
    if n / inflation < FEWEST:
        return sign * inf, n / inflation
    spread = _spread(q, inflation, n)
    if sign > 0:
        row = int(np.ceil(n * (q + spread)))
        return float(ordered[row]) if row < n else inf, n / inflation
    row = int(np.floor(n * (q - spread)))
    return float(ordered[row]) if row >= 0 else -inf, n / inflation


def _spread(q: float, inflation: float, n: int) -> float:
    return float(_NORMAL * np.sqrt(q * (1 - q) * inflation / n))


def dependence(below: NDArray[np.bool_]) -> float:
    """The factor by which the variance of the mean of `below` (n,) exceeds that of elements
    independent of each other; dimensionless, at least 1.
    """
    n, share = below.size, float(below.mean())
    if not 0 < share < 1:
        return 1.0
    sums = np.concatenate([[0], np.cumsum(below)])
    found, length = 1.0, 1 << max(0, (n // FINEST).bit_length() - 1)
    while n // length >= BATCHES:
        each = np.diff(sums[::length]) / length
        ratio = length * float(each.var(ddof=1)) / (share * (1 - share))
        found = max(found, ratio * (_student(each.size - 1) / _NORMAL) ** 2)
        length *= 2
    return found


def _student(freedom: int) -> float:
    """97.5 % of Student's t, within 0.3 % from 4 degrees of freedom on (Cornish and Fisher)."""
    z, v = _NORMAL, float(freedom)
    return float(
        z
        + (z**3 + z) / (4 * v)
        + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * v**2)
        + (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * v**3)
    )
