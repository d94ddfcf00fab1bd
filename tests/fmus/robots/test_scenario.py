"""A scenario that names a robot: two arms from a URDF file, coupled in joint space."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from cosim.base.errors import ScenarioError
from cosim.engine.simulate import simulate
from cosim.loading.files import load
from cosim.record import Run
from cosim.scenario.assemble import assemble
from cosim.schedule.plan import Plan
from fmus.arms import chain
from fmus.arms.serial import serial
from fmus.models import pd
from tests.fmus.robots import files

SCENARIO = """
run = { step = "1 ms", stop = "0.3 s" }

[components.master]
model = "fmus.models.arm"
options = { urdf = "robots/robot.urdf", base = "body", tip = "tcp" }
parameters = { armature = 0.01, damping = 0.4 }
start.q = [0.3, 0.5, -0.4, 0.9, 0.2, -0.3, 0.4]
inputs.tau = "master_control.tau"

[components.slave]
model = "fmus.models.arm:kernel"
options.urdf = "robots/robot.urdf"
options.base = "body"
options.tip = "tcp"
options.payload = { mass = "500 g", centre = [0.0, 0.0, "5 cm"] }
parameters = { armature = 0.01 }
inputs.tau = "slave_control.tau"

[components.master_control]
model = "fmus.models.pd"
sizes = { joints = 7 }
inputs = { q = "master.q", dq = "master.dq", q_j = "slave.q", dq_j = "slave.dq" }

[components.slave_control]
model = "fmus.models.pd"
sizes = { joints = 7 }
inputs = { q = "slave.q", dq = "slave.dq", q_j = "master.q", dq_j = "master.dq" }
"""


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenario")
    (folder / "robots").mkdir()
    files.openarm(folder / "robots")
    (folder / "two.toml").write_text(SCENARIO)
    return folder / "two.toml"


def values(plan: Plan, name: str) -> dict[str, np.ndarray]:
    (step,) = (step for step in plan.components if step.name == name)
    return {key: np.array(value) for key, value in step.values.items()}


def test_two_arms_of_seven_joints_are_coupled(scenario: Path, tmp_path: Path) -> None:
    simulate(load(scenario), tmp_path / "run")
    run = Run.open(tmp_path / "run")
    q = run.array("master.q"), run.array("slave.q")
    assert q[0].shape == q[1].shape == (301, 7)
    assert np.abs(q[0][-1] - q[1][-1]).max() < 0.5 * np.abs(q[0][0] - q[1][0]).max()
    robot = scenario.parent / "robots" / "robot.urdf"
    written = json.loads((tmp_path / "run" / "run.json").read_text())["files"]
    assert written == {str(robot): hashlib.sha256(robot.read_bytes()).hexdigest()}


def test_the_robot_gives_the_table_and_the_scenario_the_rest(scenario: Path) -> None:
    plan = assemble(load(scenario))
    master, slave = values(plan, "master"), values(plan, "slave")
    robot = serial(scenario.parent / "robots" / "robot.urdf", "body", "tcp")
    for name, value in robot.table.values().items():
        assert np.array_equal(master[name], value.ravel()) or name == "armature"
    assert master["q_max"][1] == 3.316125
    assert set(master["damping"]) == {0.4}  # of the scenario
    assert master["armature"][0] == 0.01
    differing = [name for name in slave if not np.array_equal(slave[name], master.get(name))]
    assert differing == ["inertia", "damping"]
    assert slave["inertia"][60] == pytest.approx(master["inertia"][60] + 0.5)


def test_the_numpy_arm_takes_the_same_options(scenario: Path) -> None:
    plan = assemble(load(scenario, ["components.master.model=fmus.models.arm:Arm"]))
    assert values(plan, "master")["g"].tolist() == pytest.approx([0, 0, -9.81], abs=1e-12)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("slave.options.tip=nose", r"at components.slave.options: .*no link 'nose' as tip"),
        ("slave.options.tip=7", r"slave.options: found tip = 7, expected the name of a link"),
        ("slave.options.urdf=x", r"slave.options: .*/x: cannot be read: No such file"),
        ("slave.options.load=3", r"slave.options: unknown key 'load'; expected one of urdf, base"),
        ("slave.options.payload=3", r"slave.options: found payload = 3, expected a table"),
        ("slave.options.payload={mass=-1}", r"payload: the mass is -1 kg, expected at least 0"),
        ("slave.options.payload={mass='1 m'}", r"payload.mass: .*\(expected \[kg\]\)"),
        ("slave.options.payload={mass=1,inertia=[1,0,0,1,0,3]}", r"payload: .*triangle"),
        ("slave.options.payload={weight=1}", r"payload: unknown key 'weight'; expected one of"),
        ("slave.options.fixed={joint9=0}", r"no moving joint 'joint9' to hold, as in `fixed`"),
        ("slave.sizes={joints=6}", r"slave.sizes.joints: found 6, expected 7 by the options"),
        ("slave_control.options.urdf=x", r"only a Python component, or a model that prepares"),
    ],
)
def test_options_that_cannot_be_are_refused(scenario: Path, setting: str, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        assemble(load(scenario, [f"components.{setting}"]))


def test_a_joint_of_the_arm_may_be_held(scenario: Path) -> None:
    held = [f"components.{c}.options.fixed={{joint3='10 deg'}}" for c in ("master", "slave")]
    held += [f"components.{c}.model=fmus.models.arm:Arm" for c in ("master", "slave")]
    held += [f"components.{c}_control.model=fmus.models.pd:PD" for c in ("master", "slave")]
    held += [f"components.{c}_control.sizes.joints=6" for c in ("master", "slave")]
    plan = assemble(load(scenario, [*held, "components.master.start.q=0"]))
    robot = serial(
        scenario.parent / "robots" / "robot.urdf", "body", "tcp", {"joint3": np.deg2rad(10.0)}
    )
    assert robot.names == tuple(f"joint{i}" for i in (1, 2, 4, 5, 6, 7))
    assert np.array_equal(values(plan, "master")["rotation"], robot.table.rotation.ravel())
    chain.check(robot.table, "robot")


def test_a_hook_that_fails_is_said_with_its_place(
    scenario: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = ["components.slave_control.options.a=1"]
    monkeypatch.setattr(pd, "prepare", lambda options, folder: options["b"], raising=False)
    with pytest.raises(ScenarioError, match=r"slave_control.options: fmus.models.pd: .*'b'"):
        assemble(load(scenario, settings))
    monkeypatch.setattr(pd, "prepare", lambda options, folder: {})
    with pytest.raises(ScenarioError, match=r"pd\.prepare returned a dict, expected a Preparation"):
        assemble(load(scenario, settings))


def test_an_fmu_takes_no_options(scenario: Path) -> None:
    with pytest.raises(ScenarioError, match=r"slave.options: an FMU takes no options; expected"):
        assemble(load(scenario, ["components.slave.model=arm.fmu"]))
