"""Arms from URDF files: published numbers, merged links, and payloads."""

from __future__ import annotations

from pathlib import Path
from runpy import run_path

import numpy as np
import pytest

from cosim.base.errors import ScenarioError
from fmus.arms import chain
from fmus.arms.body import Placement, RigidBody, from_rpy
from fmus.arms.serial import Robot, serial
from tests.fmus import chains
from tests.fmus.robots import files

Q = np.array([0.3, 0.5, -0.4, 0.9, 0.2, -0.3, 0.4])
DQ = np.array([0.5, -0.4, 0.3, 0.8, -0.6, 0.7, -0.9])
DDQ = np.array([1.0, -2, 3, -1, 0.5, 2, -3])
STILL = np.zeros(7)
# OpenArm's right arm and hand, computed with Pinocchio 4.1.0 and MuJoCo 4.0.0 (both agree).
TAU = [
    5.4553572322, 3.1700740836, 1.7435256832, 2.9561242427, -0.0776868184, -0.3175347749,
    0.5412323213,
]  # fmt: skip
GRAVITY = [
    5.206702424, 3.1770430087, 1.6549746266, 2.8566941507, -0.0848188126, -0.2951655148,
    0.5315331757,
]  # fmt: skip
DIAGONAL = [
    0.2977407788, 0.2761526383, 0.0647430835, 0.0931598036, 0.0025754403, 0.0061041091,
    0.0068678547,
]  # fmt: skip
ROTORS = np.array([0.0157950, 0.0157950, 0.032, 0.032, 0.0018, 0.0018, 0.0018])
TAU_ROTORS = [
    5.47115723, 3.13847408, 1.83952568, 2.92412424, -0.07678682, -0.31393477, 0.53583232,
]  # fmt: skip


