"""The controller with its arm, its operator and the other arm: what the paper promises.

The arms are the preset SL91; controllers at 5 ms, arms integrated at 1 ms, the operator's grip and
the wall inside the arm. The numbers follow from the equations at rest, or are those that an
independent simulation of the paper's Sec. VII gives.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import pi

import numpy as np
import pytest
from numpy.typing import ArrayLike

from cosim.base.component import Component
from fmus.models import planar2r, teleoperation
from fmus.models.planar2r import inertia
from tests.tiers import first_fast

H, SUBSTEPS = 5e-3, 5
Q1, Q2 = np.array([-pi / 3, -pi / 2]), np.array([-2 * pi / 3, pi / 3])
Q_H = np.array([3.5, 3.0])
GRIP = {"k_p": np.full(2, 10.0), "k_d": np.full(2, 5.0)}


def arm(**values: np.ndarray) -> Component:
    component = planar2r.kernel()
    component.initialize({**values, "substeps": np.array(SUBSTEPS)})
    return component


def controller(**values: np.ndarray) -> Component:
    component = teleoperation.kernel()
    component.initialize(values)
    return component


def closed(
    arms: list[Component],
    controllers: list[Component],
    seconds: float,
    *,
    push: tuple[float, float] = (0.0, 0.0),
    delay: tuple[int, ...] = (0, 0),
) -> dict[str, np.ndarray]:
    """Run one arm alone or two coupled; each signal (steps, arms, ...) as it is at k H.

    `push`: constant external torque on the first arm, N.m; `delay`: age of the xi that each
    controller receives, in steps of H.
    """
    n = len(arms)
    external = [np.array(push), np.zeros(2)][:n]
    moved = [a.initial({"q_h": Q_H}) for a in arms]
    sent = np.zeros((round(seconds / H), n, 2))
    rows = []
    for k in range(len(sent)):
        sent[k] = [np.array(m["dq"]) + 0.5 * np.array(m["q"]) for m in moved]
        held = []
        for i in range(n):
            u = {"q": moved[i]["q"], "dq": moved[i]["dq"]}
            u |= {"xi_in": sent[max(0, k - delay[i]), [n - 1 - i]], "w": np.full(1, n - 1.0)}
            held.append(controllers[i].step(k * H, H, u))
        rows.append([flat(m, c) for m, c in zip(moved, held, strict=True)])
        moved = [
            arms[i].step(k * H, H, {"tau": held[i]["tau"], "tau_ext": external[i], "q_h": Q_H})
            for i in range(n)
        ]
    names = ["q", "dq", "tau_h", "tau_e", "tau", "xi", "s", "z", "theta_hat"]
    return dict(zip(names, np.split(np.array(rows), range(2, 18, 2), axis=2), strict=True))


def flat(*outputs: Mapping[str, ArrayLike]) -> np.ndarray:
    """All outputs in one row."""
    return np.concatenate([np.array(value) for y in outputs for value in y.values()])


def last_outside(error: np.ndarray, tolerance: float = 0.05) -> float:
    """The time (s) from which on every entry of `error` (steps, ...) stays within `tolerance`."""
    outside = np.nonzero(np.abs(error).reshape(len(error), -1).max(axis=1) >= tolerance)[0]
    return (int(outside[-1]) + 1) * H if len(outside) else 0.0


def effort(tau_h: np.ndarray) -> float:
    """Norm of the operator's torque over the run, N.m.s^0.5."""
    return float(np.sqrt((tau_h**2).sum() * H))


@pytest.mark.parametrize(("lambda_M", "settled"), [(10.0, 9.0), (1.0, 12.4)])
def test_without_delay_both_arms_reach_the_operator_s_position(
    lambda_M: float, settled: float
) -> None:
    arms = [arm(q=Q1, **GRIP), arm(q=Q2)]
    run = closed(arms, [controller(lambda_M=np.array(lambda_M)) for _ in arms], 16.0)
    assert last_outside(run["q"] - Q_H) == pytest.approx(settled, abs=0.1)
    assert np.abs(run["tau_h"][-1, 0]).max() < 0.05


def test_with_a_constant_delay_both_arms_reach_the_operator_s_position() -> None:
    arms = [arm(q=Q1, **GRIP), arm(q=Q2)]
    run = closed(arms, [controller(), controller()], 16.0, delay=(150, 60))
    assert last_outside(run["q"] - Q_H) < 14.0
    assert effort(run["tau_h"][:, 0]) == pytest.approx(47.0, rel=0.1)


