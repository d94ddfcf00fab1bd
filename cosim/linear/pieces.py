"""Pieces of a matrix: rows and columns that no other rows and columns are connected with.

The rows of a loop are mostly samples on their way, each of which is a piece of its own; what is
computed of the rest takes small matrices.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cosim.linear.component import Matrix

Index = NDArray[np.intp]


def pieces(rows: Matrix, of: NDArray[np.bool_]) -> Iterator[tuple[Index, Index]]:
    """Rows and columns of each piece of `rows` (n, m) with one of the rows in `of` (n,)."""
    i, j = np.nonzero(rows)
    label = np.arange(rows.shape[1])  # of each column: the least column of its piece
    of_row = np.full(len(rows), rows.shape[1])
    while True:
        np.minimum.at(of_row, i, label[j])
        found = label.copy()
        np.minimum.at(found, j, of_row[i])
        if (found == label).all():
            break
        label = found
    for one in sorted(set(of_row[of & (of_row < rows.shape[1])].tolist())):
        yield np.flatnonzero(of_row == one), np.flatnonzero(label == one)
