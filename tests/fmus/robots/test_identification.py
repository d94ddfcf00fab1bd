"""Base parameters of arms: found in runs, within their intervals; what cannot be found."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cosim.base.errors import RunError
from fmus.models import chain
from fmus.models.chain import Table
from fmus.numeric import Array
from fmus.robots.identification import Identified, _long_run, base, columns, identified, names
from fmus.robots.serial import serial
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
    assert _long_run(same) == pytest.approx(3.0 + 2.0 * (2.0 * 2.0 / 3.0 + 1.0 / 3.0))
    assert _long_run(turning) == pytest.approx(3.0 - 2.0 * (2.0 * 2.0 / 3.0 - 1.0 / 3.0))
