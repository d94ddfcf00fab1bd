"""Extremes over windows of rows, in time that hardly depends on the windows.

Windows are pairs of first and last row; an empty one has its last row before its first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = NDArray[np.intp]


def extremes(x: Array, first: Rows, last: Rows, combine: np.ufunc, empty: float) -> Array:
    """The extreme of `x` (n,) over each window, in its unit; `empty` where a window is.

    Extremes of 1, 2, 4, … rows are made from each other; each window is two of the largest of them
    that it contains: O(n log w), w its length.
    """
    found = np.full(len(first), empty)
    if not len(x):
        return found
    length = last - first + 1
    level = np.frexp(np.maximum(length, 1))[1] - 1  # floor(log2(length))
    level[length < 1] = -1
    counts = np.bincount(level + 1)[1:]
    size = 1
    for j, count in enumerate(counts):
        if count:
            at = np.flatnonzero(level == j)
            found[at] = combine(x[first[at]], x[last[at] - size + 1])
        if len(x) > size:
            x = combine(x[:-size], x[size:])
        size *= 2
    return found


def last_at(t: Array, times: Array) -> Rows:
    """The last row whose time is at most each of `times` (m,), both ascending; -1: none is.

    For m rows of equal steps it is as far from each row as from the first one; others are searched.
    """
    n = len(t)
    shift = int(np.searchsorted(t, times[0], side="right")) - 1
    found = np.minimum(np.arange(len(times)) + shift, n - 1)
    wrong = t[found] > times
    wrong |= (t[np.minimum(found + 1, n - 1)] <= times) & (found < n - 1)
    searched = np.flatnonzero(wrong)
    found[searched] = np.searchsorted(t, times[searched], side="right") - 1
    return found


def until(left: Array, right: Array, behind: float = -np.inf) -> Array:
    """u_k = max(right_k, min(left_k, u_{k+1})), u = `behind` behind the end; (n,), one unit.

    The map from u_{k+1} to u_k clips to [low, high], and so do compositions of such maps, which are
    made of 1, 2, 4, … rows.
    """
    low, high = right.copy(), np.maximum(left, right)
    size = 1
    while size < len(low):
        a, b = low[:-size].copy(), high[:-size].copy()
        low[:-size] = np.maximum(a, np.minimum(b, low[size:]))
        high[:-size] = np.maximum(a, np.minimum(b, high[size:]))
        size *= 2
    return low if behind == -np.inf else np.maximum(low, np.minimum(high, behind))
