"""Manipulability, energy and felt impedance of signals with known results."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.analysis.recorded_numbers import _not_told_apart, approach
from cosim.measure.energy import effort, net_power
from cosim.measure.felt_impedance import FeltImpedance, fit_impedance, is_operator
from cosim.measure.manipulability import growth, local_growth, manipulability
from cosim.record.piecewise import RunningIntegral

T = np.linspace(0.0, 100.0, 10001)
STILL = np.zeros((len(T), 1))


def column(x: np.ndarray) -> np.ndarray:
    return np.asarray(x, dtype=np.float64)[:, None]


# ---- manipulability -----------------------------------------------------------------------------


def test_constant_push_on_an_integrator_grows_like_t() -> None:
    """Force 2, y = 2 t: M^t = t/√3, slope 1."""
    M = manipulability(T, column(np.full_like(T, 2.0)), column(5.0 + 2.0 * T))
    assert M[-1] == pytest.approx(100.0 / np.sqrt(3), rel=1e-4)
    assert growth([(T, M)], 50.0, 100.0) == pytest.approx(1.0, abs=1e-3)


def test_a_hand_that_let_go_leaves_one_half() -> None:
    """A push for 1 s, and then y stays where it is: M^t = √t, slope 1/2."""
    M = manipulability(T, column(T < 1.0), column(np.minimum(T, 1.0)))
    assert growth([(T, M)], 50.0, 100.0) == pytest.approx(0.5, abs=0.01)


def test_what_is_finite_has_no_slope() -> None:
    M = manipulability(T, column(np.ones_like(T)), column(0.03 * (1 - np.exp(-T))))
    assert M[-1] == pytest.approx(0.03, rel=0.02)
    assert growth([(T, M)], 50.0, 100.0) == pytest.approx(0.0, abs=0.02)
    t, slope = local_growth([(T, M)], 100.0)
    assert len(t) == len(slope) and slope[-1] == pytest.approx(0.0, abs=0.02)


def test_without_force_there_is_no_number() -> None:
    assert np.isnan(manipulability(T, STILL, column(T))).all()
    assert np.isnan(growth([(T, np.full_like(T, np.nan))], 1.0, 2.0))


@given(scale=st.floats(1e-3, 1e3), offset=st.floats(-5, 5), shape=st.integers(0, 2**16))
def test_manipulability_is_of_the_linear_behaviour(scale: float, offset: float, shape: int) -> None:
    """Twice the force and twice the response are the same; where it starts does not matter."""
    rng = np.random.default_rng(shape)
    t = np.linspace(0.0, 3.0, 50)
    f, y = rng.normal(size=(50, 2)), rng.normal(size=(50, 2))
    one, other = manipulability(t, f, y), manipulability(t, scale * f, scale * y + offset)
    assert other[1:] == pytest.approx(one[1:], rel=1e-6)


# ---- effort, energy -----------------------------------------------------------------------------


def test_effort_of_a_known_force() -> None:
    f = np.column_stack([np.full_like(T, 3.0), np.full_like(T, -4.0)])
    found = effort([(T, f)], (0.0, 100.0), 2.0)
    assert found.norm == pytest.approx(50.0) and found.integral == pytest.approx(500.0)
    assert found.peak == 4.0 and found.holding == pytest.approx(5.0) and found.window == 2.0


def observer(t: np.ndarray, ends: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    return RunningIntegral().add(net_power(ends), t)


def test_observer_counts_what_goes_in_less_what_comes_out() -> None:
    rate = column(np.full_like(T, 0.5))
    E = observer(T, [(column(np.full_like(T, 4.0)), rate), (column(np.full_like(T, 3.0)), rate)])
    assert E[0] == 0.0 and E[-1] == pytest.approx(0.5 * 100.0)
    active = observer(T, [(STILL, rate), (column(np.full_like(T, 3.0)), rate)])
    assert active.min() == active[-1] == pytest.approx(-150.0)


@given(
    inertia=st.floats(0.1, 5),
    damping=st.floats(0, 10),
    stiffness=st.floats(0, 20),
    seed=st.integers(0, 999),
)
def test_a_passive_impedance_never_gives_back_more_than_it_got(
    inertia: float,
    damping: float,
    stiffness: float,
    seed: int,
) -> None:
    _, _, dq, f = motion(inertia, damping, stiffness, seed)
    t = np.linspace(0.0, 20.0, len(dq))
    E = observer(t, [(column(f), column(dq))])
    assert E.min() >= -1e-3 * (1 + np.abs(E).max())


# ---- felt ---------------------------------------------------------------------------------------


def motion(
    inertia: float,
    damping: float,
    stiffness: float,
    seed: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """t, q, dq and the force I ddq + D dq + S q of a smooth motion that starts at rest."""
    t = np.linspace(0.0, 20.0, 4001)
    q, dq, ddq = np.zeros_like(t), np.zeros_like(t), np.zeros_like(t)
    for w, a in zip((0.7, 2.3, 5.1), np.random.default_rng(seed).uniform(0.2, 1.0, 3), strict=True):
        q += a * (1 - np.cos(w * t))
        dq += a * w * np.sin(w * t)
        ddq += a * w * w * np.cos(w * t)
    return t, q, dq, inertia * ddq + damping * dq + stiffness * q


def felt(
    t: np.ndarray, f: np.ndarray, q: np.ndarray, dq: np.ndarray, window: float
) -> tuple[FeltImpedance, ...]:
    rows = (t, column(f), column(q), column(dq))
    return fit_impedance([rows], (t[0], t[-1]), window)


@given(
    inertia=st.floats(0.1, 5),
    damping=st.floats(0, 10),
    stiffness=st.floats(0, 20),
    seed=st.integers(0, 999),
)
def test_felt_finds_inertia_damping_and_stiffness(
    inertia: float,
    damping: float,
    stiffness: float,
    seed: int,
) -> None:
    t, q, dq, f = motion(inertia, damping, stiffness, seed)
    found = felt(t, f, q, dq, 10.0)
    assert len(found) == 2
    for one in found:
        assert (one.inertia, one.damping, one.stiffness) == pytest.approx(
            (inertia, damping, stiffness), rel=0.02, abs=0.02
        )
        assert one.residual < 1e-2 and not is_operator(one)


def test_the_hand_s_own_law_is_told_from_the_robot() -> None:
    t, q, dq, _ = motion(1.0, 1.0, 1.0, 3)
    f = -10.0 * (q - 3.5) - 5.0 * dq
    for one in felt(t, f, q, dq, 10.0):
        assert is_operator(one)
        assert (one.damping, one.stiffness) == pytest.approx((-5.0, -10.0), rel=1e-2)


def test_a_motion_that_tells_nothing_gives_no_number() -> None:
    t = np.linspace(0.0, 10.0, 1001)
    drift = 0.3 * t
    assert not felt(t, np.ones_like(t), drift, np.full_like(t, 0.3), 5.0)


# ---- approach -----------------------------------------------------------------------------------


def test_rate_of_an_exponential_and_of_an_oscillation() -> None:
    assert approach([(T, 3.0 * np.exp(-0.4 * T))], len(T))[:2] == pytest.approx(
        (-0.4, 0.0), rel=1e-3, abs=1e-3
    )
    assert approach([(T, np.exp(-0.4 * T))], len(T))[2] == pytest.approx(
        np.log(1e3) / 0.4, rel=0.01
    )
    swing = np.abs(np.exp(-0.4 * T) * np.cos(5 * T))
    rate, error, _ = approach([(T, swing)], len(T))
    assert rate == pytest.approx(-0.4, rel=0.03) and error < 0.03


def test_modes_that_a_run_does_not_tell_from_the_slowest_widen_the_uncertainty() -> None:
    roots = np.array([-0.5, -0.5 + 1j, -0.6 + 2j, -0.9])
    assert _not_told_apart(roots, 10.0) == (pytest.approx(0.1), _not_told_apart(roots, 10.0)[1])
    assert "-0.6 1/s are not told from the slowest in 10 s" in _not_told_apart(roots, 10.0)[1]
    assert _not_told_apart(roots, 30.0) == (0.0, "")
    assert _not_told_apart(roots[:0], 10.0) == (0.0, "")


def test_what_does_not_arrive_has_no_rate() -> None:
    assert np.isnan(approach([(T, np.full_like(T, 2.0))], len(T))).all()
