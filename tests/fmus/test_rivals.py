"""The rivals' laws by themselves: their equations, and what makes one of them another."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from cosim.base.component import Component
from fmus.arms.dynamics import coriolis, inertia
from fmus.models import (
    abdessameud2014,
    chopra,
    lee_spong,
    nuno_adaptive,
    p_d,
    pd,
    tdpa_admittance,
    tdpa_impedance,
    wang2014,
    wave_admittance,
    wave_impedance,
    wave_integral_impedance,
)
from fmus.models.planar2r import PRESETS

H = 5e-3
THETA = np.array(PRESETS["SL91"]["theta"])
number = st.floats(-10.0, 10.0)
pair = st.tuples(number, number).map(np.array)
gain = st.floats(0.1, 50.0)
gains = st.tuples(gain, gain).map(np.array)


def outputs(component: Component, values: dict[str, ArrayLike], **u: ArrayLike) -> dict:
    """What a component gives in its first step with the inputs `u`, which it also starts with."""
    component.initialize({name: np.array(value) for name, value in values.items()})
    inputs = {port.name: np.zeros(port.shape) for port in component.inputs}
    inputs |= {name: np.array(value) for name, value in u.items()}
    component.initial(inputs)
    return {name: np.array(y) for name, y in component.step(0.0, H, inputs).items()}


@given(q=pair, dq=pair, q_j=pair, dq_j=pair, K_p=gains, K_d=gains)
def test_dissipation_makes_lee_spong_of_pd(
    q: np.ndarray,
    dq: np.ndarray,
    q_j: np.ndarray,
    dq_j: np.ndarray,
    K_p: np.ndarray,
    K_d: np.ndarray,
) -> None:
    motion = {"q": q, "dq": dq, "q_j": q_j, "dq_j": dq_j}
    plain = outputs(pd.kernel(), {"K_p": K_p, "K_d": K_d}, **motion)["tau"]
    none = {"K_p": K_p, "K_v": K_d, "K_d": [0.0, 0.0], "P_eps": [0.0, 0.0]}
    damped = {**none, "K_d": [3.0, 2.0], "P_eps": [0.5, 0.25]}
    assert np.allclose(outputs(lee_spong.kernel(), none, **motion)["tau"], plain)
    less = outputs(lee_spong.kernel(), damped, **motion)["tau"]
    assert np.allclose(less, plain - np.array([3.5, 2.25]) * dq)


@given(q=pair, dq=pair, q_j=pair, K=gains, B=gains)
def test_p_d_is_pd_to_an_arm_that_rests(
    q: np.ndarray, dq: np.ndarray, q_j: np.ndarray, K: np.ndarray, B: np.ndarray
) -> None:
    rests = outputs(pd.kernel(), {"K_p": K, "K_d": B}, q=q, dq=dq, q_j=q_j)["tau"]
    assert np.allclose(outputs(p_d.kernel(), {"K": K, "B": B}, q=q, dq=dq, q_j=q_j)["tau"], rests)


@given(q=pair, dq=pair, q_j=pair, dq_j=pair)
def test_wang_is_nuno_without_its_damper_to_the_bit(
    q: np.ndarray, dq: np.ndarray, q_j: np.ndarray, dq_j: np.ndarray
) -> None:
    motion = {"q": q, "dq": dq, "q_j": q_j, "dq_j": dq_j}
    estimate = {"theta_hat": [3.0, 1.0, 0.5]}
    a = outputs(wang2014.kernel(), estimate, **motion)
    b = outputs(nuno_adaptive.kernel(), {**estimate, "B": [0.0, 0.0]}, **motion)
    assert np.array_equal(a["tau"], b["tau"])
    assert np.array_equal(a["s"], b["epsilon"])


@given(q=pair, dq=pair, q_j=pair, dq_j=pair, lambda_=st.floats(0.1, 3.0))
def test_with_the_true_parameters_the_torque_is_feedforward_and_feedback(
    q: np.ndarray, dq: np.ndarray, q_j: np.ndarray, dq_j: np.ndarray, lambda_: float
) -> None:
    """tau = M dz + C z + feedback, so that M ds + C s = feedback: s decays where that is -K s."""
    M, C = inertia(THETA, q), coriolis(THETA, q, dq)
    values = {"theta_hat": THETA, "lambda": lambda_, "K": [5.0, 7.0]}
    motion = {"q": q, "dq": dq, "q_j": q_j, "dq_j": dq_j}
    K, e, de = np.array([5.0, 7.0]), q - q_j, dq - dq_j
    z, dz = -lambda_ * e, -lambda_ * de
    expected = M @ dz + C @ z - K * (dq - z)
    assert np.allclose(outputs(wang2014.kernel(), values, **motion)["tau"], expected)
    nuno = outputs(nuno_adaptive.kernel(), {**values, "B": [2.0, 3.0]}, **motion)
    assert np.allclose(nuno["tau"], expected - np.array([2.0, 3.0]) * de)
    assert np.allclose(nuno["epsilon"], dq - z)
    z, dz = -lambda_ * q, -lambda_ * dq
    sent = outputs(chopra.kernel(), values, q=q, dq=dq, r_j=dq_j)
    assert np.allclose(sent["tau"], M @ dz + C @ z + K * (dq_j - (dq - z)))
    assert np.allclose(sent["r"], dq - z)


def test_the_reference_filter_responds_as_its_closed_form() -> None:
    """Held at q = 0 with q_j = 1: z = (k_p / k_d) (1 - e^(-k_d t)), so K k_p / k_d at rest."""
    kernel, h = abdessameud2014.kernel(), 1e-4
    kernel.initialize({"K": np.array([5.0, 7.0])})
    u = {"q": np.zeros(2), "dq": np.zeros(2), "q_j": np.ones(2)}
    kernel.initial(u)
    for k in range(20_001):
        y = kernel.step(k * h, h, u)
    assert np.array(y["z"]) == pytest.approx((1 - np.exp(-2.0 * 2.0)) / 2.0, abs=1e-4)
    assert np.allclose(y["tau"], np.array([5.0, 7.0]) * y["z"] + feedforward(y, u))


def feedforward(y: dict, u: dict) -> np.ndarray:
    """Y theta_hat of a filter at k_p = 1, k_d = 2, with the joints at rest."""
    dz = -2.0 * np.array(y["z"]) - (u["q"] - u["q_j"])
    return inertia(np.array(y["theta_hat"]), u["q"]) @ dz


@pytest.mark.parametrize(
    "make", [nuno_adaptive.kernel, wang2014.kernel, chopra.kernel, abdessameud2014.kernel]
)
def test_the_estimate_stands_still_while_a_torque_is_limited(make: Callable[[], Component]) -> None:
    component, rng = make(), np.random.default_rng(1)
    u = {port.name: rng.uniform(1, 3, port.shape) for port in component.inputs}
    for limit, moves in ((1e9, True), (0.5, False)):
        component.initialize({"tau_max": np.full(2, limit)})
        component.initial(u)
        component.step(0.0, H, u)
        second = component.step(H, H, u)
        assert np.abs(np.array(second["tau"])).max() <= limit
        assert np.any(np.array(second["theta_hat"]) != 0.0) == moves


# ---- waves ------------------------------------------------------------------------------------


@given(dq=pair, v=pair, b=gains, limit=st.sampled_from([5.0, 1e9]))
def test_power_into_a_wave_line_is_at_least_that_of_its_waves(
    dq: np.ndarray, v: np.ndarray, b: np.ndarray, limit: float
) -> None:
    """dq F = (u² - v²)/(4b); where F is limited the arm gives more than the line gets."""
    y = outputs(wave_impedance.kernel(), {"b": b, "tau_max": [limit] * 2}, dq=dq, v=v)
    power, of_waves = -y["tau"] * dq, (y["u"] ** 2 - v**2) / (4 * b)
    assert (power >= of_waves - 1e-9 * (1 + np.abs(of_waves))).all()
    if limit == 1e9:
        assert np.allclose(power, of_waves)


@given(u=pair, q=pair, dq=pair, b=gains, K_p=gains, K_d=gains, limit=st.sampled_from([5.0, 1e9]))
def test_the_other_end_gets_what_the_waves_leave(
    u: np.ndarray,
    q: np.ndarray,
    dq: np.ndarray,
    b: np.ndarray,
    K_p: np.ndarray,
    K_d: np.ndarray,
    limit: float,
) -> None:
    """F dq_d = (u² - v²)/(4b), with dq_d seen in how q_d advances; F is the spring and damper's."""
    kernel = wave_admittance.kernel()
    values = {"b": b, "K_p": K_p, "K_d": K_d, "tau_max": np.full(2, limit)}
    y = outputs(kernel, values, u=u, q=q, dq=dq)
    rest = {"u": np.zeros(2), "q": q, "dq": dq}
    dq_d = (np.array(kernel.step(H, H, rest)["q_d"]) - y["q_d"]) / H
    power, of_waves = y["tau"] * dq_d, (u**2 - y["v"] ** 2) / (4 * b)
    assert np.allclose(power, of_waves, atol=1e-6)
    assert np.array_equal(y["q_d"], q)
    if limit == 1e9:
        assert np.allclose(y["tau"], K_d * (dq_d - dq), atol=1e-6)


