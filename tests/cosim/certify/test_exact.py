"""Exact matrices, against closed forms and NumPy."""

from __future__ import annotations

from fractions import Fraction
from math import cos, pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.certify.exact import Exact, above, beside, positive_definite

numbers = st.integers(-9, 9)
square = st.integers(1, 4).flatmap(
    lambda n: st.lists(st.lists(numbers, min_size=n, max_size=n), min_size=n, max_size=n)
)


@given(square, square)
def test_operations_are_those_of_matrices(a: list[list[int]], b: list[list[int]]) -> None:
    n = min(len(a), len(b))
    x, y = np.array(a)[:n, :n], np.array(b)[:n, :n]
    third = Fraction(1, 3)
    X, Y = Exact.of(x.tolist()).times(third), Exact.of((y / 8).tolist())
    assert np.allclose((X @ Y).floats(), x @ y / 24)
    assert np.allclose((X + Y).floats(), x / 3 + y / 8)
    assert np.allclose((X - Y.T).floats(), x / 3 - y.T / 8)
    assert np.allclose(beside(X, Y).floats(), np.hstack([x / 3, y / 8]))
    assert np.allclose(above(X, Y).floats(), np.vstack([x / 3, y / 8]))
    assert X.at(0, 0) == Fraction(int(x[0, 0]), 3) and X.greatest() == abs(x).max() * third
    assert (X + X.times(-1)).greatest() == 0 and X.times(3).lowest().over == 1


def test_a_double_is_the_rational_number_that_it_is() -> None:
    assert Exact.of([[0.1]]).at(0, 0) == Fraction(0.1) != Fraction(1, 10)
    with pytest.raises((ValueError, OverflowError)):
        Exact.of([[float("nan")]])


@given(square)
def test_a_gram_matrix_is_positive_definite_unless_it_is_singular(a: list[list[int]]) -> None:
    x = np.array(a, object)
    gram = Exact.of((x @ x.T).tolist())
    assert positive_definite(gram) == (abs(np.linalg.det(np.array(a, float))) > 1e-6)
    assert not positive_definite(-gram)


@pytest.mark.parametrize("n", [1, 2, 5, 12])
def test_the_limit_of_a_chain_is_found_to_the_last_bits(n: int) -> None:
    """Tridiagonal with -1 beside the diagonal a: positive definite iff a > 2 cos(pi/(n + 1))."""
    limit = 2 * cos(pi / (n + 1))
    for a, expected in ((limit + 1e-13, True), (limit - 1e-13, False)):
        chain = [[a if i == j else -float(abs(i - j) == 1) for j in range(n)] for i in range(n)]
        if n > 1 or expected:
            assert positive_definite(Exact.of(chain)) is expected


def test_scales_that_differ_do_not_matter() -> None:
    """Hilbert's matrix, whose condition number is 1e13, with units from 1e-9 to 1e9."""
    n = 10
    units = [Fraction(10) ** (2 * i - 9) for i in range(n)]
    rows = [[units[i] * units[j] / (i + j + 1) for j in range(n)] for i in range(n)]
    assert positive_definite(Exact.of(rows))
    rows[4][4] -= units[4] ** 2 / 10**4
    assert not positive_definite(Exact.of(rows))


def test_what_is_not_symmetric_is_not_positive_definite() -> None:
    assert not positive_definite(Exact.of([[2, 1], [0, 2]]))
    assert not positive_definite(Exact.of([[2, 1]]))
    assert positive_definite(Exact.zeros(0, 0))
