"""Fewer points for the same picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def thin(y: NDArray[np.float64], most: int = 4000) -> NDArray[np.intp]:
    """Indices, ascending, of at most `most` (≥ 4) of the n samples that keep every extreme.

    The samples are cut into equal stretches; the first smallest and the first largest of each
    stay, and the first and last sample of all. A stretch with a NaN keeps one, so that gaps stay
    gaps. `y`: (n,).
    """
    n = len(y)
    if n <= most:
        return np.arange(n)
    count = (most - 2) // 2
    edges = np.linspace(0, n, count + 1).astype(np.intp)
    width = int(np.diff(edges).max())
    # one row a stretch; short stretches repeat their last sample
    index = np.minimum(edges[:-1, None] + np.arange(width), edges[1:, None] - 1)
    rows, values = np.arange(count), y[index]
    low, high = index[rows, values.argmin(axis=1)], index[rows, values.argmax(axis=1)]
    return np.unique(np.concatenate(([0], low, high, [n - 1])))
