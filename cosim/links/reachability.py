"""Reachability along the edges of a directed graph."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BoolArray = NDArray[np.bool_]


def closure(edges: BoolArray) -> BoolArray:
    """(n, n): whether a path of any length, also zero, leads from a to b; edges[a, b]: one step."""
    reaches: BoolArray = edges | np.eye(edges.shape[0], dtype=bool)
    for _ in range(edges.shape[0].bit_length()):  # paths twice as long each time
        reaches = (reaches.astype(np.int64) @ reaches.astype(np.int64)) > 0
    return reaches