def test_free_arms_meet() -> None:
    run = closed([arm(q=Q1), arm(q=Q2)], [controller(), controller()], 12.0)
    assert last_outside(run["q"][:, 0] - run["q"][:, 1]) == pytest.approx(7.9, abs=0.5)


@pytest.mark.parametrize(("lambda_M", "torque"), first_fast([(10.0, 3.42466), (1.0, 14.92537)]))
def test_a_wall_is_felt_by_the_operator(lambda_M: float, torque: float) -> None:
    """At rest tau_h = tau_e = (lambda alpha K / lambda_M) (q_1 - q_2), Theorem 5."""
    wall = {"k_w": np.full(2, 200.0), "q_w": np.full(2, 1.0)}
    arms = [arm(q=Q1, **GRIP), arm(q=Q2, **wall)]
    run = closed(arms, [controller(lambda_M=np.array(lambda_M)) for _ in arms], 60.0)
    felt, exerted = run["tau_h"][-1, 0], run["tau_e"][-1, 1]
    stretched = run["q"][-1, 0] - run["q"][-1, 1]
    assert felt[0] == pytest.approx(torque, rel=1e-4)
    assert np.allclose(felt, exerted, rtol=1e-4)
    assert np.allclose(felt, 2 * 0.5 * 16 / lambda_M * stretched, rtol=1e-4)


@pytest.mark.parametrize(("steps", "damping"), first_fast([(150, 4.00), (0, 1.60)]))
def test_a_constant_push_feels_the_damping_of_the_equations(steps: int, damping: float) -> None:
    """tau / v = K alpha (2 + lambda (T12 + T21)) / lambda_M, for lambda_M = 10."""
    arms = [arm(), arm()]
    run = closed(arms, [controller(), controller()], 80.0, push=(0.8, 0.0), delay=(steps, steps))
    velocity = (run["q"][-1, :, 0] - run["q"][-1001, :, 0]) / 5.0
    assert np.allclose(0.8 / velocity, damping, rtol=1e-3)


def test_a_single_arm_without_lambda_M_has_to_be_held() -> None:
    """q -> (alpha K q(0) + k_p q_h) / (alpha K + k_p), Sec. VII-A with lambda_M = 0."""
    values = {"alpha": np.array(2.0), "lambda_M": np.array(0.0), "Gamma": np.full(3, 8.0)}
    run = closed([arm(**GRIP)], [controller(**values)], 30.0)
    assert np.allclose(run["q"][-1, 0], 10 * Q_H / (2 * 16 + 10), atol=5e-3)
    assert np.allclose(run["tau_h"][-1, 0], [26.67, 22.86], atol=0.05)


def test_a_single_arm_with_lambda_M_follows_and_lets_the_hand_rest() -> None:
    """Sec. VII-A with lambda_M = 6."""
    values = {"alpha": np.array(2.0), "lambda_M": np.array(6.0), "Gamma": np.full(3, 8.0)}
    run = closed([arm(**GRIP)], [controller(**values)], 20.0)
    assert last_outside(run["q"] - Q_H) == pytest.approx(5.8, abs=0.3)
    assert effort(run["tau_h"]) == pytest.approx(46.0, rel=0.02)
    assert run["q"][:, 0, 0].max() == pytest.approx(4.62, abs=0.05)
    assert np.abs(run["tau_h"][-1]).max() < 0.01


def test_what_the_damping_takes_is_what_the_errors_lose() -> None:
    """V = Σ (s' M s + (theta_hat - theta)' Gamma^-1 (theta_hat - theta)) / 2, dV/dt = -Σ s' K s."""
    theta = np.array(planar2r.PRESETS["SL91"]["theta"])
    run = closed([arm(q=Q1), arm(q=Q2)], [controller(), controller()], 8.0)
    V = np.zeros(len(run["q"]))
    for i in range(2):
        M = np.array([inertia(theta, q) for q in run["q"][:, i]])
        s, error = run["s"][:, i], run["theta_hat"][:, i] - theta
        V += 0.5 * np.einsum("ki,kij,kj->k", s, M, s) + 0.5 * (error**2).sum(axis=1)
    assert V[0] - V[-1] == pytest.approx(16 * (run["s"] ** 2).sum() * H, rel=0.05)
    assert np.diff(V).max() < 1e-5 * V[0]
