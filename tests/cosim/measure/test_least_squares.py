"""Least squares of rows in pieces, against certified values and whole tables."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.measure import least_squares
from cosim.measure.least_squares import RunningFactor, RunningLine

#: Data set Longley of the Statistical Reference Datasets of the NIST: x_1 to x_6, and y.
LONGLEY = """
83.0 234289 2356 1590 107608 1947 60323
88.5 259426 2325 1456 108632 1948 61122
88.2 258054 3682 1616 109773 1949 60171
89.5 284599 3351 1650 110929 1950 61187
96.2 328975 2099 3099 112075 1951 63221
98.1 346999 1932 3594 113270 1952 63639
99.0 365385 1870 3547 115094 1953 64989
100.0 363112 3578 3350 116219 1954 63761
101.2 397469 2904 3048 117388 1955 66019
104.6 419180 2822 2857 118734 1956 67857
108.4 442769 2936 2798 120445 1957 68169
110.8 444546 4681 2637 121950 1958 66513
112.6 482704 3813 2552 123366 1959 68655
114.2 502601 3931 2514 125368 1960 69564
115.7 518173 4806 2572 127852 1961 69331
116.9 554894 4007 2827 130081 1962 70551
"""
#: Its certified coefficients of x_1 to x_6, and the certified standard deviation of what is left.
COEFFICIENTS = (
    15.0618722713733,
    -0.0358191792925910,
    -2.02022980381683,
    -1.03322686717359,
    -0.0511041056535807,
    1829.15146461355,
)
DEVIATION = 304.854073561965


@pytest.mark.parametrize("block", [1, 5, 100])
def test_the_certified_values_of_a_hard_data_set(
    block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(least_squares, "BLOCK", block)
    factor = RunningFactor(1, 7)
    for row in LONGLEY.split("\n")[1:-1]:
        factor.add(np.array(row.split(), dtype=float)[None, None])
    (S,) = factor.centred
    assert np.linalg.solve(S[:6, :6], S[:6, 6]) == pytest.approx(COEFFICIENTS, rel=1e-9)
    assert abs(S[6, 6]) / np.sqrt(factor.count - 7) == pytest.approx(DEVIATION, rel=1e-11)


def test_a_line_far_from_zero_has_its_slope() -> None:
    """Two days after the start, seven minutes of a decay of 1/128 1/s: exact numbers."""
    line = RunningLine()
    t = 172_800.0 + np.arange(27_000) / 64
    for piece in np.array_split(t, 7):
        line.add(piece, 3.0 - piece / 128)
    assert line.slope == pytest.approx(-1 / 128, rel=1e-12)


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.integers(1, 900), min_size=1, max_size=12), st.integers(0, 4000), st.integers(0, 9)
)
def test_a_factor_does_not_depend_on_pieces(sizes: list[int], rows: int, seed: int) -> None:
    x = np.random.default_rng(seed).normal(size=(rows, 2, 3)) + 30.0
    whole, parts = RunningFactor(2, 3), RunningFactor(2, 3)
    whole.add(x)
    for piece in np.split(x, np.cumsum(sizes)):
        parts.add(piece)
        parts.centred  # noqa: B018 - a look changes nothing
    S = parts.centred
    assert parts.count == rows and S.tolist() == whole.centred.tolist()
    y = x - x.mean(axis=0) if rows else x
    expected = np.einsum("nti,ntj->tij", y, y)
    assert np.einsum("tki,tkj->tij", S, S) == pytest.approx(expected, rel=1e-9, abs=1e-9)
