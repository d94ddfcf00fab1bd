"""Quantiles as NumPy computes them, without what NumPy imports for them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def quantiles(values: Array, shares: Array) -> Array:
    """``np.quantile(values, shares)`` to the bit: of finite `values` (n,), n > 0, at `shares` (m,)
    from 0 to 1, (m,).

    NumPy imports ``numpy.ma`` for it, which takes as long as a whole check of a scenario.
    """
    place = shares * (len(values) - 1)
    ordered, low = np.sort(values), place.astype(np.intp)
    below, above = ordered[low], ordered[np.minimum(low + 1, len(values) - 1)]
    t, step = place - low, above - below
    return np.where(t < 0.5, below + step * t, above - step * (1 - t))
