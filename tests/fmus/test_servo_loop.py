"""Arms behind servos, in closed loop: what the laws for them promise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from cosim.base.component import Component
from cosim.base.copies import replace
from fmus.arms import chain
from fmus.arms.chain import Table
from fmus.arms.dynamics import inertia
from fmus.models import arm, arm_velocity, planar2r, servo, servo_command
from tests.fmus.chains import planar, random_chain
from tests.fmus.loops import SL91, arrays

pytestmark = pytest.mark.usefixtures("compiled_once")
#: Servos of unlike gains, a step so short that sampling does not matter, and gains of the law.
K_V, H = np.array([6.0, 3.0, 8.0]), 2e-4
LAW = {"alpha": 0.5, "lambda": 0.0, "lambda_M": 4.0}


def behind_servos(plant: Component, law: Component, n: int, steps: int) -> dict[str, np.ndarray]:
    """Signals of an arm that starts with a velocity and that nothing pushes, (steps, ...)."""
    inner = servo.kernel(joints=n)
    inner.initialize({"K_v": K_V[:n]})
    moved = plant.initial({})
    still = {name: np.zeros(n) for name in ("clamped",)}
    network = {"xi_in": np.zeros((1, n)), "w": np.zeros(1), "age": np.zeros(1)}
    motion = {"q": np.array(moved["q"]), "dq": np.array(moved["dq"])}
    law.initial(motion | still | network)
    inner.initial(motion | {"q_c": np.zeros(n), "dq_c": np.zeros(n)})
    rows: dict[str, list[np.ndarray]] = {}
    for k in range(steps):
        given = law.step(k * H, H, motion | still | network)
        for name, value in {**motion, **given}.items():
            rows.setdefault(name, []).append(np.array(value))
        command = {name: np.array(given[name]) for name in ("q_c", "dq_c")}
        tau = inner.step(k * H, H, motion | command)["tau"]
        moved = plant.step(k * H, H, {"tau": np.array(tau)})
        motion = {"q": np.array(moved["q"]), "dq": np.array(moved["dq"])}
    return {name: np.array(values) for name, values in rows.items()}


def check_lyapunov(
    run: dict[str, np.ndarray],
    table: Table,
    M: Callable[[np.ndarray], np.ndarray],
    gains: dict[str, np.ndarray],
    friction: np.ndarray,
) -> None:
    """V of the module `arm_velocity`, and its decrease by s' (K_v + D) s, both within 1 %."""
    n, s = len(friction), run["s"]
    K_v = K_V[:n]
    wrong = K_v[:, None, None] * run["theta_hat"] - table.inertia[None, None]
    own_true = np.stack([table.armature, friction], axis=1)
    own = K_v[:, None] * run["own_hat"] - own_true
    rows = np.triu(np.ones((n, n)))[..., None]  # the copies that act
    per = gains["Gamma_row"][:, None, None] * gains["Gamma"][None] * K_v[:, None, None]
    active = rows * (gains["Gamma"] > 0)[None]
    kinetic = np.array([x @ M(q) @ x for q, x in zip(run["q"], s, strict=True)])
    estimates = (active * wrong**2 / np.where(per > 0, per, 1.0)).sum(axis=(1, 2, 3))
    by_own = (own**2 / (gains["Gamma_own"] * K_v[:, None])).sum(axis=(1, 2))
    V = (kinetic + estimates + by_own) / 2
    power = (s**2 * (K_v + friction)).sum(axis=1)
    lost = np.concatenate([[0.0], np.cumsum(H * (power[1:] + power[:-1]) / 2)])
    assert lost[-1] > 0.2 * kinetic[0] / 2  # much of the motion is over
    assert np.ptp(estimates) > 1e-2 * lost[-1]  # the estimates take part
    assert V - V[0] == pytest.approx(-lost, abs=0.01 * lost[-1])
    assert (np.diff(V[::25]) < 1e-4 * lost[-1]).all()


def rates(n: int) -> dict[str, np.ndarray]:
    return {
        "Gamma": np.tile([5.0, *[1.0] * 3, *[0.5] * 6], (n, 1)),
        "Gamma_row": np.array([0.2, 0.5, 0.1])[:n],
        "Gamma_own": np.full((n, 2), 0.3),
    }


def test_the_function_of_lyapunov_falls_for_the_planar_arm() -> None:
    """planar2r behind unlike servos; the law knows its lengths only."""
    table, gains = planar(SL91, np.zeros(2)), rates(2)
    plant = planar2r.kernel()
    plant.initialize(arrays(theta=SL91, q=[0.3, -0.8], dq=[1.0, -1.5]))
    law = arm_velocity.kernel(joints=2)
    geometry = {k: v for k, v in table.values().items() if k != "inertia"}
    law.initialize(arrays(**LAW) | gains | geometry)
    run = behind_servos(plant, law, 2, 5000)
    check_lyapunov(run, table, lambda q: inertia(SL91, q), gains, np.zeros(2))


def test_the_function_of_lyapunov_falls_for_any_arm_with_rotors_and_friction() -> None:
    draw = np.random.default_rng(11)
    table = replace(random_chain(draw, 3), armature=np.array([0.1, 0.05, 0.2]))
    friction, gains = np.array([0.3, 0.1, 0.2]), rates(3)
    still = {"g": np.zeros(3)}
    plant = arm.kernel(joints=3)
    start = arrays(q=[0.2, 0.1, -0.4], dq=[1.0, -0.7, 1.2])
    plant.initialize(table.values() | still | start | {"damping": friction})
    law = arm_velocity.kernel(joints=3)
    law.initialize(arrays(**LAW) | gains | table.values() | still)
    run = behind_servos(plant, law, 3, 5000)
    check_lyapunov(run, table, lambda q: chain.mass_matrix(table, q), gains, friction)


# ---- the period of the commands -----------------------------------------------------------------


@pytest.mark.parametrize("x", [0.2, 1.0, 3.0])
@pytest.mark.parametrize("late", [0, 20])
def test_a_servo_resists_like_inertia_until_the_next_command(x: float, late: int) -> None:
    """K_v T (1 + exp(K_v d/M)/(exp(x) - 1)), x = K_v T/M, under a constant torque."""
    M, T, h = 0.5, 4e-3, 1e-4
    K_v, tau, every = x * M / T, 1.0, round(T / h)
    command, inner = servo_command.kernel(joints=1), servo.kernel(joints=1)
    command.initialize(arrays(K_v=[K_v]))
    inner.initialize(arrays(K_v=[K_v]))
    q, dq, waiting = np.zeros(1), np.zeros(1), [0.0] * late
    zero = np.zeros(1)
    command.initial({"q": q, "dq": dq, "tau": zero, "clamped": zero})
    inner.initial({"q": q, "dq": dq, "q_c": zero, "dq_c": zero})
    speeds = []
    for k in range(40 * every):
        if k % every == 0:
            u = {"q": q, "dq": dq, "tau": np.array([tau]), "clamped": zero}
            given = float(command.step(k * h, T, u)["dq_c"][0])
            speeds.append(float(dq[0]))
        waiting.append(given)
        u = {"q": q, "dq": dq, "q_c": zero, "dq_c": np.array([waiting.pop(0)])}
        torque = float(inner.step(k * h, h, u)["tau"][0])
        dq = dq + h * torque / M
        q = q + h * dq
    felt = tau * (len(speeds) // 2) * T / (speeds[-1] - speeds[-1 - len(speeds) // 2])
    expected = K_v * T * (1 + np.exp(K_v * late * h / M) / np.expm1(x))
    assert felt == pytest.approx(expected, rel=0.02)
