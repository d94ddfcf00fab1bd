"""Robots that take positions or velocities: the servo, the commands to it, and their laws."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.base.component import Component
from cosim.base.errors import CosimError
from fmus.arms import chain
from fmus.arms.chain_law import regressor
from fmus.models import arm_velocity, kinematic, servo, servo_command
from tests.fmus.test_arm_teleoperation import values_of

H = 1e-3
N = 3
pytestmark = pytest.mark.usefixtures("compiled_once")
GAINS = {"K_v": [20.0, 5.0, 1.0], "K_p": [40.0, 0.0, 3.0], "K_i": [4.0, 0.0, 1.0]}
LIMITS = {"v_max": [1.0, 0.4, 2.0], "a_max": [20.0, 5.0, 1e9], "tau_max": [8.0, 2.0, 1e9]}


def values(**given: object) -> dict[str, np.ndarray]:
    return {name: np.array(value, dtype=float) for name, value in given.items()}


def inputs(component: Component, steps: int, seed: int, *, signs: bool = True) -> list[dict]:
    """Random inputs; `clamped` is -1, 0 or 1."""
    draw = np.random.default_rng(seed)
    rows = []
    for _ in range(steps):
        row = {p.name: draw.normal(0.0, 1.0, p.shape) for p in component.inputs}
        row |= {n: np.abs(row[n]) for n in ("w", "age") if n in row}
        if "clamped" in row:
            sign = draw.integers(-1, 2, N) * (draw.random() < 0.3)
            row["clamped"] = sign.astype(float) if signs else np.zeros(N)
        rows.append(row)
    return rows


def both(reference: Component, in_c: Component, given: dict, steps: int = 60) -> None:
    """Every output of the NumPy reference and of the C code, step by step."""
    u = inputs(reference, steps, 5)
    for component in (reference, in_c):
        component.initialize(given)
    seen = [(reference.initial(u[0]), in_c.initial(u[0]))]
    seen += [(reference.step(k * H, H, x), in_c.step(k * H, H, x)) for k, x in enumerate(u)]
    for a, b in seen:
        for name in a:
            assert np.allclose(a[name], b[name], rtol=1e-12, atol=1e-12), name


# ---- parity -------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", [0, 1])
@pytest.mark.parametrize("limits", [{}, LIMITS])
def test_servo_in_c_is_the_reference(mode: int, limits: dict) -> None:
    given = values(mode=mode, feed_forward=0.7, T_c=0.0035, **GAINS, **limits)
    both(servo.Servo(joints=N), servo.kernel(joints=N), given)


@pytest.mark.parametrize("mode", [0, 1])
def test_commands_in_c_are_the_reference(mode: int) -> None:
    limits = {name: LIMITS[name] for name in ("v_max", "a_max")}
    given = values(mode=mode, feed_forward=0.7, **GAINS, **limits)
    made = servo_command.ServoCommand(joints=N), servo_command.kernel(joints=N)
    both(*made, given)


def test_kinematic_in_c_is_the_reference() -> None:
    given = values(alpha=0.5, lambda_M=4.0, b=[0.5, 0.0, 2.0], v_max=[1.0, 0.5, 1e9],
                   age_max=1.0, age_fade=0.5) | {"lambda": np.array(2.0)}  # fmt: skip
    made = (make(joints=N, neighbours=2) for make in (kinematic.Kinematic, kinematic.kernel))
    both(*made, given)


@pytest.mark.parametrize("gravity", [0, 2])
def test_adaptive_velocities_in_c_are_the_reference(gravity: int) -> None:
    both(
        arm_velocity.ArmVelocity(joints=N),
        arm_velocity.kernel(joints=N),
        adaptive_values(gravity) | {"v_max": np.array([50.0, 3.0, 1e9])},
    )


def adaptive_values(gravity: int) -> dict[str, np.ndarray]:
    """A random arm with a prismatic joint or two, and estimates that are not 0."""
    draw = np.random.default_rng(7)
    declared = {p.name for p in arm_velocity.ArmVelocity(joints=N).parameters}
    drawn = values_of(N, draw, gravity=gravity)
    table = {k: v for k, v in drawn.items() if k in declared and k not in ("theta_hat", "tau_max")}
    return table | {
        "theta_hat": draw.normal(0.0, 0.1, (N, N, 10)),
        "own_hat": draw.normal(0.0, 0.1, (N, 2)),
        "Gamma_row": draw.uniform(0.0, 0.2, N),
        "gravity": np.array(float(gravity)),
    }


# ---- the servo ----------------------------------------------------------------------------------


def test_a_position_command_is_a_line_that_ends_there() -> None:
    """Four steps to q_c, each with the velocity of the line; then the reference rests."""
    made = servo.kernel(joints=1)
    made.initialize(values(mode=1, K_v=[2.0], K_p=[30.0], T_c=0.004))
    u = {name: np.zeros(1) for name in ("q", "dq", "dq_c")} | {"q_c": np.array([0.02])}
    made.initial(u | {"q_c": np.zeros(1)})
    seen = [made.step(k * H, H, u) for k in range(7)]
    q_r, dq_r, tau = (np.array([y[n][0] for y in seen]) for n in ("q_r", "dq_r", "tau"))
    assert q_r == pytest.approx([0.0, 0.005, 0.01, 0.015, 0.02, 0.02, 0.02], abs=1e-15)
    assert dq_r == pytest.approx([5.0] * 4 + [0.0] * 3, abs=1e-12)
    assert tau == pytest.approx(2.0 * dq_r + 30.0 * q_r, abs=1e-11)
    assert not any(y["clamped"][0] for y in seen)


def test_limits_are_kept_and_said_with_their_sign() -> None:
    made = servo.kernel(joints=2)
    limits = {"v_max": [0.5, 5.0], "a_max": [100.0, 1e9], "tau_max": [9.0, 1.0]}
    made.initialize(values(K_v=[10.0, 1.0], **limits))
    rest = {"q": np.zeros(2), "dq": np.zeros(2), "q_c": np.zeros(2)}
    made.initial(rest | {"dq_c": np.zeros(2)})
    seen = [made.step(k * H, H, rest | {"dq_c": np.array([2.0, -3.0])}) for k in range(8)]
    assert [y["dq_r"][0] for y in seen[:6]] == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, 0.5])
    assert all(list(y["clamped"]) == [1.0, -1.0] for y in seen)
    assert all(y["tau"][1] == -1.0 for y in seen)
    after = made.step(0.008, H, rest | {"dq_c": np.array([0.5, 0.0])})
    assert list(after["clamped"]) == [0.0, 0.0]


def test_a_reference_that_is_limited_arrives_late_and_rests() -> None:
    """A command that jumps by 10 mrad, then stands still: no swing remains of the limits."""
    made = servo.kernel(joints=1)
    made.initialize(values(mode=1, v_max=[0.5], a_max=[60.0], T_c=0.004))
    u = {name: np.zeros(1) for name in ("q", "dq", "dq_c")} | {"q_c": np.array([0.01])}
    made.initial(u | {"q_c": np.zeros(1)})
    seen = [made.step(k * H, H, u) for k in range(1000)]
    q_r, dq_r = (np.array([y[name][0] for y in seen]) for name in ("q_r", "dq_r"))
    assert np.abs(dq_r).max() == pytest.approx(0.5)
    assert np.abs(np.diff(dq_r)).max() < 60.0 * H * (1 + 1e-9)
    assert np.abs(q_r[-300:] - 0.01).max() < 1e-9 and np.abs(dq_r[-300:]).max() < 1e-6
    assert not seen[-1]["clamped"].any()


def test_a_limited_torque_does_not_wind_up_the_integral() -> None:
    """A blocked joint in velocity mode: when the command ends, the torque is not what piled up."""
    made = servo.kernel(joints=1)
    made.initialize(values(K_v=[10.0], K_p=[100.0], tau_max=[5.0]))
    blocked = {"q": np.zeros(1), "dq": np.zeros(1), "q_c": np.zeros(1)}
    made.initial(blocked | {"dq_c": np.zeros(1)})
    for k in range(2000):
        made.step(k * H, H, blocked | {"dq_c": np.array([0.4])})
    after = made.step(2.0, H, blocked | {"dq_c": np.zeros(1)})
    assert 0.0 < after["tau"][0] < 1.2  # what is missing to 5 N.m beside K_v dq_c, and no more


# ---- torques by commands ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mode", "K_p", "f"), [(0, 0.0, 1.0), (0, 60.0, 1.0), (1, 60.0, 1.0), (1, 60.0, 0.0)]
)
def test_a_mass_moves_under_commands_as_under_the_torque(mode: int, K_p: float, f: float) -> None:
    """tau(t) on 2 kg.m2 by way of a servo whose command comes with it: to a percent at 1 kHz."""
    M, T = 2.0, 1e-3
    given = values(mode=mode, K_v=[20.0], K_p=[K_p], feed_forward=f)
    command = servo_command.kernel(joints=1)
    inner = servo.kernel(joints=1)
    command.initialize(given)
    inner.initialize(given | {"T_c": np.array(T)})
    state, free = np.zeros(2), np.zeros(2)
    zero = {"tau": np.zeros(1), "clamped": np.zeros(1), "q": np.zeros(1), "dq": np.zeros(1)}
    command.initial(zero)
    inner.initial({"q": np.zeros(1), "dq": np.zeros(1), "q_c": np.zeros(1), "dq_c": np.zeros(1)})
    worst = 0.0
    for k in range(4000):
        t = k * T
        tau = 3.0 * np.sin(4.0 * t)
        motion = {"q": state[:1], "dq": state[1:]}
        y = command.step(t, T, motion | {"tau": np.array([tau]), "clamped": np.zeros(1)})
        y = {name: np.asarray(value) for name, value in y.items()}
        given_tau = float(inner.step(t, T, motion | y)["tau"][0])
        for body, torque in ((state, given_tau), (free, tau)):
            body[1] += T * torque / M
            body[0] += T * body[1]
        worst = max(worst, abs(state[1] - free[1]))
    assert worst < 0.02 * 2 * 3.0 / (4.0 * M)
    assert np.abs(free[0]) > 1.0


def test_commands_that_move_nothing_are_refused() -> None:
    for make in (servo_command.ServoCommand, servo_command.kernel):
        component = make(joints=N)
        with pytest.raises(CosimError, match="both 0"):
            component.initialize(values(mode=1, feed_forward=0.0, K_p=[1.0, 0.0, 1.0]))
            component.initial(inputs(component, 1, 1)[0])


# ---- laws ---------------------------------------------------------------------------------------


def test_a_kinematic_law_is_not_stuck_at_a_limit() -> None:
    """z beyond what the servo allows: it does not grow, and falls when the coupling asks for it."""
    made = kinematic.kernel(joints=1)
    made.initialize(values(alpha=0.5, lambda_M=2.0) | {"z": np.array([3.0])})
    u = {
        "q": np.zeros(1), "dq": np.array([1.0]), "tau_m": np.zeros(1), "age": np.zeros(1),
        "w": np.ones(1), "xi_in": np.array([[50.0]]), "clamped": np.ones(1),
    }  # fmt: skip
    made.initial(u)
    seen = [float(made.step(k * H, H, u)["z"][0]) for k in range(20)]
    assert set(seen) == {3.0}
    back = [float(made.step(k * H, H, u | {"xi_in": np.zeros((1, 1))})["z"][0]) for k in range(20)]
    assert back[-1] < 2.95


def test_rows_of_the_estimate_are_those_of_the_regressor() -> None:
    """With the true parameters over K_v, the command is z and the inverse dynamics over K_v."""
    x = adaptive_values(2)
    K_v = np.array([3.0, 7.0, 11.0])
    table = chain.of_values(x)
    x["theta_hat"] = np.array([table.inertia / k for k in K_v])
    x["own_hat"] = np.stack([table.armature / K_v, np.zeros(N)], axis=1)
    law = arm_velocity.kernel(joints=N)
    law.initialize(x)
    u = inputs(law, 1, 3, signs=False)[0]
    law.initial(u)
    y = law.step(0.0, H, u)
    z, xi = np.asarray(y["z"]), np.asarray(y["xi"])
    pull = 2.0 * (u["w"][0] * (xi - u["xi_in"][0]))
    dz = -0.5 * u["dq"] + 10.0 * np.asarray(y["s"]) - pull
    Y = regressor(table, u["q"], u["dq"], z, dz, table.g).reshape(N, -1)
    wanted = z + (Y @ table.inertia.ravel() + table.armature * dz) / K_v
    assert np.asarray(y["dq_c"]) == pytest.approx(wanted, rel=1e-10, abs=1e-10)


def test_an_estimate_from_a_file_is_refused_since_the_gains_are_not_known() -> None:
    file = {"urdf": "six_axis.urdf", "base": "link0", "tip": "link6", "estimate": 0.5}
    with pytest.raises(CosimError, match="over gains that are not known"):
        arm_velocity.prepare(file, Path(__file__).parents[2] / "configs" / "robots")
