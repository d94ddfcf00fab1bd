"""Three arms of 7, 6 and 2 joints under the law of their tips: what the theory says, at work."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.engine.simulate import simulate
from cosim.loading.files import load
from cosim.record import Run
from fmus.arms import chain, task_space
from fmus.arms.serial import serial

CONFIGS = Path(__file__).parents[2] / "configs"
ARMS = ("master", "slave", "planar")
#: The place that the operator wants, in the coordinates of all.
TARGET = np.array([0.1, 0.2, 0.0])
K_X, LAMBDA, ALPHA, LAMBDA_M = 60.0, 1.0, 0.5, 10.0
SLAVE = serial(CONFIGS / "robots" / "six_axis.urdf", "link0", "link6").table
ARMATURE = np.array([0.16, 0.16, 0.1, 0.008, 0.008, 0.008])
K = np.array([1.0, 1.0, 0.8, 0.1, 0.1, 0.1])
GAMMA = np.array([1.0, *[0.1] * 3, *[0.01] * 6])
#: A floor under the slave's tip, 2 cm above the place that the operator wants.
FLOOR = """
[components.floor]
model = "fmus.models.arm_tip"
options = { urdf = "robots/six_axis.urdf", base = "link0", tip = "link6" }
parameters = { k_w = 2000.0, b_w = 50.0, x_w = [0.0, 0.0, 0.52], normal = [0, 0, -1] }
inputs = { q = "slave.q", dq = "slave.dq" }
"""


def run(folder: Path, *settings: str, more: str = "") -> Run:
    """The scenario with `settings`; with `more`, the slave touches what is in it."""
    path = CONFIGS / "task_space.toml"
    if more:
        text = path.read_text().replace('"robots/', f'"{CONFIGS}/robots/')
        text = text.replace(
            '"slave_control.tau" }', '"slave_control.tau", tau_ext = "floor.tau_ext" }'
        )
        path = folder / "more.toml"
        folder.mkdir()
        path.write_text(text + more.replace('"robots/', f'"{CONFIGS}/robots/'))
    simulate(load(path, list(settings)), folder / "run")
    return Run.open(folder / "run")


@pytest.fixture(scope="module")
def free(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return run(tmp_path_factory.mktemp("free"))


def test_arms_that_differ_agree_on_the_place_of_their_tips(free: Run) -> None:
    """All coordinates that they have, over the varying delays, where the operator wants."""
    x = {arm: free.array(f"{arm}_control.x") for arm in ARMS}
    for arm in ARMS:
        own = slice(0, 2 if arm == "planar" else 3)
        assert np.abs(x[arm][0, own] - TARGET[own]).max() > 0.05
        assert np.allclose(x[arm][-1, own], TARGET[own], rtol=0, atol=2e-3)
        assert np.abs(free.array(f"{arm}_control.s")[-1]).max() < 3e-3
    assert not x["planar"][:, 2].any()
    # The hand holds the tip without effort: infinite manipulability.
    assert np.abs(free.array("hand.f_h")[-1]).max() < 0.02
    assert np.abs(free.array("hand.f_h")).max() > 5.0


def test_what_the_tip_leaves_free_returns_to_its_posture(free: Run) -> None:
    """The null motion ends where the posture pulls along no self-motion of the arm."""
    posture = free.metadata["scenario"]["components"]["slave_control"]["parameters"]["q_n"]
    q = free.array("slave.q")[-1]
    J = task_space.jacobian(SLAVE, np.zeros(3), q)
    free_directions = np.linalg.svd(J)[2][3:]
    assert np.abs(free_directions @ (q - posture)).max() < 0.01
    assert np.abs(q - posture).max() > 0.1


@pytest.mark.slow
def test_the_function_of_lyapunov_decreases_by_what_the_feedback_takes(tmp_path: Path) -> None:
    """V = s'(M + J)s/2 + error' Gamma^-1 error/2, dV/dt = -s'(K + J' K_x J)s, of the slave."""
    nothing = "components.slave.parameters.damping=0.0"
    r = run(tmp_path, "run.stop='6 s'", "run.record.every=1", nothing)
    q, s = r.array("slave.q"), r.array("slave_control.s")
    wrong = r.array("slave_control.theta_hat").reshape(-1, 6, 10) - SLAVE.inertia
    power = (K * s**2).sum(axis=1)
    for k in range(len(s)):
        power[k] += K_X * ((task_space.jacobian(SLAVE, np.zeros(3), q[k]) @ s[k]) ** 2).sum()
    lost = np.concatenate([[0.0], np.cumsum(1e-3 * power[:-1])])
    at = range(0, len(s), 50)
    rotors = np.diag(ARMATURE)
    kinetic = [s[k] @ (chain.mass_matrix(SLAVE, q[k]) + rotors) @ s[k] for k in at]
    V = np.array(kinetic) / 2 + (wrong[::50] ** 2 / GAMMA).sum(axis=(1, 2)) / 2
    assert V - V[0] == pytest.approx(-lost[::50], abs=0.02 * lost[-1])
    assert (np.diff(V) < 1e-3 * lost[-1]).all()


@pytest.mark.slow
def test_an_operator_beyond_the_reach_of_the_others_makes_nothing_fast(tmp_path: Path) -> None:
    """The planar arm is stretched, which is singular; joints and torques remain small."""
    r = run(tmp_path, "components.hand.start.x_h=[0.8,0.0,0.45]")
    sigma = {arm: r.array(f"{arm}_control.sigma") for arm in ARMS}
    assert sigma["planar"].min() < 1e-3
    assert sigma["slave"].min() < 0.05
    for arm, rate, torque in (("master", 1.5, 60.0), ("slave", 0.5, 25.0), ("planar", 1.0, 5.0)):
        assert np.abs(r.array(f"{arm}.dq")).max() < rate
        assert np.abs(r.array(f"{arm}_control.tau")).max() < torque
        assert np.abs(r.array(f"{arm}.dq")[-1]).max() < 1e-3
    # The planar arm points from its base at the others, as far as it reaches: 2 m.
    place = r.array("planar_control.x")[-1, :2] / 0.3 + [1.2, 0.0]
    assert np.linalg.norm(place) == pytest.approx(2.0, abs=1e-3)


@pytest.mark.slow
def test_the_force_at_the_slaves_tip_is_felt_by_the_operator(tmp_path: Path) -> None:
    """At rest, f = (K_x + (J K^-1 J')^-1) (lambda alpha / lambda_M) (x1 - x2), of either arm."""
    r = run(tmp_path / "floor", "run.stop='40 s'", more=FLOOR)
    felt, pressed = -r.array("hand.f_h")[-1, 2], -r.array("floor.f_e")[-1, 2]
    apart = r.array("slave_control.x")[-1, 2] - r.array("master_control.x")[-1, 2]
    assert pressed > 0.05
    assert apart > 0.015
    q = r.array("slave.q")[-1]
    J = task_space.jacobian(SLAVE, np.zeros(3), q)
    by_joints = np.linalg.inv(J / K @ J.T)
    stiffness = (K_X * np.eye(3) + by_joints) * LAMBDA * ALPHA / LAMBDA_M
    assert pressed == pytest.approx(stiffness[2, 2] * apart, rel=0.02)
    assert felt == pytest.approx(pressed, rel=0.02)  # K differs, K_x does not


@pytest.mark.slow
def test_arms_that_differ_agree_on_place_and_turn(tmp_path: Path) -> None:
    """configs/robots/turn.toml: from the postures q_0 on, both have turned alike."""
    simulate(load(CONFIGS / "robots" / "turn.toml"), tmp_path / "run")
    r = Run.open(tmp_path / "run")
    places, turns = [], []
    for arm, file, tip in (("left", "fr3", "link7"), ("right", "six_axis", "link6")):
        table = serial(CONFIGS / "robots" / f"{file}.urdf", "link0", tip).table
        given = r.metadata["scenario"]["components"][f"{arm}_control"]["parameters"]
        at = [r.array(f"{arm}.q")[0], r.array(f"{arm}.q")[-1], np.array(given["q_0"])]
        first, last, neutral = (list(chain.placements(table, q))[-1] for q in at)
        turns.append((first[0] @ neutral[0].T, last[0] @ neutral[0].T))
        point = last[0] @ np.array([0.0, 0.0, 0.107 if arm == "left" else 0.0])
        places.append(last[1] + point - given["x_0"])
    apart = [np.arccos((np.trace(a.T @ b) - 1) / 2) for a, b in zip(*turns, strict=True)]
    assert apart[0] > 0.5
    assert apart[1] < 1e-3
    assert np.allclose(*places, rtol=0, atol=5e-4)
