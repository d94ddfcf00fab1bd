"""M, C, g and the regressor Y of the planar arm: the properties the paper's proofs stand on."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fmus.arms.dynamics import coriolis, gravity, gravity_regressor, inertia, regressor
from fmus.models.planar2r import PRESETS

angle = st.floats(-7.0, 7.0)
number = st.floats(-10.0, 10.0)
pair = st.tuples(angle, angle).map(np.array)
two = st.tuples(number, number).map(np.array)
three = st.tuples(number, number, number).map(np.array)
theta = st.sampled_from([np.array(preset["theta"]) for preset in PRESETS.values()])


@given(theta, pair, pair)
def test_inertia_rate_minus_twice_coriolis_is_skew_symmetric(
    theta: np.ndarray, q: np.ndarray, dq: np.ndarray
) -> None:
    rate = -theta[1] * np.sin(q[1]) * dq[1] * np.array([[2.0, 1.0], [1.0, 0.0]])
    half = 1e-6 * dq
    assert np.allclose(
        (inertia(theta, q + half) - inertia(theta, q - half)) / 2e-6, rate, atol=1e-7
    )
    skew = rate - 2 * coriolis(theta, q, dq)
    assert np.allclose(skew, -skew.T, atol=1e-12)


@given(theta, pair)
def test_inertia_of_every_preset_is_symmetric_positive_definite(
    theta: np.ndarray, q: np.ndarray
) -> None:
    M = inertia(theta, q)
    assert np.array_equal(M, M.T)
    assert np.linalg.eigvalsh(M)[0] > 0


@given(pair, two, two, two, three, two)
def test_regressor_times_parameters_is_the_arm_with_its_gravity(
    q: np.ndarray,
    dq: np.ndarray,
    z: np.ndarray,
    dz: np.ndarray,
    theta: np.ndarray,
    theta_g: np.ndarray,
) -> None:
    Y = np.hstack([regressor(q, dq, z, dz), gravity_regressor(q)])
    torque = inertia(theta, q) @ dz + coriolis(theta, q, dq) @ z + gravity(theta_g, q)
    assert np.allclose(Y @ np.concatenate([theta, theta_g]), torque, rtol=1e-12, atol=1e-10)


@given(pair, two, two, two)
def test_regressor_is_two_standard_ones(
    q: np.ndarray, dq: np.ndarray, z: np.ndarray, dz: np.ndarray
) -> None:
    """Y(q, dq, z, dz) = Y(q, v, v, dz) - Y(q, u, u, 0), v = (dq + z)/2, u = (dq - z)/2."""
    v, u = (dq + z) / 2, (dq - z) / 2
    standard = regressor(q, v, v, dz) - regressor(q, u, u, np.zeros(2))
    assert np.allclose(regressor(q, dq, z, dz), standard, rtol=1e-12, atol=1e-11)


@given(two, pair)
def test_gravity_is_the_gradient_of_a_potential(theta_g: np.ndarray, q: np.ndarray) -> None:
    def potential(q: np.ndarray) -> float:
        return float(theta_g @ [np.sin(q[0]), np.sin(q[0] + q[1])])

    steps = 1e-5 * np.eye(2)
    slope = [(potential(q + e) - potential(q - e)) / 2e-5 for e in steps]
    assert np.allclose(gravity(theta_g, q), slope, atol=1e-7)


def test_presets_are_the_rods_they_say_they_are() -> None:
    """Two equal rods of 1 kg and 1 m, and the book's arm: 1 kg with its centre at 0.5 m, then 2 kg
    at 0.6 m from the second joint; 9.81 m/s2."""
    assert np.allclose(PRESETS["unit-upright"]["theta_g"], [1.5 * 9.81, 0.5 * 9.81])
    assert np.allclose(PRESETS["SL91-upright"]["theta_g"], [(0.5 + 2.0) * 9.81, 1.2 * 9.81])
    for name in ("unit", "SL91"):
        assert PRESETS[f"{name}-upright"]["theta"] == PRESETS[name]["theta"]