def test_a_matched_line_end_does_not_reflect_a_wave() -> None:
    """K_d = b: nothing of a sudden wave comes back to begin with."""
    for K_d, reflects in ((10.0, False), (40.0, True)):
        y = outputs(wave_admittance.kernel(), {"b": [10.0] * 2, "K_d": [K_d] * 2}, u=[3.0, -2.0])
        assert np.any(np.abs(y["v"]) > 1e-12) == reflects


@given(seed=st.integers(0, 2**32 - 1), b=st.sampled_from([1.0, 10.0]))
def test_no_more_energy_is_given_on_than_integrals_of_waves_bring(seed: int, b: float) -> None:
    """Whatever arrives, with an arm at rest, whose torque is the wave: ∑ h w²/(4b) <= max E_j.

    Of samples that a wave can have sent (dU² <= 4b h dE), it also gives on the whole integral.
    """
    rng, kernel = np.random.default_rng(seed), wave_integral_impedance.kernel()
    kernel.initialize({"b": np.full(2, b)})
    sent_U, sent_E = np.zeros((61, 2)), np.zeros((61, 2))
    waves = np.where(rng.random((60, 2)) < 0.8, rng.uniform(-20, 20, (60, 2)), 0.0)
    sent_U[1:], sent_E[1:] = np.cumsum(H * waves, 0), np.cumsum(H * waves**2 / (4 * b), 0)
    late = np.minimum(np.maximum.accumulate(rng.integers(0, 61, 60)), 60)
    rows = [*late, *[60] * 61]  # in jumps, held, and all of it at the end
    out, energy, u = np.zeros(2), np.zeros(2), {"dq": np.zeros(2)}
    kernel.initial(u | {"U_j": np.zeros(2), "E_j": np.zeros(2)})
    for k, row in enumerate(rows):
        y = kernel.step(k * H, H, u | {"U_j": sent_U[row], "E_j": sent_E[row]})
        out += H * np.array(y["tau"])
        energy += H * np.array(y["tau"]) ** 2 / (4 * b)
        assert (energy <= sent_E[: row + 1].max(axis=0) * (1 + 1e-9) + 1e-12).all()
    assert np.allclose(out, sent_U[60])


