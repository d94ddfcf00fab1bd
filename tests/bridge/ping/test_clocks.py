"""The estimator of clocks against known truth, in 100 random cases."""

from dataclasses import dataclass

import numpy as np
import pytest

from bridge.ping.clocks import ClockEstimate, Floats, estimate_clock


def _queue(rng: np.random.Generator, n: int) -> Floats:
    """Seconds in queues: exponential, with bursts of correlated delay."""
    wait = rng.exponential(rng.choice([1e-4, 1e-3, 2e-2]), n)
    for start in rng.integers(0, n, n // 100):
        wait[start : start + 8] += rng.uniform(0.01, 0.2) * np.linspace(
            1, 0, wait[start : start + 8].size
        )
    return wait


@dataclass
class SyntheticExchange:
    """An estimate and the truth at the times t1 (n,), s; `least`: delay there and back, s."""

    found: ClockEstimate
    t1: Floats
    theta: Floats
    gamma: float
    least: Floats


def _case(seed: int, *, symmetric: bool = False, step: float = 0.0) -> SyntheticExchange:
    """`step`: jump of the other clock half way, s."""
    rng = np.random.default_rng(seed)
    n, period = int(rng.integers(50, 1000)), float(rng.choice([0.002, 0.01, 0.1]))
    theta0, gamma = rng.uniform(-1e5, 1e5), float(rng.uniform(-1e-4, 1e-4))
    least = rng.uniform(1e-4, 0.3, 2)
    least[1] = least[0] if symmetric else least[1]
    t1 = np.arange(n) * period + rng.uniform(0, 0.9, n) * period
    t2 = t1 + least[0] + _queue(rng, n)
    t3 = t2 + rng.exponential(1e-4, n)
    t4 = t3 + least[1] + _queue(rng, n)

    def theta(t: Floats) -> Floats:
        return np.asarray(theta0 + gamma * t + step * (t > t1[n // 2]))

    heard = rng.random(n) > rng.choice([0, 0.01, 0.3])
    heard[n // 3 : n // 3 + n // 10] = False  # an outage
    F, B = t2 + theta(t2) - t1, t4 - (t3 + theta(t3))
    found = estimate_clock(t1[heard], F[heard], t4[heard], B[heard])
    return SyntheticExchange(found, t1, theta(t1), gamma, least)


@pytest.mark.parametrize("seed", range(100))
def test_the_truth_is_within_the_stated_bounds(seed: int) -> None:
    case = _case(seed)
    low, middle, high = case.found.offsets(case.t1)
    rounding = 1e-9
    assert np.all(low - rounding <= case.theta) and np.all(case.theta <= high + rounding)
    assert np.all(low - rounding <= middle) and np.all(middle <= high + rounding)
    slowest, _, fastest = case.found.drift
    assert slowest - 1e-12 <= case.gamma <= fastest + 1e-12
    assert not case.found.steps


@pytest.mark.parametrize("seed", range(10))
def test_bounds_are_as_narrow_as_the_fastest_packets_allow(seed: int) -> None:
    """An interval of the length of the fastest round trip, where the lines are closest."""
    case = _case(seed)
    low, _, high = case.found.offsets(case.t1)
    assert case.least.sum() <= np.min(high - low) <= 1.05 * case.least.sum() + 0.1


@pytest.mark.parametrize("seed", range(10))
def test_a_symmetric_path_is_estimated_far_better_than_it_is_bounded(seed: int) -> None:
    case = _case(seed, symmetric=True)
    low, middle, high = case.found.offsets(case.t1)
    at = case.t1.size // 2
    assert abs(middle[at] - case.theta[at]) < 0.02 * (high[at] - low[at]) + 2e-3


def test_a_clock_that_jumps_is_cut_at_the_jump() -> None:
    case = _case(1, step=5.0)
    low, _, high = case.found.offsets(case.t1)
    far = np.abs(case.t1 - case.t1[case.t1.size // 2]) > 0.7
    assert case.found.steps
    assert np.all((low <= case.theta + 1e-9)[far]) and np.all((case.theta <= high + 1e-9)[far])


def test_an_interval_from_elsewhere_narrows_the_bounds() -> None:
    t = np.arange(10.0)
    found = estimate_clock(t, np.full(10, 0.3), t + 0.6, np.full(10, 0.3), known=(0.1, 0.12))
    low, middle, high = found.offsets(t)
    assert (low.min(), middle[5], high.max()) == (0.1, 0.1, 0.12)


def test_drift_is_found_to_a_part_in_a_million() -> None:
    rng = np.random.default_rng(3)
    t = np.arange(6000) * 0.01
    there, back = rng.exponential(1e-3, (2, 6000)) + 1e-3
    F, B = there + 2e-5 * t, back - 2e-5 * t
    slowest, drift, fastest = estimate_clock(t, F, t + there + back, B).drift
    assert slowest < 2e-5 < fastest and drift == pytest.approx(2e-5, abs=1e-6)
