"""Base parameters of arms: found in runs, within their intervals; what cannot be found."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cosim.base.errors import RunError
from fmus.arms import chain
from fmus.arms.chain import Table
from fmus.arms.estimation import MeasuredTorques, estimate, long_run
from fmus.arms.identification import NEAR, Identified, base, columns, identified, names
from fmus.arms.serial import serial
from fmus.model.numeric import Array
from tests.cli.command import Command
from tests.cli.conftest import cosim as cosim  # the command as a fixture

ROBOTS = Path(__file__).parents[3] / "configs" / "robots"
SCENARIO = """
[run]
step = "2 ms"
stop = "{stop} s"
[components.arm]
model = "fmus.models.arm"
sizes.joints = {joints}
parameters = {{ g = [0.0, -9.81, 0.0], armature = 0.02, damping = 0.4, friction = 0.3 }}
inputs.tau = "control.tau"
[components.encoder]
model = "fmus.models.encoder"
sizes.joints = {joints}
preset = "14-bit"
parameters.T = "4 ms"
inputs.q = "arm.q"
[components.control]
model = "fmus.models.pd"
sizes.joints = {joints}
parameters = {{ K_p = 80.0, K_d = 4.0 }}
[components.control.inputs]
q = "encoder.q_m"
dq = "encoder.dq_m"
"""


def scenario(joints: int, stop: float, seed: int) -> str:
    """An arm in a vertical plane that follows sums of sines, with encoders of 14 bits."""
    t, random = np.arange(0.0, stop + 0.02, 0.02), np.random.default_rng(seed)
    text = SCENARIO.format(joints=joints, stop=stop)
    for j in range(joints):
        a, b = random.standard_normal((2, 8))
        k = np.arange(1, 9)
        angle = np.multiply.outer(t, k) * 2 * np.pi / stop
        x = (np.sin(angle) * a / k + (np.cos(angle) - 1) * b / k).sum(axis=1)
        points = np.column_stack([t, 1.5 * x / np.abs(x).max()]).round(6).tolist()
        text += f'"q_j[{j}]" = {{ points = {points}, interpolate = "linear" }}\n'
    return text


def share_inside(data: list[dict[str, float]], times: float = 1.0) -> float:
    inside = [abs(p["value"] - p["scenario"]) <= times * p["interval_95"] for p in data]
    return sum(inside) / len(inside)


def test_parameters_of_a_run_are_found_within_their_intervals(
    cosim: Command, tmp_path: Path
) -> None:
    (tmp_path / "arm.toml").write_text(scenario(2, 8.0, 0))
    assert cosim("run", "arm.toml", "--no-plot", "--out", "run", "-q").code == 0
    done = cosim("identify", "run", "--component", "arm", "--q", "encoder.q_m",
                 "--json", "found.json")  # fmt: skip
    assert done.code == 0, done.err
    assert "11 base parameters" in done.out and "(exciting)" in done.out
    data = json.loads((tmp_path / "found.json").read_text())
    parameters = data["parameters"]
    assert share_inside(parameters) >= 0.9 and share_inside(parameters, 1.5) == 1.0
    by_name = {next(iter(p["factors"])): p for p in parameters}
    assert by_name["Izz[0]"]["factors"] == pytest.approx(
        {"Izz[0]": 1.0, "m[1]": 0.09, "armature[0]": 1.0}
    )
    for name, size in (("mx[1]", 0.15), ("damping[0]", 0.4), ("friction[1]", 0.3)):
        assert by_name[name]["scenario"] == pytest.approx(size)
        assert by_name[name]["interval_95"] < 0.05 * size
    assert "m[0]" in data["without_effect"] and "mz[1]" in data["without_effect"]
    done = cosim("identify", "run", "--component", "control")
    assert done.code == 2 and "control is no fmus.models.arm" in done.err
    assert cosim("identify", "run", "--component", "arn").code == 2


@pytest.mark.slow
def test_intervals_hold_as_often_as_they_say(cosim: Command, tmp_path: Path) -> None:
    every = []
    for seed in range(6):
        (tmp_path / "arm.toml").write_text(scenario(3, 20.0, seed))
        assert cosim("run", "arm.toml", "--no-plot", "--out", f"run{seed}", "-q").code == 0
        cosim("identify", f"run{seed}", "--component", "arm", "--q", "encoder.q_m",
              "--json", "found.json", "-q")  # fmt: skip
        every += json.loads((tmp_path / "found.json").read_text())["parameters"]
    assert len(every) > 80 and share_inside(every) > 0.9 and share_inside(every, 0.7) < 1.0


def openarm() -> Table:
    return serial(ROBOTS / "openarm_right.urdf", "body", "hand").table


def test_base_parameters_explain_every_motion_of_openarm() -> None:
    table, v_f = openarm(), np.full(7, 0.1)
    chosen, others, K = base(table, v_f)
    q, dq, ddq = np.random.default_rng(5).uniform(-2.0, 2.0, (3, 7))
    Y = columns(table, v_f, q, dq, ddq)
    assert Y[:, others] == pytest.approx(Y[:, chosen] @ K, abs=1e-8)
    zero = np.setdiff1d(np.arange(91), [*chosen, *others])
    assert not np.abs(Y[:, zero]).max(initial=0.0) > 1e-12
    torque = chain.inverse(table, q, dq, ddq)
    assert Y[:, :70] @ table.inertia.ravel() == pytest.approx(torque, abs=1e-10)


def two_joints(seconds: float, still: bool = False, bend: float = 0.0) -> Identified:
    """An arm of two rods without errors; `still`: its second joint does not move."""
    n, rod = 2, (1.0, 0.15, 0.0, 0.0, 0.0005, 0.0, 0.03025, 0.0, 0.0, 0.03025)
    table = Table(
        np.zeros(n), np.array([np.eye(3)] * n), np.array([[0.0] * 3, [0.3, 0.0, 0.0]]),
        np.array([rod] * n), np.zeros(n), np.array([0.0, -9.81, 0.0]),
    )  # fmt: skip
    theta = np.concatenate([table.inertia.ravel(), [0.01, 0.02], [0.4, 0.3], [0.1, 0.2]])
    t = np.arange(0.0, seconds, 0.005)
    w = np.array([2.0, 3.1])
    size = np.array([1.0, 0.0 if still else 0.8])
    v_f = np.full(n, 0.1)

    def at(phase: Array) -> Array:
        q, dq = size * np.sin(phase), size * w * np.cos(phase)
        return np.asarray(columns(table, v_f, q, dq, -(w**2) * q) @ theta)

    phases = np.multiply.outer(t, w)
    tau = np.array([at(phase) for phase in phases])
    times = t + bend * t**2
    return identified(table, theta, v_f, (times, size * np.sin(phases), tau), 5.0)


def test_motion_without_errors_gives_the_parameters_and_says_what_it_does_not_show() -> None:
    found = two_joints(5.0)
    assert not found.unexcited and found.condition < 100.0
    for p in found.parameters:
        assert p.value == pytest.approx(p.before, abs=3e-3), p
    still = two_joints(5.0, still=True)
    assert {"damping[1]", "friction[1]", "armature[1]"} <= set(still.unexcited)
    assert {"damping[0]", "friction[0]"} <= {next(iter(p.factors)) for p in still.parameters}


def test_recordings_that_cannot_be_used_are_refused() -> None:
    with pytest.raises(RunError, match=r"expected 1\.2 s or more"):
        two_joints(1.0)
    with pytest.raises(RunError, match="not equally spaced"):
        two_joints(4.0, bend=0.1)


def test_every_parameter_has_a_name_and_a_unit() -> None:
    every, units = names(3)
    assert len(every) == len(units) == 39
    assert dict(zip(every, units, strict=True))["Iyz[2]"] == "kg.m2"
    assert every[30:] == tuple(f"{k}[{i}]" for k in ("armature", "damping", "friction")
                               for i in range(3))  # fmt: skip


def test_errors_of_neighbouring_values_widen_the_intervals() -> None:
    same, turning = np.ones((3, 1)), np.array([[1.0], [-1.0], [1.0]])
    assert long_run(same) == pytest.approx(3.0 + 2.0 * (2.0 * 2.0 / 3.0 + 1.0 / 3.0))
    assert long_run(turning) == pytest.approx(3.0 - 2.0 * (2.0 * 2.0 / 3.0 - 1.0 / 3.0))


def recorded(seed: int, noise: float = 0.05, memory: float = 0.0) -> MeasuredTorques:
    """Torques of two joints with four parameters, all 1, one in 0.08 s, and their errors.

    `noise`: N.m; `memory`: how long it is correlated, s.
    """
    t, rng = 0.08 * np.arange(250), np.random.default_rng(seed)
    w = 2 * np.pi * np.array([0.1, 0.23, 0.37, 0.59])
    shift = 0.7 * np.arange(4)
    x = np.cos(np.multiply.outer(t, w) + shift)
    rate = -w * np.sin(np.multiply.outer(t, w) + shift)
    W, dW = np.zeros((250, 2, 4)), np.zeros((250, 2, 4))
    W[:, 0, :3], dW[:, 0, :3] = x[:, :3], rate[:, :3]
    W[:, 1, 1:], dW[:, 1, 1:] = x[:, 1:], rate[:, 1:]
    e = rng.normal(size=(250, 2))
    if memory:
        a = np.exp(-0.08 / memory)
        for k in range(1, 250):
            e[k] = a * e[k - 1] + np.sqrt(1 - a * a) * e[k]
    slow = np.sin(np.multiply.outer(t, [3.0, 4.0]))
    return MeasuredTorques(W, W.sum(axis=2) + noise * e, dW, slow[:, :, None], 0.08)


@pytest.mark.parametrize("memory", [0.0, 0.5, 2.0])
def test_intervals_hold_with_noise_that_is_correlated(memory: float) -> None:
    inside = 0
    for seed in range(40):
        found = estimate(recorded(seed, memory=memory))
        inside += int(np.sum(np.abs(found.value - 1.0) <= found.interval))
    assert inside >= 144  # of 160: 90 %
    assert (found.memory > 0.2).all() == bool(memory)


def test_errors_that_are_no_noise_are_found_and_estimated() -> None:
    """A drive whose torque is recorded 3 % too large, and torques recorded 8 ms late."""
    inside, gains, delays = 0, 0, 0
    for seed in range(20):
        data = recorded(seed, 0.02)
        large = data.torque * np.array([1.0, 1.03])
        found = estimate(MeasuredTorques(data.W, large, data.rate, data.slow, 0.08))
        inside += int(np.sum(np.abs(found.value - 1.0) <= 1.05 * found.interval))
        for trace in found.traces:
            gains += trace.kind == "gain" and abs(abs(trace.value) - 0.03) <= 2 * trace.interval
        late = data.torque - 0.008 * data.rate.sum(axis=2)
        found = estimate(MeasuredTorques(data.W, late, data.rate, data.slow, 0.08))
        inside += int(np.sum(np.abs(found.value - 1.0) <= 1.05 * found.interval))
        for trace in found.traces:
            delays += trace.kind == "late" and abs(trace.value - 0.008) <= 2 * trace.interval
    assert delays >= 36 and gains >= 18, (delays, gains)
    assert inside >= 136, inside  # of 160


def test_a_trace_is_said_in_words() -> None:
    data = recorded(0, 0.02)
    late = MeasuredTorques(data.W, data.torque - 0.008 * data.rate.sum(axis=2), data.rate,
                           data.slow, 0.08)  # fmt: skip
    said = " ".join(trace.text for trace in estimate(late).traces)
    assert "joint 0: the torque was recorded" in said and "ms late" in said


@pytest.mark.parametrize(("joint", "more"), [(0, 0.06), (1, -0.06)])
def test_friction_that_differs_near_standstill_is_named(joint: int, more: float) -> None:
    """In nearly each recording with it, for its joint, and in hardly one without."""
    named, wrong, n = 0, 0, 30
    for seed in range(n):
        data = recorded(seed)
        torque = data.torque.copy()
        torque[:, joint] += more * data.slow[:, joint, 0]
        found = estimate(MeasuredTorques(data.W, torque, data.rate, data.slow, 0.08))
        for trace in (t for t in found.traces if t.kind == "slow"):
            named += trace.joint == joint and abs(trace.value - more) <= 2 * trace.interval
            assert "friction near standstill differs by" in trace.text
        wrong += any(t.kind == "slow" for t in estimate(data).traces)
    assert named >= 27 and wrong <= 3, (named, wrong)


@pytest.mark.parametrize(("speed", "more"), [(0.14, 0.1), (0.3, 0.1), (0.5, 0.2), (0.3, -0.1)])
def test_friction_of_stribeck_leaves_the_truth_in_the_intervals(speed: float, more: float) -> None:
    """A joint has inertia, damping and friction, each 1; `more` friction, N.m, reaches up to
    another `speed`, rad/s, than those that are tried, and is named in each recording.
    """
    t, v_f, named, inside = 0.08 * np.arange(250), 0.1, 0, 0
    near = NEAR * v_f
    for seed in range(12):
        rng = np.random.default_rng(seed)
        w = 2 * np.pi * np.array([1, 3, 5, 9, 16]) / 20.0
        phase, size = rng.uniform(0.0, 6.0, 5), rng.uniform(0.2, 0.6, 5)
        v = (size * np.sin(np.multiply.outer(t, w) + phase)).sum(axis=1)
        a = (size * w * np.cos(np.multiply.outer(t, w) + phase)).sum(axis=1)
        W = np.stack([a, v, np.tanh(v / v_f)], axis=1)[:, None, :]
        slow = np.tanh(v / v_f)[:, None] * np.exp(-((v[:, None] / near) ** 2))
        torque = W.sum(axis=2) + 0.02 * rng.normal(size=(250, 1))
        torque[:, 0] += more * np.tanh(v / v_f) * np.exp(-((v / speed) ** 2))
        rate = np.gradient(W, 0.08, axis=0)
        found = estimate(MeasuredTorques(W, torque, rate, slow[:, None, :], 0.08))
        inside += int(np.sum(np.abs(found.value - 1.0) <= found.interval))
        named += any(trace.kind == "slow" for trace in found.traces)
        assert (found.interval < 0.5).all()
    assert (named, inside >= 31) == (12, True), (named, inside)  # 86 % of 36
