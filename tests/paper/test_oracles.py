"""The closed forms agree with each other and with what they are solutions of."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.arms import dynamics
from fmus.paper import oracles
from fmus.paper.experiments import Q_H, THETA, THETA_G
from tests.paper.oracles import push_manipulability

gains = st.floats(0.1, 50.0)
rates = st.floats(0.1, 10.0)
times = st.floats(0.1, 100.0)
angles = st.floats(-6.0, 6.0)


@given(angles, angles, gains, rates, gains)
def test_at_rest_the_hand_balances_what_the_controller_feeds_back(
    q_0: float, q_h: float, K: float, alpha: float, k_p: float
) -> None:
    """lambda_M = 0: z = alpha (q(0) - q), s = -z, K s = tau_h."""
    q = oracles.rest_position(q_0, q_h, K, alpha, k_p)
    assert K * alpha * (q - q_0) == pytest.approx(k_p * (q_h - q), abs=1e-9 * K * alpha)
    held = oracles.holding_torque(q_0, q_h, K, alpha, k_p)
    assert (q - q_0) == pytest.approx(oracles.finite_manipulability(K, alpha) * held, abs=1e-9)


@given(angles, angles, angles, gains, rates, gains, rates)
def test_two_arms_without_delay_rest_at_the_mean_drawn_towards_the_hand(
    q_1: float, q_2: float, q_h: float, K: float, alpha: float, k_p: float, lambda_: float
) -> None:
    q = oracles.rest_position_pair([[q_1], [q_2]], [q_h], K, alpha, k_p, lambda_, (0.0, 0.0))[0]
    assert alpha * (2 * q - q_1 - q_2) == pytest.approx(k_p / K * (q_h - q), abs=1e-8)


@given(gains, rates, rates, gains, st.floats(0.0, 20.0))
def test_the_poles_are_stable_and_slower_without_inertia_to_speak_of(
    K: float, alpha: float, lambda_M: float, k_p: float, k_d: float
) -> None:
    quasi_static = oracles.poles(K, alpha, lambda_M, k_p, k_d)
    assert len(quasi_static) == 2
    assert quasi_static.max() < 0
    with_inertia = oracles.poles(K, alpha, lambda_M, k_p, k_d, mass=1e-9 * K)
    assert with_inertia[:2] == pytest.approx(quasi_static, rel=1e-4)


def test_the_paper_s_poles() -> None:
    assert oracles.poles(16.0, 2.0, 2.0, 10.0, 5.0) == pytest.approx([-0.4762, -2.0], abs=1e-4)
    assert oracles.poles(16.0, 2.0, 6.0, 10.0, 5.0) == pytest.approx([-1.4286, -2.0], abs=1e-4)


@given(st.floats(0.1, 10.0), gains, gains, gains)
def test_three_springs_in_series_bear_the_same_torque(
    gap: float, k_p: float, kappa: float, k_w: float
) -> None:
    tau = float(oracles.wall_torque(1.0 + gap, 1.0, k_p, kappa, k_w))
    assert tau / k_p + tau / kappa + tau / k_w == pytest.approx(gap)


@given(gains, rates, rates, rates, st.floats(0.0, 5.0))
def test_delay_is_felt_as_damping_and_not_as_distance(
    K: float, alpha: float, lambda_M: float, lambda_: float, T: float
) -> None:
    felt = oracles.felt_damping(K, alpha, lambda_M, lambda_, 2 * T)
    assert felt >= oracles.felt_damping(K, alpha, lambda_M, lambda_, 0.0)
    assert felt == pytest.approx(2 * K * alpha * (1 + lambda_ * T) / lambda_M)
    apart = oracles.sync_offset(1.0, K, alpha, lambda_M, lambda_)
    assert 2 * apart * oracles.static_stiffness(K, alpha, lambda_M, lambda_) == pytest.approx(1.0)


@given(times, gains, rates, rates)
def test_a_push_stays_below_the_bound_on_manipulability(
    t: float, K: float, alpha: float, lambda_M: float
) -> None:
    push = push_manipulability(t, K, alpha, lambda_M)
    assert push <= oracles.manipulability_bound(t, K, alpha, lambda_M) * (1 + 1e-9)


@given(st.tuples(angles, angles))
def test_the_inertia_is_the_model_s(q: tuple[float, float]) -> None:
    found = oracles.inertia(THETA, np.array([q]))[0]
    assert found == pytest.approx(dynamics.inertia(np.array(THETA), np.array(q)))


@given(st.tuples(angles, angles), st.floats(1.0, 40.0), rates, st.floats(10.0, 1e4))
def test_a_stiff_grip_is_the_passive_limit(
    q: tuple[float, float], K: float, alpha: float, k_p: float
) -> None:
    """The cubic of the heaviest mode has its roots on the imaginary axis at the limit."""
    heaviest = np.linalg.eigvalsh(oracles.inertia(THETA, np.array([q]))[0])[-1]
    limit = oracles.grip_limit(oracles.passive_limit(THETA, q, K, alpha), K, alpha, k_p)
    roots = np.roots([heaviest, K + alpha * heaviest, alpha * K + k_p, limit * k_p])
    assert np.abs(roots.real).min() == pytest.approx(0.0, abs=1e-6 * np.abs(roots).max())


def test_energy_is_zero_for_the_truth_at_rest_and_positive_else() -> None:
    q = np.array([[0.3, 0.2], [1.0, 2.0]])
    at_rest = oracles.lyapunov(THETA, q, np.zeros((2, 2)), np.array([THETA, THETA]), 8.0)
    assert at_rest == pytest.approx([0.0, 0.0])
    assert (oracles.lyapunov(THETA, q, np.ones((2, 2)), np.zeros((2, 3)), 8.0) > 0).all()


def test_a_root_of_a_balanced_graph_draws_the_others_by_its_share() -> None:
    starts = [[0.0, 0.0]] * 6
    alone = oracles.consensus_without_integral(starts, 1.0, Q_H, 16.0, 1.6, 10.0)
    assert alone == pytest.approx(oracles.rest_position((0.0, 0.0), Q_H, 16.0, 1.6, 10.0))


def test_the_gravity_used_here_is_that_of_the_arm_s_masses() -> None:
    assert pytest.approx((2.5 * 9.81, 1.2 * 9.81)) == THETA_G


def test_rest_without_lambda_m_depends_on_where_z_starts() -> None:
    """ψ_0 = q(0) + z(0)/α: 0.3 + 1.0/2 in the place of 0.3 gives 1.443 rad, not 1.062."""
    found = oracles.rest_position([0.3], [3.5], 16.0, 2.0, 10.0, [1.0])
    assert found == pytest.approx([(32 * 0.8 + 35) / 42])
    assert found == pytest.approx([1.443], abs=1e-3)
    assert oracles.rest_position([0.3], [3.5], 16.0, 2.0, 10.0) == pytest.approx([1.062], abs=1e-3)
