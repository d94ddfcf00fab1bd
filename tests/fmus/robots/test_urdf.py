"""What is wrong in a URDF file is one sentence with the file and the element."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.base.errors import ScenarioError
from cosim.checks import preflight
from cosim.scenario.assemble import assemble
from fmus.arms.serial import serial
from fmus.arms.urdf import read
from tests.cosim.scenarios import scenario
from tests.fmus.robots import files

BODY = list(files.BODY)
LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
LINKS = files.link("a") + files.link("b", BODY)


def of_joint(kind: str = "revolute", inside: str = LIMIT) -> str:
    return LINKS + files.joint("j", kind, "a", "b", inside)


def of_body(mass: float, *tensor: float) -> str:
    body = [mass, 0.1, 0.2, 0.3, *tensor]
    return files.link("a") + files.link("b", body) + files.joint("j", "revolute", "a", "b", LIMIT)


CASES = [
    # the file
    ('<!DOCTYPE robot [<!ENTITY x "y">]><robot name="r"/>', "found a DTD, an entity or a NUL"),
    ("<robot><link></robot>", "robot.urdf: is not XML: mismatched tag"),
    ("<sdf/>", "robot.urdf: found <sdf>, expected <robot>"),
    ('<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:arm/></robot>',
     "found xacro in <arm>, expected an expanded file"),
    ('<robot><link name="${side}_a"/></robot>', "found xacro in <link>, expected an expanded file"),
    # names and the tree
    ("<robot><link/></robot>", "robot.urdf: found a <link> without name"),
    (files.link("a") + files.link("a"), "robot.urdf, 'a': declared twice"),
    (LINKS, "links that no joint carries: 'a', 'b'; expected one"),
    (of_joint() + files.joint("k", "fixed", "b", "c"), "joint 'k', <child>: there is no link 'c'"),
    (LINKS + '<joint name="j" type="fixed"><child link="b"/></joint>', "joint 'j': no <parent>"),
    (of_joint() + files.joint("k", "fixed", "a", "b"),
     "link 'b': carried by the joints 'j' and 'k', expected one: closed loops"),
    (of_joint() + files.joint("k", "fixed", "b", "a"), "link 'a': it carries itself: a closed"),
    # joints
    (of_joint("planar"), "joint 'j': found type 'planar', expected one of revolute, continuous"),
    (of_joint("floating"), "joint 'j': found type 'floating'"),
    (of_joint(inside=""), "joint 'j': no <limit>, expected one of a revolute joint"),
    (of_joint("prismatic", ""), "joint 'j': no <limit>, expected one of a prismatic joint"),
    (of_joint(inside='<limit effort="1" velocity="1"/>'),
     "joint 'j', <limit>: found lower 0 and upper 0, expected lower below upper"),
    (of_joint(inside='<limit lower="1" upper="-1"/>'), "found lower 1 and upper -1"),
    (of_joint(inside='<limit lower="-1" upper="1" effort="-3"/>'), "found -3, expected effort"),
    (of_joint(inside='<limit lower="a" upper="1"/>'), 'found lower="a", expected a finite number'),
    (of_joint(inside=LIMIT + LIMIT), "joint 'j': 2 elements <limit>, expected one"),
    (of_joint(inside=LIMIT + '<orign xyz="0 0 1"/>'), "joint 'j': unknown element <orign>"),
    (of_joint(inside=LIMIT + '<axis xyz="0 0 0"/>'), "joint 'j': found an <axis> of length 0"),
    (of_joint(inside=LIMIT + '<axis xyz="0 1"/>'), '<axis>: found xyz="0 1", expected 3 finite'),
    (of_joint(inside=LIMIT + '<origin xyz="0 1 nan"/>'), '<origin>: found xyz="0 1 nan", expected'),
    (of_joint(inside=LIMIT + '<dynamics damping="-1"/>'), "<dynamics>: found a negative value"),
    # inertia
    (LINKS.replace(" ixx=", " xx=") + files.joint("j", "revolute", "a", "b", LIMIT),
     "link 'b', <inertial>: unknown attribute 'xx' of <inertia>, expected one of ixx"),
    (LINKS.replace("<inertia ixx=", "<inertia izy=") + files.joint("j", "fixed", "a", "b"),
     "unknown attribute 'izy' of <inertia>"),
    (LINKS.replace(' ixy="', ' name="') + files.joint("j", "fixed", "a", "b"),
     "unknown attribute 'name' of <inertia>"),
    (of_joint(inside='<limit lowr="-1" upper="1"/>'),
     "joint 'j': unknown attribute 'lowr' of <limit>, expected one of lower, upper"),
    (of_joint(inside=LIMIT + '<origin xyz="0 0 1" quat_xyzw="0 0 0 1"/>'),
     "joint 'j': unknown attribute 'quat_xyzw' of <origin>, expected one of xyz, rpy"),
    (LINKS.replace("<mass", "<weight") + files.joint("j", "revolute", "a", "b", LIMIT),
     "link 'b', <inertial>: unknown element <weight>, expected one of origin, mass, inertia"),
    (files.link("a") + files.link("b") + files.joint("j", "revolute", "a", "b", LIMIT),
     "link 'b': no <inertial> with a mass, expected one: the joint"),
    (of_body(0.0, 1, 0, 0, 1, 0, 1), "link 'b': the mass is 0 kg, expected more than 0"),
    (of_body(0.0, 0, 0, 0, 0, 0, 0), "no <inertial> with a mass, expected one: the joint"),
    (of_body(-1.0, 1, 0, 0, 1, 0, 1), "link 'b': the mass is -1 kg, expected more than 0"),
    (of_body(1.0, 1, 2, 0, 1, 0, 1), r"link 'b': principal moments -1, .* expected none below 0"),
    # as in the file of an xArm that PyBullet has
    (of_body(1.9, 0.0074, 0, 0, 0.0012, 0, 0.0016),
     r"link 'b': principal moments 0.0012, 0.0016, 0.0074 .*\(triangle inequality\)"),
    (of_body(1.0, 0, 0, 0, 1, 0, 1), "link 'b': the smallest principal moment .* expected more"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "message"), CASES, ids=[message for _, message in CASES])
def test_a_file_that_is_wrong_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(text if "<robot" in text or "<sdf" in text else f"<robot>{text}</robot>")
    with pytest.raises(ScenarioError, match=message) as error:
        serial(path, "a", "b")
    assert "\n" not in str(error.value)


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"nowhere\.urdf: cannot be read: No such file"):
        read(tmp_path / "nowhere.urdf")


def test_what_is_not_said_has_the_defaults_of_the_format(tmp_path: Path) -> None:
    path = files.write(tmp_path, of_joint("continuous", '<dynamics damping="0.5"/>'))
    (joint,) = read(path).joints
    assert np.array_equal(joint.axis, [1, 0, 0])
    assert np.array_equal(joint.frame.R, np.eye(3))
    assert (joint.lower, joint.upper) == (-np.inf, np.inf)
    assert (joint.effort, joint.velocity) == (np.inf, np.inf)
    assert (joint.damping, joint.friction) == (0.5, 0.0)


def test_shapes_colours_and_extensions_are_not_read(tmp_path: Path) -> None:
    extra = '<material name="grey"/><gazebo reference="b"/><transmission name="t"/>'
    shape = '<visual><geometry><mesh filename="b.stl"/></geometry></visual>'
    path = files.write(tmp_path, extra, of_joint().replace('name="b">', f'name="b">{shape}'))
    assert serial(path, "a", "b").names == ("j",)


def test_a_link_of_zeros_at_a_fixed_joint_has_no_mass(tmp_path: Path) -> None:
    """As the flange of the UR robots."""
    end = files.link("flange", [0.0] * 10) + files.joint("end", "fixed", "b", "flange")
    assert serial(files.write(tmp_path, of_joint(), end), "a", "flange").mass == BODY[0]


def test_a_lamina_is_a_body(tmp_path: Path) -> None:
    path = files.write(tmp_path, of_body(1.0, 0.1, 0, 0, 0.2, 0, 0.3))
    assert serial(path, "a", "b").mass == 1.0


def test_what_would_change_the_motion_and_is_not_read_is_named(tmp_path: Path) -> None:
    soft = LIMIT + '<safety_controller k_velocity="9"/><dynamics damping="1" D="2"/>'
    gear = "<transmission><actuator><mechanicalReduction>50</mechanicalReduction></actuator>"
    path = files.write(tmp_path, of_joint(inside=soft), gear + "</transmission>")
    assert (
        serial(path, "a", "b").unread
        == read(path).unread
        == (
            "<safety_controller> of the joints 'j' is not read: its soft limits do not act",
            "the attribute 'D' of <dynamics> is not read: URDF does not have it",
            "<mechanicalReduction> in <transmission> is not read and does not act",
        )
    )
    spec = {
        "model": "fmus.models.arm",
        "options": {"urdf": str(path), "base": "a", "tip": "b"},
        "start": {"tau": [0.0]},
    }
    made = scenario({"arm": spec})
    found = preflight.check(made, assemble(made))
    assert [f.reason.partition(": ")[0] for f in found if f.rule == "file"] == ["robot.urdf"] * 3
