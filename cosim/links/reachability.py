"""Reachability along the edges of a directed graph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set

import numpy as np
from numpy.typing import NDArray

BoolArray = NDArray[np.bool_]


def reachable(
    start: int, following: Mapping[int, Sequence[int]], beyond: Set[int] = frozenset()
) -> frozenset[int]:
    """All that paths lead to from `start`, itself included, but nothing that is `beyond`.

    `following`: where one step leads from each; the time grows with these.
    """
    found, waiting = {start}, [start]
    while waiting:
        for other in following.get(waiting.pop(), ()):
            if other not in found and other not in beyond:
                found.add(other)
                waiting.append(other)
    return frozenset(found)


def closure(edges: BoolArray) -> BoolArray:
    """(n, n): whether a path of any length, also zero, leads from a to b; edges[a, b]: one step."""
    reaches: BoolArray = edges | np.eye(edges.shape[0], dtype=bool)
    for _ in range(edges.shape[0].bit_length()):  # paths twice as long each time
        reaches = (reaches.astype(np.int64) @ reaches.astype(np.int64)) > 0
    return reaches
