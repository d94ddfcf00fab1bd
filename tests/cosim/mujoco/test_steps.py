"""Motion of scenes: against planar2r, in the engine, repeated, resumed, and when MuJoCo fails."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from cosim.base.errors import RunError, ScenarioError
from cosim.engine.engine import Engine
from cosim.mujoco import MujocoOptions
from cosim.mujoco.component import MujocoComponent
from fmus.models import planar2r
from tests.cosim.mujoco.scenes import ARM, HINGE, SMALL_MEMORY, WALL, scene
from tests.cosim.scenarios import plan

START = {"q": np.array([0.45, 0.95]), "dq": np.array([0.5, -0.2])}
PUSH = {"tau": np.array([9.0, 3.0])}


def moved(component, steps, u, start=START):
    """All outputs after each step, (steps, outputs)."""
    component.initialize(start)
    component.initial(u)
    return np.array(
        [np.concatenate([np.ravel(y) for y in component.step(k * 1e-3, 1e-3, u).values()])
         for k in range(steps)]
    )  # fmt: skip


@pytest.fixture(scope="module")
def wall():
    return MujocoComponent(WALL)


def test_the_arm_moves_as_planar2r():
    arm = MujocoComponent(ARM, MujocoOptions(outputs=("q", "dq")))
    kernel = planar2r.kernel()
    ours, theirs = moved(arm, 1000, PUSH), moved(kernel, 1000, PUSH)[:, :4]
    assert np.ptp(theirs[:, 0]) > 1.0
    assert np.abs(ours - theirs).max() < 1e-12


def test_the_engine_steps_the_same_bytes_as_the_component(wall):
    expected = moved(wall, 400, PUSH)
    assert expected[:, -1].any() or expected[:, -2].any(), "no contact"
    made = plan(
        {"arm": {
            "model": f"mujoco:{WALL}", "start": {"q": [0.45, 0.95], "dq": [0.5, -0.2],
            "tau": [9.0, 3.0]},
        }},
        step=1e-3, stop=0.4,
    )  # fmt: skip
    record = np.zeros((401, made.n_signals))
    with Engine(made) as engine:
        engine.initialize()
        engine.run(400, record)
        record[400] = engine.signals
    outputs = [s for s in made.components[0].outputs]
    found = record[1:, outputs[0].start : outputs[-1].start + outputs[-1].size]
    assert found.tobytes() == expected.tobytes()


def test_steps_of_several_time_steps_are_the_time_steps(wall):
    wall.initialize(START)
    y = [wall.step(0.0, 4e-3, PUSH) for _ in range(100)][-1]
    assert np.concatenate([np.ravel(v) for v in y.values()]).tolist() == (
        moved(wall, 400, PUSH)[-1].tolist()
    )


def test_a_repeat_and_a_continued_state_have_the_same_bytes(wall):
    first = moved(wall, 400, PUSH)
    assert moved(wall, 400, PUSH).tobytes() == first.tobytes()
    moved(wall, 250, PUSH)  # in contact
    state = wall.get_state()
    rest = np.array([np.concatenate([np.ravel(v) for v in wall.step(0, 1e-3, PUSH).values()])
                     for _ in range(150)])  # fmt: skip
    assert rest.tobytes() == first[250:].tobytes()
    other = MujocoComponent(WALL)
    other.initialize({})
    other.set_state(state)
    again = np.array([np.concatenate([np.ravel(v) for v in other.step(0, 1e-3, PUSH).values()])
                      for _ in range(150)])  # fmt: skip
    assert again.tobytes() == first[250:].tobytes()


def test_outputs_do_not_change_the_motion(wall):
    short = MujocoComponent(WALL, MujocoOptions(outputs=("q", "dq")))
    assert not short._struct.evaluate and wall._struct.evaluate  # it costs less
    assert moved(short, 400, PUSH).tobytes() == (
        np.ascontiguousarray(moved(wall, 400, PUSH)[:, :4]).tobytes()
    )


def test_forces_are_those_at_the_end_of_the_step(wall):
    """At rest against the wall the motors' torque is the torque on the wall: J^T f = tau."""
    wall.initialize({"q": np.array([0.5, 1.0])})
    y = wall.initial({})
    for _ in range(1000):
        y = wall.step(0.0, 4e-3, {"tau": PUSH["tau"] - 20.0 * y["dq"]})
    assert np.abs(y["dq"]).max() < 1e-3 and y["contact_force"][1] > 1.0, y
    assert y["tau_e"] == pytest.approx(PUSH["tau"], abs=0.02)
    f, contact = y["contact_force"], y["x_tip"] + [0.0, 0.04, 0.0]
    elbow = np.array([np.cos(y["q"][0]), np.sin(y["q"][0]), 0.0])
    torques = [np.cross(arm, f)[2] for arm in (contact, contact - elbow)]
    assert torques == pytest.approx(y["tau_e"].tolist(), rel=2e-3)


# ---- failures -------------------------------------------------------------------------------


def test_a_motion_that_diverges_ends_the_run_and_is_not_reset(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one = scene(tmp_path, HINGE)
    one.initialize({})
    with pytest.raises(RunError, match=r"MuJoCo: Nan, Inf or huge value in Q\w+ at DOF 0"):
        for k in range(100):
            one.step(k * 0.01, 0.01, {"tau": [1e13]})
    with pytest.raises(RunError, match="huge value"):
        one.step(0.0, 0.01, {})
    one.initialize({})
    assert one.step(0.0, 0.01, {"tau": [1.0]})["dq"] > 0.0
    with pytest.raises(RunError, match=r"MuJoCo: Nan, Inf or huge value in QACC at DOF 0"):
        one.step(0.01, 0.01, {"tau": [1e13]})
    assert os.listdir(tmp_path) == ["scene.xml"]


def test_the_engine_names_component_and_time_of_a_failure(tmp_path):
    (tmp_path / "scene.xml").write_text(HINGE)
    made = plan(
        {"arm": {"model": f"mujoco:{tmp_path}/scene.xml", "start": {"tau": [1e13]}}},
        step=0.01, stop=1.0,
    )  # fmt: skip
    with Engine(made) as engine:
        engine.initialize()
        with pytest.raises(RunError, match=r"^arm: MuJoCo: Nan, Inf or huge .* at tick \d+ \(t = "):
            engine.run(100)


def test_an_error_of_mujoco_does_not_end_the_process(tmp_path):
    many = scene(tmp_path, SMALL_MEMORY)
    many.initialize({})
    for _ in range(2):
        with pytest.raises(ScenarioError, match="MuJoCo: mj_stackAlloc: out of memory"):
            many.initial({})
    with pytest.raises(RunError, match="out of memory"):
        many.step(0.0, 2e-3, {})


def test_a_scenario_without_a_scene_does_not_import_mujoco():
    code = "import sys, cosim.scenario.assemble, cosim.mujoco; sys.exit('mujoco' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
