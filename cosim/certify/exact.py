"""Matrices of rational numbers: integers over one denominator, so that no operation rounds.

Every double is a rational number, a whole number times a power of two. Sums and products of such
matrices, and the decision that one is positive definite, need whole numbers only.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import gcd, lcm

#: Bits of the shorter integers that decide, first fewer.
_BITS = (36, 96)
Rows = tuple[tuple[int, ...], ...]
Rationals = Iterable[Iterable[float | int | Fraction]]


@dataclass(frozen=True, slots=True)
class Exact:
    """A matrix of rational numbers, `rows` of integers over the denominator `over` > 0.

    `width` is the number of columns, which a matrix without rows has as well.
    """

    rows: Rows
    over: int
    width: int

    @staticmethod
    def of(numbers: Rationals, width: int | None = None) -> Exact:
        """The matrix of these numbers; a double stands for the rational number that it is.

        Raises ValueError or OverflowError for a number that is not finite.
        """
        found = [[Fraction(x) for x in row] for row in numbers]
        over = lcm(*(x.denominator for row in found for x in row))
        rows = tuple(tuple(x.numerator * (over // x.denominator) for x in row) for row in found)
        return Exact(rows, over, len(rows[0]) if width is None else width)

    @staticmethod
    def zeros(n: int, m: int) -> Exact:
        """0, (n, m)."""
        return Exact(((0,) * m,) * n, 1, m)

    @staticmethod
    def eye(n: int) -> Exact:
        """The identity, (n, n)."""
        return Exact(tuple(tuple(int(i == j) for j in range(n)) for i in range(n)), 1, n)

    def __len__(self) -> int:
        return len(self.rows)

    def __add__(self, other: Exact) -> Exact:
        over = lcm(self.over, other.over)
        a, b = over // self.over, over // other.over
        pairs = zip(self.rows, other.rows, strict=True)
        rows = tuple(tuple(a * x + b * y for x, y in zip(p, q, strict=True)) for p, q in pairs)
        return Exact(rows, over, self.width)

    def __neg__(self) -> Exact:
        return self.times(-1)

    def __sub__(self, other: Exact) -> Exact:
        return self + -other

    def __matmul__(self, other: Exact) -> Exact:
        if self.width != len(other):
            raise ValueError(f"({len(self)}, {self.width}) @ ({len(other)}, {other.width})")
        columns = [[(k, x) for k, x in enumerate(c) if x] for c in other.T.rows]
        rows = tuple(tuple(sum(row[k] * x for k, x in c) for c in columns) for row in self.rows)
        return Exact(rows, self.over * other.over, other.width).lowest()

    @property
    def T(self) -> Exact:
        """The transpose."""
        rows = tuple(zip(*self.rows, strict=True)) if self.rows else ((),) * self.width
        return Exact(rows, self.over, len(self.rows))

    def times(self, factor: Fraction | int) -> Exact:
        """The matrix times a number."""
        p, q = Fraction(factor).as_integer_ratio()
        rows = tuple(tuple(p * x for x in row) for row in self.rows)
        return Exact(rows, q * self.over, self.width)

    def lowest(self) -> Exact:
        """The same matrix with the least denominator."""
        common = gcd(self.over, *(x for row in self.rows for x in row))
        rows = tuple(tuple(x // common for x in row) for row in self.rows)
        return Exact(rows, self.over // common, self.width)

    def take(self, rows: Sequence[int], columns: Sequence[int] | None = None) -> Exact:
        """The matrix of some rows and columns."""
        chosen = range(self.width) if columns is None else columns
        found = tuple(tuple(self.rows[i][j] for j in chosen) for i in rows)
        return Exact(found, self.over, len(chosen))

    def at(self, i: int, j: int) -> Fraction:
        """An entry."""
        return Fraction(self.rows[i][j], self.over)

    def greatest(self) -> Fraction:
        """The greatest absolute value of an entry; 0 of an empty matrix."""
        return Fraction(max((abs(x) for row in self.rows for x in row), default=0), self.over)

    def floats(self) -> list[list[float]]:
        """The nearest doubles, in the unit of the matrix."""
        return [[x / self.over for x in row] for row in self.rows]


def beside(*parts: Exact) -> Exact:
    """Matrices with the same number of rows, side by side."""
    over = lcm(*(p.over for p in parts))
    scaled = [p.times(over // p.over) for p in parts]
    rows = tuple(tuple(x for p in scaled for x in p.rows[i]) for i in range(len(parts[0])))
    return Exact(rows, over, sum(p.width for p in parts))


def above(*parts: Exact) -> Exact:
    """Matrices with the same number of columns, one above the other."""
    return beside(*(p.T for p in parts)).T


def positive_definite(matrix: Exact) -> bool:
    """True only if a symmetric matrix is positive definite, decided in integers.

    Of a matrix M of long integers a shorter one below it decides: D M D, with powers of two in the
    diagonal matrix D, is rounded down to integers N. The two differ by less than 1 an entry, so
    that D M D - (N - n I) is positive semidefinite. False also of a matrix that is nearer than
    n 2^-96 to one that is not positive definite, once its diagonal is scaled to 1.
    """
    rows = matrix.rows
    if matrix.width != len(matrix) or rows != matrix.T.rows:
        return False
    if any(row[i] <= 0 for i, row in enumerate(rows)):
        return False
    return any(_minors(_shorter(rows, bits)) for bits in _BITS)


def _shorter(rows: Rows, bits: int) -> Rows:
    """N - n I of a matrix (n, n) of integers, N of about `bits` bits, an even number."""
    half = [row[i].bit_length() // 2 for i, row in enumerate(rows)]
    n = len(rows)
    return tuple(
        tuple((x << bits >> (half[i] + half[j])) - n * (i == j) for j, x in enumerate(row))
        for i, row in enumerate(rows)
    )


def _minors(rows: Rows) -> bool:
    """True if all leading principal minors of a symmetric matrix are positive (Sylvester).

    Bareiss' elimination keeps to integers: after step k the pivot is the minor of order k + 1, and
    each division is exact (E. H. Bareiss, Math. Comp. 22, 1968).
    """
    m, last = [list(row) for row in rows], 1
    for k in range(len(m)):
        pivot, top = m[k][k], m[k]
        if pivot <= 0:
            return False
        for i in range(k + 1, len(m)):
            row, factor = m[i], top[i]  # symmetric: only the upper triangle is kept
            for j in range(i, len(m)):
                row[j] = (pivot * row[j] - factor * top[j]) // last
        last = pivot
    return True
