"""Intervals of quantiles contain the truth for delays that depend on each other."""

from collections.abc import Callable

import numpy as np
import pytest

from bridge.ping.figures import way_figures
from bridge.ping.intervals import _student, interval

Floats = np.ndarray
Rng = np.random.Generator
Q = (0.5, 0.95, 0.99)


def independent(n: int, rng: Rng) -> Floats:
    return 0.02 + rng.gamma(2.0, 0.005, n)


def two_levels(n: int, rng: Rng, stay: float = 200.0, step: float = 0.02) -> Floats:
    """Two routes in turn, each for a random time, and little jitter."""
    stays = 1 + rng.exponential(stay, 4 * int(n / stay) + 20).astype(int)
    level = np.repeat(np.arange(stays.size) % 2, stays)
    start = int(rng.integers(0, 4 * stay))
    return 0.02 + step * level[start : start + n] + rng.gamma(2.0, 0.0005, n)


def hidden_levels(n: int, rng: Rng) -> Floats:
    """The same within jitter that is as large: neighbours hardly depend on each other."""
    return two_levels(n, rng, 200.0, 0.005) + rng.gamma(2.0, 0.0035, n)


def congested(n: int, rng: Rng) -> Floats:
    """Episodes of 0.3 s, every 3 s in the mean, in which delays rise and fall."""
    delay, i = 0.02 + rng.gamma(2.0, 0.0005, n), int(rng.exponential(600))
    while i < n:
        d = 1 + int(rng.exponential(60))
        end = min(n, i + d)
        delay[i:end] += rng.exponential(0.03) * np.sin(np.pi * (np.arange(end - i) + 0.5) / d)
        i += d + int(rng.exponential(600))
    return delay


@pytest.mark.parametrize("path", [independent, two_levels, hidden_levels, congested])
def test_intervals_cover_the_truth(path: Callable[[int, Rng], Floats]) -> None:
    """Of 60 measurements of a minute at 200 a second, 95 % of the intervals, within 3 sigma."""
    truth = np.quantile(path(2_000_000, np.random.default_rng(99)), Q)
    inside = np.zeros(len(Q))
    for seed in range(60):
        delay = path(12_000, np.random.default_rng([7, seed]))
        ordered = np.sort(delay)
        for i, q in enumerate(Q):
            low, high, _ = interval(delay, ordered, q)
            inside[i] += low <= truth[i] <= high
    assert np.all(inside >= 52), inside


def test_an_interval_is_no_wider_than_the_delays_need() -> None:
    """Of independent delays: 1.96 standard errors, and at most half as much again."""
    widths = []
    for seed in range(20):
        f = way_figures(independent(12_000, np.random.default_rng(seed)))
        widths.append([float(np.ptp(ends)) for ends in f.ranges[:3]])
    n, q = 12_000, np.array(Q)
    x = np.quantile(independent(2_000_000, np.random.default_rng(99)), Q) - 0.02
    density = x / 0.005**2 * np.exp(-x / 0.005)
    exact = 2 * 1.96 * np.sqrt(q * (1 - q) / n) / density
    found = np.median(widths, axis=0)
    assert np.all(0.9 * exact < found) and np.all(found < 1.5 * exact), found / exact


def test_few_episodes_give_no_interval_and_are_counted() -> None:
    """Ten seconds with two routes of 4 s each: the median lies on either, nobody knows."""
    delay = np.repeat([0.02, 0.04, 0.02], [800, 800, 400])
    f = way_figures(delay + np.random.default_rng(0).gamma(2.0, 0.0005, delay.size))
    assert f.ranges[0] == (-np.inf, np.inf) and f.independent[0] < 20


def test_students_t_is_that_of_tables() -> None:
    for freedom, exact in ((4, 2.7764), (5, 2.5706), (10, 2.2281), (30, 2.0423)):
        assert _student(freedom) == pytest.approx(exact, rel=3e-3)
