"""Linear least squares of rows that come in pieces, in little memory.

The triangular factor R of [1 | x] = Q R, of a table x with many rows, keeps all that fits of its
columns with an intercept need. Blocks of rows are reduced one by one, each together with the factor
of those before. As blocks are counted from the first row on, the result does not depend on the
pieces, to the bit. It is as accurate as a decomposition of the whole table, which normal equations
are not.

Source: J. Demmel, L. Grigori, M. Hoemmen, J. Langou, Communication-optimal parallel and sequential
QR and LU factorizations, SIAM J. Sci. Comput. 34(1), 2012 (sequential TSQR).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import cast, final

import numpy as np

from cosim.predict.facts import Array

#: Rows that are reduced at once: so few that no linear algebra divides them among processors.
BLOCK = 1 << 10


@final
class Blocks:
    """Columns, whose first axis is the rows, that come in pieces, cut anew every `size` rows."""

    def __init__(self, size: int) -> None:
        self._size, self._held, self._count = size, list[tuple[Array, ...]](), 0

    def add(self, *columns: Array) -> Iterator[tuple[Array, ...]]:
        """Take the next rows, (n, k) each, and give the blocks that they complete."""
        start, rows = 0, len(columns[0])
        while self._count + rows - start >= self._size:
            end = start + self._size - self._count
            self._held.append(tuple(x[start:end] for x in columns))
            yield self._joined()
            self._held, self._count, start = [], 0, end
        if start < rows:  # copied, as the memory is that of a whole piece
            self._held.append(tuple(x[start:].copy() for x in columns))
            self._count += rows - start

    def rest(self) -> Iterator[tuple[Array, ...]]:
        """The last block, (n, k) each with n < `size`, if there is one."""
        if self._held:
            yield self._joined()

    def _joined(self) -> tuple[Array, ...]:
        if len(self._held) == 1:
            return self._held[0]
        return tuple(np.concatenate(parts) for parts in zip(*self._held, strict=True))


@final
class RunningFactor:
    """The triangular factors of `tables` tables with the same number of rows, `count`.

    `columns`: how many each has.
    """

    def __init__(self, tables: int, columns: int) -> None:
        self.count = 0
        self._blocks = Blocks(BLOCK)
        self._R: Array = np.zeros((tables, 0, 1 + columns))

    def add(self, x: Array) -> None:
        """Take the next rows of each table, (n, tables, columns)."""
        self.count += len(x)
        for (block,) in self._blocks.add(x):
            self._R = self._with(block)

    @property
    def centred(self) -> Array:
        """S (tables, columns, columns), upper triangular: SᵀS = Σ (x - mean)ᵀ (x - mean)."""
        R = self._R
        for (block,) in self._blocks.rest():
            R = self._with(block)
        k = R.shape[2]
        return np.pad(R, ((0, 0), (0, k - R.shape[1]), (0, 0)))[:, 1:, 1:]

    def _with(self, block: Array) -> Array:
        """R of the rows so far and of a block, (n, tables, columns)."""
        rows = np.moveaxis(block, 0, 1)
        rows = np.concatenate((np.ones((*rows.shape[:2], 1)), rows), axis=2)
        return cast("Array", np.linalg.qr(np.concatenate((self._R, rows), axis=1), mode="r"))


@final
class RunningLine:
    """The line y = a + b t by least squares through points that come in pieces."""

    def __init__(self) -> None:
        self._factor = RunningFactor(1, 2)

    def add(self, t: Array, y: Array) -> None:
        """Take the next points, (n,) each."""
        self._factor.add(np.column_stack((t, y))[:, None])

    @property
    def slope(self) -> float:
        """b, in the unit of y over that of t; at least two different times were added."""
        S = self._factor.centred[0]
        return float(S[0, 1] / S[0, 0])
