"""One arm in the adaptive law: Theorem 2, Remark 3, Sec. IV-C, and what gravity makes of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmus.arms.adaptive_variables import ADAPTED, COMPENSATED
from fmus.arms.dynamics import gravity
from fmus.models import adaptive, planar2r
from tests.fmus.loops import SL91, Push, Values, arrays, closed, lyapunov, norm

seed = st.integers(0, 2**32 - 1)


def constant(*torque: float, until: float = np.inf) -> Push:
    return lambda t, q, dq: np.array(torque) if t < until else np.zeros(2)


# --- V, (34)-(35) ----------------------------------------------------------------------------


def drawn(rng: np.random.Generator) -> tuple[Values, Values]:
    """An arm in motion and gains, some of the time with bounds around the true theta."""
    bounded = rng.integers(2)
    gains = arrays(
        K=rng.uniform(4, 20, 2),
        Gamma=rng.uniform(0.1, 2, 3),
        alpha=rng.uniform(0, 2),
        lambda_M=rng.uniform(0, 10),
        z=rng.uniform(-1, 1, 2),
        theta_hat=rng.uniform(0.8, 3.4, 3),
        theta_min=np.full(3, 0.5 if bounded else -1e9),
        theta_max=np.full(3, 3.5 if bounded else 1e9),
    )
    return arrays(q=rng.uniform(-3, 3, 2), dq=rng.uniform(-1, 1, 2), substeps=2), gains


@settings(max_examples=20)
@given(seed=seed)
def test_without_a_push_V_never_grows_but_for_the_sampling(seed: int) -> None:
    """dV/dt = -s' K s; a step of the explicit Euler method adds terms of h^2 at most."""
    h = 2e-3
    arm, gains = drawn(np.random.default_rng(seed))
    run = closed(arm, adaptive.kernel(), gains, h, 400)
    V = lyapunov(run, SL91, gains["Gamma"])
    assert np.diff(V).max() < 5 * h**2 * V[0]
    assert V[-1] < V[0]


def imbalance(seed: int, h: float) -> float:
    """V(T) - V(0) + ∫ s' K s dt, relative to V(0), where nothing bounds theta_hat."""
    arm, gains = drawn(np.random.default_rng(seed))
    del gains["theta_min"], gains["theta_max"]
    run = closed(arm, adaptive.kernel(), gains, h, round(1.0 / h))
    V, s = lyapunov(run, SL91, gains["Gamma"]), run["s"][:-1]
    return float(V[-1] - V[0] + h * (gains["K"] * s**2).sum()) / V[0]


@pytest.mark.parametrize("seed", range(4))
def test_what_V_loses_is_what_the_feedback_takes_to_first_order_in_the_step(seed: int) -> None:
    coarse, fine = imbalance(seed, 2e-3), imbalance(seed, 1e-3)
    assert abs(fine) < 0.02
    assert fine / coarse == pytest.approx(0.5, abs=0.05)


@settings(max_examples=15)
@given(seed=seed)
def test_the_gain_from_a_push_to_s_is_at_most_that_of_the_feedback(seed: int) -> None:
    """From rest and the true theta: the L2 norm of s is at most that of tau_h over min K."""
    h, rng = 2e-3, np.random.default_rng(seed)
    arm, gains = drawn(rng)
    levels = rng.uniform(-5, 5, (8, 2))
    gains |= arrays(z=arm["dq"], theta_hat=SL91)
    law = adaptive.kernel()
    run = closed(arm, law, gains, h, 800, lambda t, q, dq: levels[int(t / 0.2)])
    assert norm(run["s"], h) < 1.01 * norm(run["push"], h) / gains["K"].min()


# --- Remark 3 --------------------------------------------------------------------------------


def test_with_remark_3_V_decays_at_twice_lambda_c_whatever_the_inertia() -> None:
    """M ds + C s = -lambda_c M s for the true theta, so s' M s / 2 falls as exp(-2 lambda_c t)."""
    h, lambda_c = 1e-3, 3.0
    for preset in ("SL91", "IMI", "heavy"):
        theta = np.array(planar2r.PRESETS[preset]["theta"])
        gains = arrays(lambda_c=lambda_c, lambda_M=2.0, Gamma=np.zeros(3), theta_hat=theta)
        arm = arrays(theta=theta, q=[0.3, -1.2], dq=[1.0, -1.5], substeps=2)
        run = closed(arm, adaptive.kernel(), gains, h, 900)
        V, t = lyapunov(run, theta, np.ones(3)), h * np.arange(900)
        assert np.allclose(V, V[0] * np.exp(-2 * lambda_c * t), rtol=0.02)


