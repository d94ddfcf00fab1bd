"""Thinning keeps what the eye would miss."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cosim.reporting.thinning import thin


@given(
    st.lists(st.floats(-1e6, 1e6), max_size=400).map(np.array),
    st.integers(4, 120),
)
def test_extremes_and_ends_stay(y: np.ndarray, most: int) -> None:
    index = thin(y, most)
    assert len(index) <= max(most, 0) or len(y) <= most
    assert (np.diff(index) > 0).all()
    if len(y):
        kept = y[index]
        assert kept.min() == y.min() and kept.max() == y.max()
        assert index[0] == 0 and index[-1] == len(y) - 1


@given(st.integers(0, 99_999), st.sampled_from([-1.0, 1.0]))
def test_a_single_spike_stays(place: int, sign: float) -> None:
    y = np.zeros(100_000)
    y[place] = sign
    index = thin(y)
    assert len(index) <= 4000 and place in index


@given(st.integers(0, 9_999))
def test_a_gap_stays_a_gap(place: int) -> None:
    y = np.sin(np.arange(10_000) / 100)
    y[place] = np.nan
    assert np.isnan(y[thin(y)]).any()


def test_little_stays_as_it_is() -> None:
    assert thin(np.arange(4000.0)).tolist() == list(range(4000))
    assert len(thin(np.empty(0))) == 0
