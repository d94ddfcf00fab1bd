"""Measures of signals with known results."""

from __future__ import annotations

from math import inf, log, pi, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.paper import measure as m


class Signals:
    """Signals by name, over time."""

    def __init__(self, t: np.ndarray, **signals: np.ndarray) -> None:
        self.t = t
        self._signals = {k: v if v.ndim == 2 else v[:, None] for k, v in signals.items()}

    def array(self, name: str) -> np.ndarray:
        return self._signals[name]


T = np.linspace(0.0, 100.0, 20001)


@given(st.floats(0.1, 100.0), st.floats(0.1, 100.0))
def test_an_integrator_grows_with_slope_one_and_a_gain_with_slope_none(f: float, k: float) -> None:
    run = Signals(T, f=np.full_like(T, f), x=k * f * T, y=np.where(T > 0, k * f, 0.0))
    assert m.growth(run, "f", ["x"], 50.0, 100.0) == pytest.approx(1.0, abs=1e-3)
    assert m.growth(run, "f", ["y"], 50.0, 100.0) == pytest.approx(0.0, abs=1e-3)
    assert m.manipulability(run, "f", ["x"])[-1] == pytest.approx(k * 100.0 / sqrt(3), rel=1e-3)


def test_a_hand_that_rests_leaves_slope_one_half() -> None:
    run = Signals(T, f=np.where(T < 1, 1.0, 0.0), x=np.where(T < 1, T, 1.0))
    assert m.growth(run, "f", ["x"], 50.0, 100.0) == pytest.approx(0.5, abs=0.01)


def test_manipulability_is_no_number_before_anything_acts() -> None:
    run = Signals(T, f=np.where(T < 50, 0.0, 1.0), x=T)
    assert np.isnan(m.manipulability(run, "f", ["x"])[0])


@given(st.floats(-3.0, -0.2), st.floats(0.5, 3.0))
def test_decay_finds_the_rate(rate: float, target: float) -> None:
    t = np.linspace(0.0, 10.0, 1001)
    run = Signals(t, x=target + 2.0 * np.exp(rate * t))
    assert m.decay(run, "x", target, 1.0, 5.0) == pytest.approx(rate, rel=1e-6)


@given(st.floats(-0.5, 0.5))
def test_swell_finds_growth_and_decay_of_an_oscillation(rate: float) -> None:
    t = np.linspace(0.0, 8 * pi, 8001)
    run = Signals(t, x=1.0 + np.exp(rate * t) * np.sin(8 * t))
    assert m.oscillation_growth(run, "x", 1.0) == pytest.approx(rate, abs=0.01)


def test_an_oscillation_that_is_not_there_does_not_grow() -> None:
    assert m.oscillation_growth(Signals(T, x=np.ones_like(T)), "x", 1.0) == -inf


def test_settling_agreeing_and_missing() -> None:
    x = np.exp(-T)
    run = Signals(T, x=np.stack([x, -x], axis=1), y=np.zeros((len(T), 2)))
    assert m.time_to_target(run, ["x"], (0.0, 0.0)) == pytest.approx(-log(0.05), abs=0.01)
    assert m.time_to_target(run, ["x", "y"], "y") == m.time_to_target(run, ["x"], (0.0, 0.0))
    assert m.time_to_target(run, ["x"], (1.0, 0.0)) == inf
    assert m.time_to_agreement(run, ["x", "y"]) == pytest.approx(-log(0.05), abs=0.01)
    assert m.spread(run, ["x", "y"])[0] == 1.0
    assert m.largest_error(m.at(run, "x", 0.0), (0.0, 0.0)) == 1.0


def test_norm_velocity_and_rises() -> None:
    run = Signals(T, f=1.0 / (T + 1.0), x=3.0 * T)
    assert m.norm(run, "f") == pytest.approx(sqrt(1 - 1 / 101), rel=1e-5)
    assert m.velocity(run, "x", 10.0) == pytest.approx([3.0])
    assert m.largest_rise(np.array([4.0, 2.0, 3.0, 1.0])) == pytest.approx(0.25)
    assert m.largest_rise(np.array([4.0, 2.0, 1.0])) == 0.0