def test_remark_3_adapts_without_losing_the_decrease_of_V() -> None:
    h, lambda_c = 1e-3, 3.0
    gains = arrays(lambda_c=lambda_c, theta_hat=[2.0, 0.5, 0.5], theta_min=[0.5, 0.1, 0.2])
    arm = arrays(q=[0.3, -1.2], dq=[1.0, -1.5], substeps=2)
    run = closed(arm, adaptive.kernel(), gains, h, 3000)
    V = lyapunov(run, SL91, np.ones(3))
    assert np.diff(V).max() < 5 * h**2 * V[0]
    assert np.abs(run["s"][-1]).max() < 0.1 * np.abs(run["s"][0]).max()


# --- alpha = 0, Sec. IV-C --------------------------------------------------------------------


def test_with_alpha_0_a_push_makes_speed_and_the_speed_stays() -> None:
    """ddq = lambda_M s + ds: a constant push accelerates by lambda_M tau / K, and nothing brakes;
    with alpha > 0 it makes a speed, which goes with it."""
    h, push = 5e-3, constant(2.0, 0.0, until=10.0)
    for alpha in (0.0, 0.5):
        gains = arrays(alpha=alpha, lambda_M=1.0, Gamma=np.zeros(3), theta_hat=SL91)
        run = closed(arrays(substeps=5), adaptive.kernel(), gains, h, 5000, push)
        speed = run["dq"][:, 0]
        gained = (speed[1900] - speed[1500]) / (400 * h)
        assert gained == pytest.approx(2.0 / 16 if alpha == 0 else 0.0, abs=2e-3)
        left = 1.25 if alpha == 0 else 0.0
        assert np.allclose(speed[[3500, 4999]], left, atol=0.01)


# --- gravity, adapted or known ---------------------------------------------------------------


UPRIGHT = {name: np.array(value) for name, value in planar2r.PRESETS["SL91-upright"].items()}
TEACHING = arrays(alpha=2.0, lambda_M=6.0, Gamma=[1, 1, 1, 8, 8], theta_g=UPRIGHT["theta_g"])
ALL = np.concatenate([UPRIGHT["theta"], UPRIGHT["theta_g"]])


def pushed(mode: int, seconds: float, *torque: float) -> Values:
    gains = {**TEACHING, **arrays(gravity=mode, theta_hat=ALL)}
    arm = {**UPRIGHT, **arrays(q=[-1.2, 0.3], substeps=5)}
    law = adaptive.kernel(gravity=True)
    return closed(arm, law, gains, 5e-3, round(seconds / 5e-3), constant(*torque))


def test_known_gravity_lets_a_constant_push_move_the_arm_for_ever() -> None:
    """At the speed lambda_M tau / (K alpha), as without gravity."""
    run = pushed(COMPENSATED, 120.0, 0.8, 0.0)
    half, whole = run["q"][12000, 0] - run["q"][0, 0], run["q"][-1, 0] - run["q"][0, 0]
    assert whole > 15.0
    assert (whole - half) / 60.0 == pytest.approx(6 * 0.8 / (16 * 2), rel=0.01)


def test_adapted_gravity_stops_a_constant_push_and_carries_it() -> None:
    run = pushed(ADAPTED, 120.0, 1.0, 0.5)
    assert np.abs(run["q"][-1] - run["q"][12000]).max() < 0.01
    assert np.abs(run["q"][-1] - run["q"][0]).max() < 1.0
    error = run["theta_hat"][-1, 3:] - UPRIGHT["theta_g"]
    assert np.allclose(gravity(error, run["q"][-1]), [-1.0, -0.5], atol=1e-3)
    assert np.abs(run["s"][-1]).max() < 1e-4


def test_unknown_gravity_is_learnt_only_where_it_is_adapted() -> None:
    """Nobody pushes, theta_g is not known: adapted, and fast, the arm comes to rest on its way
    down with g_hat = g; left out, it falls until it hangs."""
    ends = {}
    for mode in (ADAPTED, COMPENSATED):
        start = np.concatenate([UPRIGHT["theta"], [0.0, 0.0]])
        gains = arrays(gravity=mode, Gamma=[1, 1, 1, 300, 300], theta_hat=start, theta_g=[0, 0])
        arm = {**UPRIGHT, **arrays(q=[0.4, 0.7], substeps=5)}
        run = closed(arm, adaptive.kernel(gravity=True), TEACHING | gains, 5e-3, 8000)
        assert np.abs(run["dq"][-1]).max() < 1e-2
        ends[mode] = run["theta_hat"][-1, 3:], np.sin([run["q"][-1, 0], run["q"][-1].sum()])
    assert np.allclose(ends[ADAPTED][0], UPRIGHT["theta_g"], rtol=1e-6)
    assert ends[ADAPTED][1].min() > 0.0
    assert np.allclose(ends[COMPENSATED][1], -1.0, atol=0.01)
