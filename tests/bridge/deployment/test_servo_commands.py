"""Positions that travel to servos over CAN FD, and their status back."""

from __future__ import annotations

import numpy as np

from tests.bridge.deployments import SIX_AXIS_POSITION, named, offline, run_twin, signal

#: Resolution of a commanded position in the frame, rad.
LSB = 2.0**-20


def test_commanded_positions_reach_the_servos_over_the_bus(tmp_path):
    """Each command in one frame, used from one of its servo's steps later until the next one."""
    system = named("six_axis_position", "run.stop=0.4")
    rows = run_twin(system, tmp_path / "twin")
    sent = signal(system, rows, "master_control", "master_command.q_c")
    used = signal(system, rows, "master", "master_servo.q_c")
    assert len(used) == 4 * len(sent) and np.ptp(sent, axis=0).min() > 1e-3
    for k in range(20, 90):
        for step in range(2, 5):
            assert np.abs(used[4 * k + step] - sent[k]).max() <= LSB
    limited = signal(system, rows, "master", "master_servo.clamped")
    heard = signal(system, rows, "master_control", "master_command.clamped")
    assert set(np.unique(heard)) <= {-1.0, 0.0, 1.0}
    assert limited.any() == heard.any()


def test_the_master_moves_over_the_bus_as_without_it(tmp_path):
    """The bus adds 1 to 2 ms: within 10 mrad of the run without a deployment, at up to 2 rad/s."""
    settings = ("run.stop=1.5",)
    system = named("six_axis_position", *settings)
    rows = run_twin(system, tmp_path / "twin")
    alone = offline(SIX_AXIS_POSITION, tmp_path / "run", *settings)
    q = signal(system, rows, "master", "master.q")[::10]
    assert np.ptp(q[:, 0]) > 0.5
    assert np.abs(q[:150] - alone.array("master.q")[:150]).max() < 1e-2
