"""Quantiles are NumPy's to the bit."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.predict.ages import quantiles


@pytest.mark.parametrize("n", [1, 2, 3, 10, 101, 4096])
@pytest.mark.parametrize("digits", [0, 3, 16])  # many of one value, some, none
def test_quantiles_are_those_of_numpy(n: int, digits: int) -> None:
    values = np.round(np.random.default_rng(n).normal(size=n), digits)
    shares = np.concatenate(((np.arange(8) + 0.5) / 8, [0.0, 1.0]))
    np.testing.assert_array_equal(quantiles(values, shares), np.quantile(values, shares))