# ---- time-domain passivity ---------------------------------------------------------------------


@given(seed=st.integers(0, 2**32 - 1), k_c=st.sampled_from([0.0, 1.0]))
def test_the_admittance_end_never_gives_more_than_there_is(seed: int, k_c: float) -> None:
    """Whatever arrives: ∑ h f dq_d <= E_0 + max E_j, for an arm that moves at random."""
    rng, kernel = np.random.default_rng(seed), tdpa_admittance.kernel()
    kernel.initialize({"k_c": np.array(k_c), "tau_max": np.full(2, rng.choice([5.0, 1e9]))})
    q, most, told, out, before = np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2), None
    kernel.initial({port.name: np.zeros(port.shape) for port in kernel.inputs})
    for k in range(100):
        dq = rng.uniform(-2, 2, 2)
        E_j = rng.uniform(-1, 0.1 * k, 2)
        u = {
            "q": q,
            "dq": dq,
            "v_j": rng.uniform(-3, 3, 2),
            "E_j": E_j,
            "q_j": rng.uniform(-1, 1, 2),
        }
        most = np.maximum(most, E_j)
        y = {name: np.array(value) for name, value in kernel.step(k * H, H, u).items()}
        if before is not None:
            out += before["f"] * (y["q_d"] - before["q_d"])  # dq_d h
            assert (out <= 1e-3 + told + 1e-9).all()
            assert (y["E"] >= before["E"]).all()
        before, told, q = y, most, q + H * dq


@given(seed=st.integers(0, 2**32 - 1))
def test_the_impedance_end_counts_the_work_exactly(seed: int) -> None:
    """E and W from the angles passed and the torques held, and -W taken back by damping."""
    rng, kernel = np.random.default_rng(seed), tdpa_impedance.kernel()
    kernel.initialize({})
    q, work, dissipated = rng.uniform(-1, 1, 2), [], np.zeros(2)
    u = {"q": q, "dq": np.zeros(2), "f_j": np.zeros(2), "E_j": np.zeros(2)}
    tau, f_j, seen = -np.array(u["f_j"]), u["f_j"], np.zeros(2)
    kernel.initial(u)
    for k in range(50):
        passed = rng.uniform(-0.01, 0.01, 2)
        work.append(f_j * passed)
        dissipated = dissipated - (tau + f_j) * passed
        q, dq = q + passed, rng.uniform(-1, 1, 2)
        f_j, E_j = rng.uniform(-3, 3, 2), rng.uniform(0, 0.05, 2)
        y = kernel.step(k * H, H, {"q": q, "dq": dq, "f_j": f_j, "E_j": E_j})
        seen = np.maximum(seen, E_j)
        W = seen - np.maximum(-np.array(work), 0).sum(axis=0) + dissipated
        tau = np.array(y["tau"])
        assert np.allclose(y["E"], np.maximum(work, 0).sum(axis=0))
        assert np.allclose(y["W"], W)
        taken = -(tau + f_j) * dq * H  # to be, if dq stays
        assert np.allclose(taken, np.clip(-W, 0.0, 20.0 * H * dq * dq))


def test_a_line_without_energy_gives_no_torque() -> None:
    y = outputs(tdpa_admittance.kernel(), {"E_0": [0.0, 5.0]}, v_j=[1.0, 1.0])
    assert y["tau"][0] == 0.0
    assert y["tau"][1] == 10.0
