"""Determinants of many matrices with entries at the same places, against those of NumPy."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest

from cosim.linear.determinants import LEAST, Determinants

N = 2 * LEAST


def places(n: int, chords: int) -> tuple[Any, Any]:
    """Entries of a ring of pairs with some chords, and a few on the diagonal."""
    rng = np.random.default_rng(0)
    i = np.arange(n)
    ends = [(i, (i + k) % n) for k in (1, 2, n - 1)] + [(i[::5], i[::5])]
    ends.append((rng.integers(0, n, chords), rng.integers(0, n, chords)))
    rows, columns = (np.concatenate(part) for part in zip(*ends, strict=True))
    return np.divmod(np.unique(rows * n + columns), n)


def entries(k: int, n: int, size: float) -> Any:
    rng = np.random.default_rng(1)
    return size * (rng.standard_normal((k, n)) + 1j * rng.standard_normal((k, n)))


def by_numpy(rows: Any, columns: Any, n: int, values: Any) -> Any:
    M = np.tile(np.eye(n, dtype=complex), (len(values), 1, 1))
    M[:, rows, columns] -= values
    return np.linalg.slogdet(M)


def agree(found: Any, expected: Any) -> None:
    sign, size = expected
    assert np.allclose(found.real, size, rtol=0, atol=1e-8)
    assert np.allclose(np.exp(1j * found.imag), sign, rtol=0, atol=1e-8)


@pytest.mark.parametrize("size", [0.1, 1.0, 30.0])  # rows have to be swapped for the larger ones
@pytest.mark.parametrize("n", [N, N + 1])
def test_matrices_that_are_almost_empty_have_sparse_factors(
    monkeypatch: pytest.MonkeyPatch, size: float, n: int
) -> None:
    rows, columns = places(n, 4)
    values = entries(12, len(rows), size)
    expected = by_numpy(rows, columns, n, values)
    monkeypatch.setattr(np.linalg, "slogdet", None)
    agree(Determinants(rows, columns, n).logarithms(values), expected)


def test_full_and_small_ones_and_all_without_scipy_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    for rows, columns, n in (
        (*places(N, 20 * N), N),
        (*places(LEAST // 2, 4), LEAST // 2),
        (*places(N, 4), N),
    ):
        monkeypatch.setitem(sys.modules, "scipy.sparse.linalg", None)
        values = entries(3, len(rows), 0.5)
        expected = by_numpy(rows, columns, n, values)
        agree(Determinants(rows, columns, n).logarithms(values), expected)


def test_a_determinant_of_zero_has_no_logarithm() -> None:
    rows, columns = places(N, 0)
    values = entries(2, len(rows), 0.1)
    values[0, rows == 5] = columns[rows == 5] == 5  # row 5 of 1 - L is empty
    log = Determinants(rows, columns, N).logarithms(values)
    assert np.isneginf(log[0].real)
    assert np.isfinite(log[1])
    values[1, 0] = np.nan
    assert not np.isfinite(Determinants(rows, columns, N).logarithms(values[1:])).any()
