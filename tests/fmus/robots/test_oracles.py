"""Dynamics against Pinocchio and MuJoCo: random arms, states and payloads, and published robots.

Both read the URDF themselves. They are the extra `oracles`; without them these tests are skipped.
"""

from __future__ import annotations

import ctypes
from pathlib import Path

import numpy as np
import pytest

from fmus.arms import chain, task_space
from fmus.arms.body import Placement, RigidBody, symmetric
from fmus.arms.serial import Robot, serial
from fmus.models import arm_task
from tests.fmus.chains import ChainInC, compile_chain, random_body
from tests.fmus.robots import files

pytestmark = pytest.mark.slow

#: Robots of the package example-robot-data: file, base, tip, and joints to hold.
PUBLISHED = {
    "ur5": ("ur_description/urdf/ur5_robot.urdf", "base_link", "tool0", {}),
    "ur10": ("ur_description/urdf/ur10_robot.urdf", "base_link", "tool0", {}),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", "link_base", "link7", {}),
}


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    return compile_chain(tmp_path_factory.mktemp("chain"))


def body_values(theta: np.ndarray) -> list[float]:
    """Mass, centre and tensor there, as in a file, of ten parameters."""
    mass, centre = theta[0], theta[1:4] / theta[0]
    about = chain.tensor(theta) - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    entries = about[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    return [float(x) for x in (mass, *centre, *entries)]


def random_arm(rng: np.random.Generator, n: int) -> tuple[list[str], list[float]]:
    """Parts of a file: link0 to linkN, joints with any axis; and a payload at linkN."""
    parts = [files.link("link0")]
    for i in range(1, n + 1):
        kind = "prismatic" if rng.random() < 0.3 else "revolute"
        (x, y, z), (roll, pitch, yaw), (a, b, c) = rng.uniform(-0.5, 0.5, (3, 3)) * [[1], [6], [1]]
        inside = (
            f'<origin xyz="{x} {y} {z}" rpy="{roll} {pitch} {yaw}"/><axis xyz="{a} {b} {c}"/>'
            '<limit lower="-9" upper="9" effort="1" velocity="1"/>'
        )
        parts.append(files.link(f"link{i}", body_values(random_body(rng))))
        parts.append(files.joint(f"joint{i}", kind, f"link{i - 1}", f"link{i}", inside))
    return parts, body_values(random_body(rng))


def payload_of(values: list[float]) -> RigidBody:
    placement = Placement(np.eye(3), np.array(values[1:4]))
    return RigidBody.about_centre(values[0], symmetric(values[4:]), placement)


def by_pinocchio(path: Path, robot: Robot, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray):
    """(tau of the motion, ddq of tau = ddq's numbers, M), in the order of the robot's joints."""
    pin = pytest.importorskip("pinocchio")
    model = pin.buildModelFromUrdf(str(path))
    locked = [i for i in range(1, model.njoints) if model.names[i] not in robot.names]
    model = pin.buildReducedModel(model, locked, pin.neutral(model))
    assert tuple(model.names)[1:] == robot.names
    model.armature = robot.table.armature
    data = model.createData()
    return (
        pin.rnea(model, data, q, dq, ddq).copy(),
        pin.aba(model, data, q, dq, ddq).copy(),
        pin.crba(model, data, q).copy(),
    )


def by_mujoco(path: Path, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray):
    """(tau of the motion, ddq of tau = ddq's numbers), without limits, contacts and friction."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
    mujoco.mj_inverse(model, data)
    tau = data.qfrc_inverse.copy()
    data.qfrc_applied[:] = ddq
    mujoco.mj_forward(model, data)
    return tau, data.qacc.copy()


def compare(library: ctypes.CDLL, robot: Robot, path: Path, rng: np.random.Generator) -> None:
    """Torques, accelerations and inertia matrix to 1e-10 of their size."""
    n = robot.table.joints
    in_c = ChainInC(robot.table, library)
    for _ in range(5):
        q, dq, ddq = rng.uniform(-2, 2, (3, n))
        tau, moved, M = by_pinocchio(path, robot, q, dq, ddq)
        close = {"rtol": 1e-10, "atol": 1e-10}
        assert np.allclose(in_c.inverse(q, dq, ddq), tau, **close)
        assert np.allclose(chain.inverse(robot.table, q, dq, ddq), tau, **close)
        assert np.allclose(chain.mass_matrix(robot.table, q), M, **close)
        scale = np.linalg.cond(M) * 1e-15 * np.abs(moved).max()
        found = in_c.forward(q, dq, ddq)
        assert np.allclose(found, moved, rtol=1e-10, atol=max(1e-10, scale))


@pytest.mark.parametrize("n", [1, 3, 7, 16])
def test_random_arms_with_payloads_move_as_in_pinocchio_and_mujoco(
    library: ctypes.CDLL, tmp_path: Path, n: int
) -> None:
    rng = np.random.default_rng(n)
    for _ in range(8):
        parts, payload = random_arm(rng, n)
        ours = files.write(tmp_path, *parts)
        robot = serial(ours, "link0", f"link{n}", payload=payload_of(payload))
        carried = files.joint("carries", "fixed", f"link{n}", "payload")
        theirs = files.write(tmp_path, *parts, files.link("payload", payload), carried)
        compare(library, robot, theirs, rng)
        q, dq, ddq = rng.uniform(-2, 2, (3, n))
        tau, moved = by_mujoco(theirs, q, dq, ddq)
        in_c = ChainInC(robot.table, library)
        assert np.allclose(in_c.inverse(q, dq, ddq), tau, rtol=1e-10, atol=1e-10)
        scale = np.linalg.cond(chain.mass_matrix(robot.table, q)) * 1e-14 * np.abs(moved).max()
        assert np.allclose(in_c.forward(q, dq, ddq), moved, rtol=1e-10, atol=max(1e-10, scale))


def test_openarm_and_the_fr3_move_as_in_pinocchio_and_mujoco(
    library: ctypes.CDLL, tmp_path: Path
) -> None:
    rng = np.random.default_rng(2)
    for write, base, tip in ((files.openarm, "body", "tcp"), (files.fr3, "link0", "link7")):
        path = write(tmp_path)
        robot = serial(path, base, tip)
        compare(library, robot, path, rng)
        q, dq, ddq = rng.uniform(-1, 1, (3, 7))
        tau, _ = by_mujoco(path, q, dq, ddq)
        inverse = ChainInC(robot.table, library).inverse(q, dq, ddq)
        assert np.allclose(inverse, tau, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_robots_move_as_in_pinocchio(library: ctypes.CDLL, name: str) -> None:
    pin = pytest.importorskip("pinocchio")
    file, base, tip, fixed = PUBLISHED[name]
    path = Path(pin.__file__).parents[4] / "share/example-robot-data/robots" / file
    if not path.is_file():
        pytest.skip("example-robot-data is not installed")
    robot = serial(path, base, tip, fixed)
    compare(library, robot, path, np.random.default_rng(7))


@pytest.mark.parametrize("n", [2, 7])
def test_tips_move_as_in_pinocchio(tmp_path: Path, n: int) -> None:
    """Place, Jacobian and orientation of the tip; dv/dt of a task by dJ/dt: J dv + dJ v = dw."""
    pin = pytest.importorskip("pinocchio")
    rng = np.random.default_rng(n)
    for _ in range(5):
        path = files.write(tmp_path, *random_arm(rng, n)[0])
        robot = serial(path, "link0", f"link{n}")
        model = pin.buildModelFromUrdf(str(path))
        data, frame = model.createData(), model.getFrameId(f"link{n}")
        q, dq = rng.uniform(-2, 2, (2, n))
        pin.computeJointJacobiansTimeVariation(model, data, q, dq)
        pin.updateFramePlacements(model, data)
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        J = pin.getFrameJacobian(model, data, frame, axes)
        dJ = pin.getFrameJacobianTimeVariation(model, data, frame, axes)
        table, point = robot.table, robot.tip.r
        assert np.allclose(task_space.tip(table, point, q), data.oMf[frame].translation, atol=1e-12)
        assert np.allclose(task_space.jacobian(table, point, q), J[:3], atol=1e-11)
        assert np.allclose(task_space.turns(table, q), J[3:], atol=1e-11)
        *_, (R, _) = chain.placements(table, q)
        assert np.allclose(R @ robot.tip.R, data.oMf[frame].rotation, atol=1e-11)
        m = 3 if n > 3 else 1  # the tip is on the axis of the last joint
        w, dw = rng.uniform(-1, 1, (2, m))
        declared = arm_task.model(joints=n, coordinates=m).variables
        x = {v.name: np.reshape(v.starts, v.shape) for v in declared} | table.values()
        x |= {"tip": point, "sigma_0": np.array(1e-6)}
        v, a = task_space.velocity(x, q, w), task_space.acceleration(x, q, dq, w, dw)
        assert np.allclose(J[:m] @ v, w, rtol=0, atol=1e-9)
        assert np.allclose(J[:m] @ a + dJ[:m] @ v, dw, rtol=0, atol=1e-8)