@pytest.fixture(scope="module")
def openarm(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return serial(files.openarm(tmp_path_factory.mktemp("openarm")), "body", "hand")


def test_openarm_has_the_torques_that_pinocchio_and_mujoco_give_it(openarm: Robot) -> None:
    table = openarm.table
    assert openarm.mass == pytest.approx(4.67473324, abs=1e-8)
    assert np.allclose(chain.inverse(table, Q, DQ, DDQ), TAU, rtol=0, atol=1e-8)
    assert np.allclose(chain.inverse(table, Q, STILL, STILL), GRAVITY, rtol=0, atol=1e-8)
    assert np.allclose(np.diag(chain.mass_matrix(table, Q)), DIAGONAL, rtol=0, atol=1e-9)


def test_rotors_of_openarm_add_their_torques(openarm: Robot) -> None:
    values = {**openarm.table.values(), "armature": np.array([0.0158, 0.0158, *ROTORS[2:]])}
    tau = chain.inverse(chain.of_values(values), Q, DQ, DDQ)
    assert np.allclose(tau, TAU_ROTORS, rtol=0, atol=1e-8)


def test_the_last_joint_of_openarm_is_where_pinocchio_has_it(openarm: Robot) -> None:
    *_, (_, place) = chain.placements(openarm.table, Q)
    assert np.allclose(place, [0.25009393, -0.2655209, 0.4168623], rtol=0, atol=1e-7)
    *_, (_, place) = chain.placements(openarm.table, STILL)
    assert np.allclose(place, [0, -0.1534984, 0.2619996], rtol=0, atol=1e-7)


def test_names_and_limits_are_those_of_the_file(openarm: Robot) -> None:
    assert openarm.names == tuple(f"joint{i}" for i in range(1, 8))
    assert openarm.upper.tolist()[:2] == [3.490659, 3.316125]
    assert openarm.effort.tolist() == [40, 40, 27, 27, 7, 7, 7]
    assert openarm.velocity[2] == 5.445426


def test_the_fr3_of_a_file_is_the_fr3_of_its_table(tmp_path: Path) -> None:
    found, expected = serial(files.fr3(tmp_path), "link0", "link7").table, chains.fr3()
    for name, value in expected.values().items():
        assert np.allclose(found.values()[name], value, rtol=0, atol=1e-12), name


def test_the_tip_is_a_frame_in_the_last_link(tmp_path: Path) -> None:
    path = files.openarm(tmp_path)
    for tip, length in (("link7", 0.0), ("hand", 0.1001), ("tcp", 0.1801)):
        robot = serial(path, "body", tip)
        *_, (R, r) = chain.placements(robot.table, STILL)
        end = r + R @ robot.tip.r
        expected = np.array([0.0, -0.1534984, 0.2619996]) - [0.0, 0.0, length]  # hangs down
        assert np.allclose(end[2], expected[2], rtol=0, atol=1e-5)
        assert np.allclose((R @ robot.tip.R)[:, 2], [0, 0, -1], rtol=0, atol=1e-5)
        assert robot.mass == pytest.approx(4.67473324, abs=1e-8)


def test_the_base_may_be_any_link_before_the_arm(tmp_path: Path, openarm: Robot) -> None:
    """Gravity is that of the root: the frame of the first link lies on its side."""
    robot = serial(files.openarm(tmp_path), "link0", "hand")
    assert np.allclose(robot.table.g, [0, -9.81, 0], rtol=0, atol=1e-4)
    torques = [chain.inverse(each.table, Q, DQ, DDQ) for each in (robot, openarm)]
    assert np.allclose(*torques, rtol=0, atol=1e-12)


def test_a_payload_is_a_body_at_the_tip(tmp_path: Path) -> None:
    """Its weight, by virtual work: tau = -J' m g."""
    path = files.openarm(tmp_path)
    mass, centre = 0.7, np.array([0.02, -0.01, 0.05])
    body = RigidBody.about_centre(mass, np.zeros((3, 3)), Placement(np.eye(3), centre))
    empty, loaded = serial(path, "body", "tcp"), serial(path, "body", "tcp", payload=body)
    more = chain.inverse(loaded.table, Q, STILL, STILL) - chain.inverse(
        empty.table, Q, STILL, STILL
    )

    def height(q: np.ndarray) -> float:
        *_, (R, r) = chain.placements(empty.table, q)
        return float((r + R @ (empty.tip.R @ centre + empty.tip.r))[2])

    step = 1e-6 * np.eye(7)
    slope = [(height(Q + e) - height(Q - e)) / 2e-6 for e in step]
    assert np.allclose(more, mass * 9.81 * np.array(slope), rtol=0, atol=1e-8)
    assert loaded.mass - empty.mass == pytest.approx(mass)


def test_axes_in_any_direction_become_z(tmp_path: Path) -> None:
    """One joint with an axis in each direction: its torque is that of its inertia and weight."""
    body = list(files.BODY)
    q, dq, ddq = np.array([0.4]), np.array([0.8]), np.array([-1.2])
    for axis in ("1 0 0", "0 2 0", "0 0 -1", "0.3 -0.4 0.5", "0 0 1"):
        inside = f'<axis xyz="{axis}"/><limit lower="-1" upper="1" effort="1" velocity="1"/>'
        inside += '<origin rpy="0.3 0.2 -0.5" xyz="0.1 0 0.2"/>'
        joint = files.joint("j", "revolute", "a", "b", inside)
        path = files.write(tmp_path, files.link("a"), files.link("b", body), joint)
        robot = serial(path, "a", "b")
        found = chain.inverse(robot.table, q, dq, ddq)
        direction = np.array(axis.split(), dtype=float)
        direction /= np.linalg.norm(direction)
        c, s, k = np.cos(q[0]), np.sin(q[0]), chain.skew(direction)
        turned = from_rpy(np.array([0.3, 0.2, -0.5])) @ (np.eye(3) + s * k + (1 - c) * k @ k)
        mass, centre = body[0], np.array(body[1:4])
        about = chains.parameters(mass, centre, chains.symmetric(*body[4:]))
        inertia = direction @ chain.tensor(about) @ direction
        weight = turned.T @ np.array([0.0, 0.0, -9.81 * mass])
        expected = inertia * ddq[0] - direction @ np.cross(centre, weight)
        assert found[0] == pytest.approx(expected, abs=1e-12)
        outer = robot.table.rotation[0] @ robot.tip.R
        assert np.allclose(outer, from_rpy(np.array([0.3, 0.2, -0.5])), rtol=0, atol=1e-12)


def gripper(folder: Path, inside: str = "") -> Path:
    """One joint, and on its link a finger that slides along y."""
    body = list(files.BODY)
    limit = '<limit lower="0" upper="0.05" effort="1" velocity="1"/>'
    return files.write(
        folder,
        files.link("a"), files.link("b", body), files.link("finger", body),
        files.moving("j", "a", "b", [0, 0, 0, 0, 0, 0, 1, -1, 1, 1, 1]),
        files.joint("slide", "prismatic", "b", "finger", f'<axis xyz="0 1 0"/>{limit}{inside}'),
    )  # fmt: skip


def test_a_joint_held_at_a_value_merges_its_links(tmp_path: Path) -> None:
    path = gripper(tmp_path, '<mimic joint="j"/>')
    body = list(files.BODY)
    theta = serial(path, "a", "b", fixed={"slide": 0.03}).table.inertia[0]
    assert theta[0] == pytest.approx(2 * body[0])
    assert theta[2] == pytest.approx(body[0] * (2 * body[2] + 0.03))
    closed = serial(path, "a", "finger", fixed={"slide": 0.0})
    assert closed.names == ("j",)
    both = serial(gripper(tmp_path), "a", "finger")
    assert both.names == ("j", "slide")
    assert both.table.joint_type.tolist() == [0.0, 1.0]


@pytest.mark.parametrize(
    ("base", "tip", "fixed", "message"),
    [
        ("a", "b", {}, r"robot.urdf, joint 'slide': it moves, but is not between base and tip; "
         r"expected it in `fixed` .* fixed = \{ slide = 0.0 \}"),
        ("a", "nose", {}, "no link 'nose' as tip; there are: a, b, finger"),
        ("finger", "b", {}, "link 'finger' does not carry 'b'; expected a base between the root"),
        ("a", "b", {"slide": 0.2}, "joint 'slide': held at 0.2 in `fixed`, expected 0 to 0.05"),
        ("a", "b", {"slide": "1 rad"}, r"'slide', which slides, .*: \[rad\] cannot feed \[m"),
        ("a", "b", {"j": "1 m"}, r"joint 'j', which turns, in `fixed`: \[m\] cannot feed \[rad\]"),
        ("a", "b", {"j": [1]}, "in `fixed`: expected shape|expected a single number"),
        ("a", "b", {"elbow": 0.0}, "no moving joint 'elbow' to hold, .* there are: j, slide"),
        ("a", "b", {"slide": 0.0, "j": 0.0}, "0 moving joints between 'a' and 'b', expected 1 to"),
        ("b", "finger", {}, "joint 'j': it moves the base 'b', expected it in `fixed`"),
    ],
)  # fmt: skip
def test_a_chain_that_cannot_be_is_refused(
    tmp_path: Path, base: str, tip: str, fixed: dict[str, float | str], message: str
) -> None:
    with pytest.raises(ScenarioError, match=message):
        serial(gripper(tmp_path), base, tip, fixed)


def test_a_joint_that_mimics_another_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="joint 'slide': it mimics the joint 'j', expected"):
        serial(gripper(tmp_path, '<mimic joint="j"/>'), "a", "finger")


def test_the_shipped_files_are_what_their_script_writes() -> None:
    written = run_path(str(files.ROBOTS / "write.py"))["documents"]()
    assert written.keys() == {path.name for path in files.ROBOTS.glob("*.urdf")}
    for name, text in written.items():
        assert (files.ROBOTS / name).read_text(encoding="utf-8") == text


def test_the_left_arm_of_openarm_is_held_like_the_right_one_by_mirrored_torques() -> None:
    """Gravity in mirrored postures: the maker's rules mirror all but link 4 and products."""
    right, left = (
        serial(files.ROBOTS / f"openarm_{side}.urdf", "body", "hand") for side in ("right", "left")
    )
    mirror = np.array([-1, -1, -1, 1, -1, -1, -1.0])
    found = chain.inverse(left.table, mirror * Q, STILL, STILL)
    expected = mirror * chain.inverse(right.table, Q, STILL, STILL)
    assert left.mass == right.mass
    assert np.allclose(found, expected, rtol=0, atol=0.3)  # link 4 is not mirrored
    assert not np.allclose(found, expected, rtol=0, atol=0.01)
