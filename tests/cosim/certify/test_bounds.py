"""The bounds that the proofs use, against what they bound."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.copies import replace
from cosim.certify.model import LinkBounds
from cosim.certify.nominal import Centre, squared_epsilon, squared_gain, squared_gamma

N = 60


def error_gain(ages: list[int], c: int, sends: int = 1) -> float:
    """The norm of v -> y[k - age] - y[k - c] with y = v summed up, for each k-th of `sends`."""
    total = np.tril(np.ones((N, N)))
    k = np.arange(0, N, sends)
    rows = np.vstack([np.zeros(N), total])  # nothing before the start; c in samples
    held = rows[np.maximum(k - np.array(ages)[: len(k)] + 1, 0)] - rows[np.maximum(k - c + 1, 0)]
    return float(np.linalg.norm(held, 2))


@st.composite
def sequences(draw: st.DrawFn, *, ordered: bool) -> tuple[LinkBounds, list[int], int]:
    least = draw(st.integers(0, 6))
    greatest = least + draw(st.integers(0, 8))
    link = LinkBounds("link", 1, least, greatest, ordered)
    some = draw(st.lists(st.integers(least, greatest), min_size=N, max_size=N))
    stay = draw(st.integers(1, 9))
    ages = [some[k // stay] for k in range(N)]
    if ordered:
        for k in range(1, N):
            ages[k] = min(ages[k], ages[k - 1] + 1)
    return link, ages, draw(st.integers(0, greatest + 2))


@given(sequences(ordered=False))
def test_no_sequence_of_ages_has_a_greater_gain(given: tuple[LinkBounds, list[int], int]) -> None:
    link, ages, c = given
    assert error_gain(ages, c) ** 2 <= float(squared_gamma(link, c)) + 1e-9


@given(sequences(ordered=True))
def test_no_ordered_sequence_has_a_greater_gain(given: tuple[LinkBounds, list[int], int]) -> None:
    link, ages, c = given
    assert error_gain(ages, c) ** 2 <= float(squared_gamma(link, c)) + 1e-9


@given(sequences(ordered=False), st.integers(2, 5))
def test_looks_at_some_of_the_samples(given: tuple[LinkBounds, list[int], int], sends: int) -> None:
    """A receiver that looks once in some samples; of these the lateness is a whole number."""
    link, ages, c = given
    link = replace(link, sends=sends)
    found = error_gain(ages, c * sends, sends)
    assert found**2 <= float(squared_gamma(link, c)) + 1e-9
    k = np.arange(len(ages))
    kept = (np.diff(sends * k - np.array(ages)) >= 0).all()
    if kept:
        assert found**2 <= float(squared_gamma(replace(link, ordered=True), c)) + 1e-9


def test_order_is_needed_for_the_smaller_bound() -> None:
    """Ages 0 and 2 about 1: the bounds are 1 in order, sqrt(2) in any, and a sequence is between.

    Samples that are held twice, in turn from 0 and from 2 steps ago.
    """
    ages = [0 if k % 2 == 0 else 2 for k in range(N)]
    assert squared_gamma(LinkBounds("link", 1, 0, 2, True), 1) == 1
    assert squared_gamma(LinkBounds("link", 1, 0, 2), 1) == 2
    assert 1.4 < error_gain(ages, 1) < 1.4143


def test_a_constant_age_attains_the_bound_in_order() -> None:
    assert error_gain([5] * N, 0) == pytest.approx(5.0, rel=0.01)
    assert squared_gamma(LinkBounds("link", 1, 0, 5), 0) == 25
    assert squared_gamma(LinkBounds("link", 1, 3, 5), 0) == 25
    assert squared_gamma(LinkBounds("link", 1, 3, 5), 7) == 16


@pytest.mark.parametrize(("c", "p"), [(2, 1), (9, 4), (150, 4), (150, 16), (64, 63)])
def test_the_filter_is_a_delay_up_to_its_bound(c: int, p: int) -> None:
    z = np.exp(1j * np.linspace(1e-4, np.pi, 200_001))
    a = float(Centre(c, p).a)
    filtered = ((1 - a * z) / (z - a)) ** p
    worst = float(np.abs((z**-c - filtered) / (1 - 1 / z)).max())
    bound = float(squared_epsilon(Centre(c, p))) ** 0.5
    assert worst <= bound < 1.2 * worst + 1.0
    assert squared_epsilon(Centre(c, c)) == 0


def test_gains_of_both_parts_add() -> None:
    link, centre = LinkBounds("link", 1, 100, 200, True), Centre(150, 8)
    expected = 50.0 + float(squared_epsilon(centre)) ** 0.5
    found = float(squared_gain(link, centre)) ** 0.5
    assert expected <= found < expected * (1 + 1e-6)


@pytest.mark.parametrize("wrong", [(3, 0), (3, 4), (-1, 0)])
def test_a_centre_has_one_to_all_sections(wrong: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="sections"):
        Centre(*wrong)
