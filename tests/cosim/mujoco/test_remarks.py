"""What a scene's file says and the scene does not do: refused, or named by ``cosim check``."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from cosim.base.errors import CosimError, MujocoError
from cosim.checks import preflight
from cosim.mujoco.component import MujocoComponent
from cosim.scenario.assemble import assemble
from tests.cli.command import Command
from tests.cosim.mujoco.scenes import ARM, HINGE, MANY, scene
from tests.cosim.scenarios import plan, scenario

INERTIAL = (
    '<inertial><origin xyz="0.1 0 0"/><mass value="1"/>'
    '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
)
LIMIT = '<limit lower="-3" upper="3" effort="0" velocity="0"/>'
CLOSED = '<mimic joint="a" multiplier="-1" offset="0.3"/>'


def urdf(folder: Path, inside: str = "", links: str = INERTIAL, extra: str = "") -> Path:
    """Two joints, a and b; `inside`: of b."""
    joints = "".join(
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="0 0 1"/>{LIMIT if "<limit" not in more else ""}{more}</joint>'
        for name, parent, child, more in (("a", "base", "l1", ""), ("b", "l1", "l2", inside))
    )
    path = folder / "arm.urdf"
    path.write_text(
        f'<robot name="r">{extra}<link name="base"/><link name="l1">{INERTIAL}</link>'
        f'<link name="l2">{links}</link>{joints}</robot>'
    )
    return path


def remarks(path: Path, **start: object) -> list[str]:
    """The warnings of ``cosim check`` about the file of a scene."""
    spec = {"model": f"mujoco:{path}", "start": start}
    made = scenario({"arm": spec}, step=2e-3, stop=0.1)
    findings = preflight.check(made, assemble(made))
    return [f.reason for f in findings if f.rule == "file" and f.severity == "warning"]


def test_a_plain_urdf_and_the_shipped_arm_have_no_remarks(tmp_path: Path) -> None:
    assert remarks(urdf(tmp_path)) == []
    assert MujocoComponent(ARM).remarks({}) == ()


# ---- joints that mimic others ------------------------------------------------------------------


def test_a_joint_that_mimics_is_named_and_starts_where_it_belongs(tmp_path: Path) -> None:
    path = urdf(tmp_path, CLOSED)
    assert any("the joint 'b' mimics 'a': MuJoCo holds it by" in said for said in remarks(path))
    arm = MujocoComponent(path)
    arm.initialize({})
    assert arm.initial({})["q"].tolist() == [0.0, 0.3]
    arm.initialize({"q": np.array([0.5, -0.2]), "dq": np.array([1.0, -1.0])})
    y = arm.initial({})
    assert (y["q"].tolist(), y["dq"].tolist()) == ([0.5, -0.2], [1.0, -1.0])
    for k in range(100):
        y = arm.step(0.002 * k, 0.002, {"tau": [0.3, 0.0]})
    assert y["q"][0] > 0.6
    assert y["q"][1] == pytest.approx(0.3 - y["q"][0], abs=1e-3)


@pytest.mark.parametrize("field", ["q", "dq"])
def test_a_start_apart_from_the_joint_that_is_mimicked_is_refused(tmp_path: Path, field) -> None:
    with pytest.raises(CosimError, match=r"'b' starts with 0\.7, expected .*mimics 'a'"):
        MujocoComponent(urdf(tmp_path, CLOSED)).initialize({field: np.array([0.5, 0.7])})


def test_a_mimic_that_mujoco_leaves_out_is_refused(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = urdf(tmp_path, '<mimic joint="nobody"/>')
    with pytest.raises(MujocoError, match=r"'b'.* mimics 'nobody', but MuJoCo .* by itself"):
        MujocoComponent(path)
    assert os.listdir(tmp_path) == ["arm.urdf"]  # MuJoCo's warning is in no file of its own


def test_info_prints_the_mimic(cosim: Command, tmp_path: Path) -> None:
    rows = [
        line.split() for line in cosim("info", f"mujoco:{urdf(tmp_path, CLOSED)}").out.splitlines()
    ]
    assert ["mimic", "b", "=", "-1", "a", "+0.3"] in rows
    assert any(row[:5] == ["remark", "the", "joint", "'b'", "mimics"] for row in rows)


# ---- other words of a URDF ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("inside", "words"),
    [
        ('<orgin xyz="0 0 1"/>', "joint 'b': unknown element <orgin>, expected one of origin"),
        ('<origin xyz="0 0 1" quat_xyzw="0 0 0 1"/>', "unknown attribute 'quat_xyzw' of <origin>"),
        (
            '<limit lowr="-3" upper="3"/>',
            "unknown attribute 'lowr' of <limit>, expected one of low",
        ),
    ],
)
def test_a_misspelt_word_is_refused(tmp_path: Path, inside: str, words: str) -> None:
    with pytest.raises(MujocoError, match=r"arm\.urdf, joint 'b'") as error:
        MujocoComponent(urdf(tmp_path, inside))
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("inside", "extra", "words"),
    [
        (LIMIT.replace('effort="0"', 'effort="9"'), "", "'effort' of the joints 'b' does"),
        (LIMIT.replace('velocity="0"', 'velocity="1"'), "", "'velocity' of the joints 'b' does"),
        ('<safety_controller k_velocity="10"/>', "", "<safety_controller> of the joints 'b' is"),
        ('<dynamics mu_coulomb="1"/>', "", "attribute 'mu_coulomb' of <dynamics> is not read"),
        ("", '<gazebo reference="b"><springStiffness>9</springStiffness></gazebo>',
         "<springStiffness> in <gazebo> is not read"),
        ("", '<transmission><actuator><mechanicalReduction>50</mechanicalReduction></actuator>'
         "</transmission>", "<mechanicalReduction> in <transmission> is not read"),
    ],
)  # fmt: skip
def test_what_mujoco_leaves_out_is_named(tmp_path: Path, inside: str, extra: str, words) -> None:
    (said,) = remarks(urdf(tmp_path, inside, extra=extra))
    assert words in said


def test_colours_and_plugins_of_gazebo_are_no_remark(tmp_path: Path) -> None:
    extra = '<gazebo reference="l1"><material>Gazebo/Red</material></gazebo><transmission/>'
    assert remarks(urdf(tmp_path, extra=extra)) == []


def test_a_link_whose_mass_comes_from_its_shape_is_named(tmp_path: Path) -> None:
    ball = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'
    (said,) = remarks(urdf(tmp_path, links=ball))
    assert "the link 'l2' has no <inertial>: MuJoCo gives it 4.189 kg" in said


# ---- scenes of either format -------------------------------------------------------------------


def test_a_start_outside_of_the_limits_is_named(tmp_path: Path) -> None:
    (said,) = remarks(urdf(tmp_path), q=[0.0, 3.5])
    assert "the joint 'b' starts at 3.5, outside of its limits -3 to 3" in said


def test_an_inertia_of_a_much_greater_body_is_named(tmp_path: Path) -> None:
    large = INERTIAL.replace('"0.01"', '"2661"').replace('mass value="1"', 'mass value="1.56"')
    (said,) = remarks(urdf(tmp_path, links=large))
    assert "the body 'l2' has 2661 kg.m2 and 1.56 kg: a radius of gyration of 41.3 m" in said


def test_delays_of_mujoco_add_to_links_and_are_named(tmp_path: Path) -> None:
    late = (
        '<actuator><motor name="m" joint="j" delay="0.03" nsample="4"/></actuator>'
        '<sensor><jointpos name="s" joint="j" delay="0.02" nsample="4"/></sensor></mujoco>'
    )
    said = scene(tmp_path, HINGE.replace("</mujoco>", late)).remarks({})
    assert [text.split(", ")[0] for text in said] == [
        "the actuator 'm' has a delay of 30 ms of its own",
        "the sensor 's' has a delay of 20 ms of its own",
    ]


def test_a_ball_joint_without_port_is_named(tmp_path: Path) -> None:
    assert scene(tmp_path, MANY).remarks({}) == ("the ball joint 'ball' moves, but has no port",)


def test_controls_of_a_keyframe_hold_where_nothing_is_wired(tmp_path: Path) -> None:
    servo = (
        '<actuator><position joint="j" kp="100" gear="2"/></actuator>'
        '<keyframe><key name="home" qpos="0.5" ctrl="1"/></keyframe></mujoco>'
    )
    found = scene(tmp_path, HINGE.replace("</mujoco>", servo), keyframe="home")
    assert {p.name: p.default for p in found.inputs}["q_ref"] == (0.5,)
    found.initialize({})
    found.initial({})
    assert found.data.ctrl.tolist() == [1.0]


@pytest.mark.parametrize(
    ("name", "cure"),
    [
        ("arm.urdf", '<mujoco><option timestep="0.001"/></mujoco> in <robot> in the file'),
        ("scene.xml", 'time step: <option timestep="0.001"/> in the file'),
    ],
)
def test_a_period_below_the_time_step_is_refused_with_the_cure(tmp_path, name, cure) -> None:
    urdf(tmp_path)
    (tmp_path / "scene.xml").write_text(HINGE)
    with pytest.raises(CosimError) as error:
        plan({"arm": {"model": f"mujoco:{tmp_path / name}"}}, step=1e-3)
    assert cure in str(error.value) and "without it 2 ms" in str(error.value)


def test_the_cure_of_a_urdf_works(tmp_path: Path) -> None:
    path = urdf(tmp_path, extra='<mujoco><option timestep="0.001"/></mujoco>')
    assert plan({"arm": {"model": f"mujoco:{path}"}}, step=1e-3).ticks > 0
