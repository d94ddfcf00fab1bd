"""Which ports a scene has, their units, and what they are connected to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.base.errors import MujocoError
from cosim.mujoco.component import MujocoComponent
from tests.cosim.mujoco.scenes import ARM, HINGE, MANY, WALL, scene

GROUPS = {"left": ("left_*",), "right": ("right_2", "right_1")}


def units(ports):
    return {p.name: (p.shape, p.unit) for p in ports}


def test_the_arm_has_the_ports_of_an_arm_of_the_project():
    arm = MujocoComponent(ARM)
    assert units(arm.inputs) == {"tau": ((2,), "N.m"), "tau_ext": ((2,), "N.m")}
    assert units(arm.outputs) == {
        "q": ((2,), "rad"), "dq": ((2,), "rad/s"), "tau_e": ((2,), "N.m"), "x_tip": ((3,), "m"),
    }  # fmt: skip
    assert [p.optional for p in arm.inputs] == [False, True]
    assert units(MujocoComponent(WALL).outputs) | {"touch": ((), "N")} == {
        **units(arm.outputs), "touch": ((), "N"), "contact_force": ((3,), "N"),
    }  # fmt: skip


def test_all_hinges_are_one_vector_and_all_slides_another(tmp_path):
    found = scene(tmp_path, MANY)
    assert units(found.inputs) == {
        "tau": ((4,), "N.m"), "tau_ext": ((4,), "N.m"), "tau_slide": ((1,), "N"),
        "tau_ext_slide": ((1,), "N"), "dq_ref_slide": ((1,), "m/s"),
        "p1": ((), "rad"), "p2": ((), "rad"), "muscle": ((), "1"),
    }  # fmt: skip
    assert units(found.outputs) == {
        "q": ((4,), "rad"), "dq": ((4,), "rad/s"), "tau_e": ((4,), "N.m"),
        "q_slide": ((1,), "m"), "dq_slide": ((1,), "m/s"), "tau_e_slide": ((1,), "N"),
        "x_box": ((3,), "m"), "quat_box": ((4,), "1"), "x_tool": ((3,), "m"),
        "s_angle": ((), "rad"), "s_rail": ((), "m"), "s_force": ((), "N"), "s_quat": ((4,), "1"),
        "s_acc": ((3,), "m/s2"),
    }  # fmt: skip


def test_groups_name_ports_and_order_joints(tmp_path):
    found = scene(tmp_path, MANY, groups=GROUPS, keyframe="home", outputs=("q_*", "x_box"))
    assert units(found.inputs) == {
        "tau_left": ((2,), "N.m"), "tau_ext_left": ((2,), "N.m"),
        "tau_right": ((2,), "N.m"), "tau_ext_right": ((2,), "N.m"),
        "q_ref_right": ((2,), "rad"), "v": ((), "m/s"), "muscle": ((), "1"),
    }  # fmt: skip
    assert list(units(found.outputs)) == ["q_left", "q_right", "x_box"]
    found.initialize({})
    y = found.initial({})
    assert y["q_left"].tolist() == [0.1, 0.2]
    assert y["q_right"].tolist() == [0.4, 0.3]
    assert y["x_box"].tolist() == [0, 0, 2]
    found.initialize({"q_right": np.array([1.0, 2.0]), "x_box": np.array([3.0, 4.0, 5.0])})
    y = found.initial({})
    assert y["q_right"].tolist() == [1, 2] and y["q_left"].tolist() == [0.1, 0.2]
    assert y["x_box"].tolist() == [3, 4, 5]
    assert {p.name: p.default for p in found.parameters}["q_right"] == (0.4, 0.3)


def test_tau_is_the_torque_of_the_joint_whatever_the_gear(tmp_path):
    found = scene(tmp_path, MANY, groups=GROUPS)
    found.initialize({})
    found.initial({"tau_left": [6.0, 8.0], "tau_ext_left": [0.5, 0.25], "tau_right": [1.0, 2.0]})
    data, joint = found.data, {n: found.scene.model.joint(n).dofadr[0] for n in
                                ("left_1", "left_2", "right_1", "right_2")}  # fmt: skip
    assert data.ctrl.tolist()[:2] == [3.0, -2.0]
    assert data.qfrc_actuator[joint["left_1"]] == 6.0
    assert data.qfrc_actuator[joint["left_2"]] == 8.0
    assert [data.qfrc_applied[joint[n]] for n in joint] == [0.5, 0.25, 2.0, 1.0]


@pytest.mark.parametrize(("kind", "gain"), [("position", "kp"), ("velocity", "kv")])
def test_a_reference_is_that_of_the_joint_whatever_the_gear(tmp_path, kind, gain):
    servo = f'<actuator><{kind} joint="j" {gain}="100" gear="2"/></actuator></mujoco>'
    found = scene(tmp_path, HINGE.replace("</mujoco>", servo))
    name, state = ("q_ref", "q") if kind == "position" else ("dq_ref", "dq")
    assert [p.name for p in found.inputs] == ["tau", "tau_ext", name]
    assert found.inputs[0].optional
    found.initialize({state: np.array([0.5])})
    found.initial({name: [0.5]})
    assert found.data.qfrc_actuator.tolist() == [0.0]
    found.initial({name: [0.75]})
    assert found.data.qfrc_actuator.tolist() == [100.0]  # 100 N.m/rad, 2 * 2 * 0.25 rad


def test_without_actuators_the_torque_acts_on_the_joint(tmp_path):
    found = scene(tmp_path, HINGE)
    assert units(found.inputs) == {"tau": ((1,), "N.m"), "tau_ext": ((1,), "N.m")}
    assert not found.inputs[0].optional
    found.initialize({})
    found.initial({})
    y = found.step(0.0, 0.01, {"tau": [1.0], "tau_ext": [1.0]})
    assert y["dq"][0] == pytest.approx(0.01 * 2.0 / (2.0 + 0.4 * 2.0 * 0.1**2), rel=1e-12)


def test_a_urdf_is_a_scene(tmp_path: Path):
    path = tmp_path / "arm.urdf"
    path.write_text(
        '<robot name="r"><link name="base"/><link name="rod"><inertial><origin xyz="0.5 0 0"/>'
        '<mass value="2"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>'
        '</inertial></link><joint name="j" type="revolute"><parent link="base"/>'
        '<child link="rod"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="9" '
        'velocity="1"/></joint></robot>'
    )
    arm = MujocoComponent(path)
    arm.initialize({})
    y = arm.step(0.0, 0.002, {"tau": [0.6]})
    assert y["dq"] == pytest.approx([0.002 * 0.6 / (0.1 + 2 * 0.25)], rel=1e-12)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"joints": ("lift_1",)}, "no joint 'lift_1'; did you mean 'left_1'?"),
        ({"joints": ("left_1", "rail")}, "left_1 is a hinge, rail is a slide; expected joints"),
        ({"joints": ("ball",)}, "ball is a ball joint; expected joints of one vector"),
        ({"outputs": ("q", "speed")}, "no output 'speed'"),
        ({"keyframe": "hom"}, "no keyframe 'hom'; did you mean 'home'?"),
    ],
)
def test_options_that_do_not_fit_are_refused(tmp_path, options, words):
    with pytest.raises(MujocoError, match=r"scene\.xml: ") as error:
        scene(tmp_path, MANY, **options)
    assert words in str(error.value)


def test_two_ports_of_one_name_are_refused(tmp_path):
    text = HINGE.replace(
        "</worldbody>", '</worldbody><sensor><jointpos name="q" joint="j"/></sensor>'
    )
    with pytest.raises(MujocoError, match="two ports are called 'q'; expected"):
        scene(tmp_path, text)
