"""Determinants of 1 - L for many matrices L with entries at the same places.

Robots of a network are coupled along its edges only. If eliminating in a good order leaves most of
the matrix empty, SciPy's sparse factors take a time that grows little faster than their number.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.linear.pieces import Index

Complex = NDArray[np.complex128]
#: The least rows, and the greatest share of entries in the factors, for which they are sparse.
LEAST, FULL = 64, 0.2
#: The share of the largest entry of a column from which on the diagonal one is its pivot.
_PIVOT = 0.1


class Determinants:
    """det(1 - L) of L (n, n) with entries at `rows` and `columns`, (e,), each place once."""

    def __init__(self, rows: Index, columns: Index, n: int) -> None:
        self._rows, self._columns, self._n = rows, columns, n
        self._matrix: Any = None
        if n >= LEAST and len(rows) < FULL * n * n:
            self._order()

    def _order(self) -> None:
        """Order the rows for sparse factors, unless they fill up or SciPy is not installed."""
        try:
            from scipy.sparse import csc_array
            from scipy.sparse.linalg import splu
        except ImportError:
            return
        n, own = self._n, np.arange(self._n)
        rows, columns = np.append(self._rows, own), np.append(self._columns, own)
        values = np.append(np.full(len(self._rows), 0.5 / n), np.ones(n))
        first = splu(csc_array((values, (rows, columns)), shape=(n, n)),
                     permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})  # fmt: skip
        if first.nnz > FULL * n * n:
            return
        at = first.perm_c[columns] * n + first.perm_c[rows]
        every = np.array(sorted(set(at.tolist())), np.intp)
        places = np.searchsorted(every, at)
        self._places, self._diagonal = places[: len(self._rows)], places[len(self._rows) :]
        starts = np.searchsorted(every, n * np.arange(n + 1))
        self._matrix = csc_array(
            (np.zeros(len(every), np.complex128), every % n, starts), shape=(n, n)
        )

    def logarithms(self, values: Complex) -> Complex:
        """The logarithms, (k,), for entries `values` (k, e); -inf for a determinant of 0."""
        if self._matrix is None:
            M = np.zeros((len(values), self._n, self._n), np.complex128)
            M[:, self._rows, self._columns] = -values
            M[:, np.arange(self._n), np.arange(self._n)] += 1.0
            sign, size = np.linalg.slogdet(M)
            return np.asarray(size + 1j * np.angle(sign))
        entries = np.zeros((len(values), self._matrix.nnz), np.complex128)
        entries[:, self._places] = -values
        entries[:, self._diagonal] += 1.0
        return np.array([self._factored(row) for row in entries], np.complex128)

    def _factored(self, entries: Complex) -> complex:
        from scipy.sparse.linalg import splu

        self._matrix.data = entries
        try:
            factors = splu(self._matrix, permc_spec="NATURAL", diag_pivot_thresh=_PIVOT,
                           options={"SymmetricMode": True})  # fmt: skip
        except RuntimeError:  # exactly singular, or not finite
            return complex(-np.inf if np.isfinite(entries).all() else np.nan, 0.0)
        pivots = factors.U.diagonal()
        sizes = np.abs(pivots)
        sign = np.prod(pivots / sizes) * _parity(factors.perm_r, factors.perm_c)
        return complex(np.log(sizes).sum(), np.angle(sign))


def _parity(rows: NDArray[np.int32], columns: NDArray[np.int32]) -> int:
    """1 if one permutation is made from the other by an even number of swaps, else -1."""
    if np.array_equal(rows, columns):
        return 1
    steps = rows[np.argsort(columns)].tolist()
    parity = 1
    for i in range(len(steps)):
        while (j := steps[i]) != i:
            steps[i], steps[j], parity = steps[j], j, -parity
    return parity
