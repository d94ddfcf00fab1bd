"""Two arms of seven joints under the paper's law: what Theorem 5 says, in the shipped scenario."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.engine.simulate import simulate
from cosim.loading.files import load
from cosim.record import Run
from fmus.arms import chain
from fmus.arms.body import Placement, RigidBody
from fmus.arms.serial import serial

ROBOTS = Path(__file__).parents[2] / "configs" / "robots"
Q_H = np.array([0.5, -0.3, 0.3, -1.8, 0.4, 2.0, 0.3])
GAMMA = np.array([100.0, *[10.0] * 3, *[1.0] * 6])
K, ALPHA, LAMBDA, LAMBDA_M, K_P, ARMATURE = 10.0, 0.5, 2.0, 10.0, 10.0, 0.1
#: The slave reaches a wall at its fourth joint, 0.1 rad before the place the operator wants.
FREE = [0, 1, 2, 4, 5, 6]
WALL = [
    "components.slave.parameters.k_w=[0,0,0,200,0,0,0]",
    "components.slave.parameters.b_w=[0,0,0,10,0,0,0]",
    "components.slave.parameters.q_w=[0,0,0,-1.9,0,0,0]",
    "components.slave.start.q=[0.4,-0.2,-0.3,-2.0,0.3,1.4,0.2]",
]


def run(folder: Path, *settings: str) -> Run:
    simulate(load(ROBOTS / "fr3.toml", list(settings)), folder)
    return Run.open(folder)


@pytest.fixture(scope="module")
def contact(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return run(tmp_path_factory.mktemp("contact") / "run", *WALL)


def test_arms_of_seven_joints_agree_over_the_varying_delay(contact: Run) -> None:
    """All joints but the one at the wall; the operator holds nothing there."""
    master, slave = contact.array("master.q"), contact.array("slave.q")
    assert np.abs(master[0] - slave[0]).max() > 0.4
    for q in (master, slave):
        assert np.allclose(q[-1, FREE], Q_H[FREE], rtol=0, atol=2e-3)
    assert np.abs(contact.array("master.tau_h")[-1, FREE]).max() < 5e-3


def test_the_torque_at_the_wall_is_felt_by_the_operator(contact: Run) -> None:
    """At rest, tau_h = tau_e = (lambda alpha K / lambda_M)(q1 - q2): from (74) to (81)."""
    master, slave = contact.array("master.q")[-1, 3], contact.array("slave.q")[-1, 3]
    felt, on_wall = contact.array("master.tau_h")[-1, 3], contact.array("slave.tau_e")[-1, 3]
    stiffness = LAMBDA * ALPHA * K / LAMBDA_M
    # In series: the grip, the coupling and the wall.
    expected = (Q_H[3] + 1.9) / (1 / K_P + 1 / stiffness + 1 / 200.0)
    assert on_wall == pytest.approx(expected, rel=5e-3)
    assert felt == pytest.approx(on_wall, rel=5e-3)
    assert stiffness * (master - slave) == pytest.approx(on_wall, rel=5e-3)


def test_s_vanishes_where_nothing_pushes_and_the_estimates_adapt_and_settle(contact: Run) -> None:
    for name in ("master_control", "slave_control"):
        s, estimate = contact.array(f"{name}.s"), contact.array(f"{name}.theta_hat")
        assert np.abs(s[-1, FREE]).max() < 1e-3 * np.abs(s).max()
        assert np.abs(K * s[-1, 3]) == pytest.approx(contact.array("slave.tau_e")[-1, 3], rel=5e-3)
        assert not estimate[0].any()
        assert np.linalg.norm(estimate[-1]) > 0.1
        change = np.abs(estimate[-1] - estimate[len(estimate) // 2])
        assert change.max() < 0.01 * np.abs(estimate[-1]).max()


@pytest.mark.slow
def test_the_function_of_lyapunov_decreases_in_an_arm_that_nothing_pushes(tmp_path: Path) -> None:
    """V = s'(M + J)s/2 + (theta_hat - theta)' Gamma^-1 (theta_hat - theta)/2, dV/dt = -s'K s."""
    payload = RigidBody.about_centre(
        1.0, np.zeros((3, 3)), Placement(np.eye(3), np.array([0, 0, 0.15]))
    )
    table = serial(ROBOTS / "fr3.urdf", "link0", "link7", payload=payload).table
    free = run(tmp_path / "run", "run.stop='10 s'")
    q, s = free.array("slave.q"), free.array("slave_control.s")
    estimate = free.array("slave_control.theta_hat").reshape(-1, 7, 10)
    wrong = estimate - table.inertia
    lost = np.concatenate([[0.0], np.cumsum(1e-3 * K * (s[:-1] ** 2).sum(axis=1))])
    at = range(0, len(s), 50)
    kinetic = [s[k] @ (chain.mass_matrix(table, q[k]) + ARMATURE * np.eye(7)) @ s[k] for k in at]
    V = np.array(kinetic) / 2 + (wrong[::50] ** 2 / GAMMA).sum(axis=(1, 2)) / 2
    started = V - V[0]
    assert started == pytest.approx(-lost[::50], abs=0.02 * lost[-1])
    assert (np.diff(V) < 1e-3 * lost[-1]).all()
