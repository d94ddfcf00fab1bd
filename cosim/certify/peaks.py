"""Peak gains: bounds of the sums of impulse responses, by integers and without a solver.

In the norm of peaks a delay has the gain 1, however it varies and however long it is. With
H_ij >= |D_ij| + sum_k |(C A^k B)_ij| and weights d > 0 with H d < d, what is sent is bounded by
what was sent before times less than 1, and ends at 0 whatever the ages (vector small gain; M.
Dahleh and I. Diaz-Bobillo, Control of Uncertain Systems, 1995, for the gain of a linear system).

The sum up to k is computed with integers over 2^_POINT, rounded down in every step. With P > C'C
and A'PA < rho^2 P, rho < 1, both decided exactly, |x|_P = sqrt(x'Px) bounds the rest: |C_i x| is
below |x|_P and |A x|_P below rho |x|_P, of the response after k and of the rounding errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import isqrt

from cosim.certify.exact import Exact, positive_definite
from cosim.certify.model import OpenParts

#: Binary places of the integers, steps between decisions, and the most steps.
_POINT, _SOME, _MOST = 96, 200, 60_000
_Row = list[tuple[int, int]]


def peaks_hold(parts: OpenParts, P: Exact, rho: Fraction, weights: Sequence[Fraction]) -> bool:
    """True if P (n, n), rho and `weights` (m,) prove that the loop is stable for all ages."""
    A, B, C = parts.A, parts.B, parts.C
    m = B.width
    if not 0 < rho < 1 or len(P) != len(A) or len(weights) != m or min(weights) <= 0:
        return False
    if not positive_definite(P - C.T @ C):
        return False
    if not positive_definite(P.times(rho * rho) - A.T @ P @ A):
        return False
    error = _up(P, 1) / (1 - rho)  # of a state, |.|_P in units of the last place
    direct = [[abs(parts.D.at(i, j)) for j in range(m)] for i in range(len(C))]
    sums = [[0] * m for _ in C.rows]  # of each output and input
    columns = [[(x << _POINT) // B.over for x in column] for column in B.T.rows]
    rows, outputs = _sparse(A), _sparse(C)
    for k in range(1, _MOST + 1):
        for j, x in enumerate(columns):
            for i, row in enumerate(outputs):
                sums[i][j] += abs(sum(f * x[n] for n, f in row)) // C.over + 1
            columns[j] = [sum(f * x[n] for n, f in row) // A.over for row in rows]
        if k % _SOME == 0:
            rest = [(_norm(P, x) + error) / (1 - rho) + k * error for x in columns]
            unit = Fraction(1, 1 << _POINT)
            H = [
                [direct[i][j] + (sums[i][j] + rest[j]) * unit for j in range(m)]
                for i in range(len(C))
            ]
            if all(
                sum(h * d for h, d in zip(row, weights, strict=True)) < weights[own]
                for row, own in zip(H, parts.sources, strict=True)
            ):
                return True
    return False


def _sparse(matrix: Exact) -> list[_Row]:
    """The entries other than 0 of each row."""
    return [[(j, x) for j, x in enumerate(row) if x] for row in matrix.rows]


def _norm(P: Exact, x: Sequence[int]) -> Fraction:
    """sqrt(x' P x), rounded up."""
    whole = sum(a * sum(p * b for p, b in zip(row, x, strict=True))
                for a, row in zip(x, P.rows, strict=True))  # fmt: skip
    return Fraction(isqrt(whole // P.over + 1) + 1)


def _up(P: Exact, size: int) -> Fraction:
    """A bound of |x|_P for |x_i| <= `size`."""
    return Fraction(isqrt(sum(abs(p) for row in P.rows for p in row) * size**2 // P.over + 1) + 1)
