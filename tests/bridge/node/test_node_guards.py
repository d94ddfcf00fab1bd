"""Every guard trips in a node, on the simulated clock: the bit, the stop, the torque left."""

from __future__ import annotations

import numpy as np
import pytest

from bridge.deployment.system import load_system
from bridge.native.safety import GuardBit, LifeState, Why
from bridge.replay import replay, twin
from tests.bridge.deployments import TELEOPERATION, document, run_twin, signal, system_of

GUARD = "deploy.nodes.master_control.guard"
#: Drives its arm; the master's controller only holds it back at first.
PUSHES = {"power": "slave_control"}
TRIPS = {
    "torque": ('tau_max="5 N.m"', GuardBit.TORQUE, Why.GUARD),
    "rate": ('rate_max="10 N.m/s"', GuardBit.RATE, Why.GUARD),
    "position": ('q_low="-10 rad",q_high="-0.9 rad"', GuardBit.POSITION, Why.GUARD),
    "velocity": ('dq_max="0.01 rad/s"', GuardBit.VELOCITY, Why.GUARD),
    "power": ('power_max="0.01 W"', GuardBit.POWER, Why.GUARD),
    "jump": ('q_jump="0.0001 rad"', GuardBit.JUMP, Why.JUMP),
}


def run(folder, *settings):
    system = load_system(TELEOPERATION, "can", ["run.stop=0.6", *settings])
    twin.simulate(system, folder)
    return system, replay.load(folder)


@pytest.mark.parametrize("name", TRIPS)
def test_a_guard_stops_its_node(tmp_path, name):
    limit, bit, why = TRIPS[name]
    node = PUSHES.get(name, "master_control")
    other = {"master_control": "slave_control"}.get(node, "master_control")
    setting = f'deploy.nodes.{node}.guard={{{limit},stops=["{name}"]}}'
    _, rows = run(tmp_path, setting, "run.stop=2" if name == "power" else "run.stop=0.6")
    mine = rows[node]
    tripped = int(np.flatnonzero(mine["guard"] & bit)[0])
    assert mine["state"][tripped] == LifeState.ACTIVE
    assert mine["state"][tripped + 1] == LifeState.STOPPING
    assert mine["state"][-1] == LifeState.FAULT
    assert mine["reasons"][-1] & why
    tau = mine["sent"][:, :2]
    assert np.isfinite(tau).all()
    assert not tau[mine["state"] == LifeState.FAULT].any()
    scale = mine["scale"][tripped + 1 :]
    assert (np.diff(scale) <= 0).all()
    assert ((scale > 0) & (scale < 1)).sum() >= 18  # 0.1 s of 5 ms
    assert rows[other]["state"][-1] == LifeState.ACTIVE  # does not require the other arm


@pytest.mark.parametrize("name", ["torque", "jump"])
def test_a_run_that_a_guard_has_stopped_replays_exactly(tmp_path, name):
    (tmp_path / "again").mkdir()
    system, rows = run(tmp_path, f'{GUARD}={{{TRIPS[name][0]},stops=["{name}"]}}')
    found = replay.replay(system, rows, replay.received_by_life(tmp_path), tmp_path / "again")
    assert found.first is None


def test_a_guard_that_does_not_stop_limits(tmp_path):
    _, rows = run(tmp_path, f'{GUARD}={{tau_max="5 N.m",stops=[]}}')
    mine = rows["master_control"]
    assert mine["state"][-1] == LifeState.ACTIVE
    assert np.abs(mine["sent"][:, :2]).max() == pytest.approx(5.0, abs=1e-6)
    assert mine["guard"].any()


def test_a_guard_sees_its_own_component_and_limits_its_torque_only(tmp_path):
    """Both controllers in one node; each torque stands behind xi in its message."""
    found = document("zenoh")
    found["nodes"] = {
        "arms": {"components": ["master", "slave"], "number": 1},
        "control": {
            "components": ["master_control", "slave_control"],
            "number": 2,
            "guard": {"tau_max": "0.5 N.m", "q_low": "-10 rad", "q_high": "0.9 rad", "stops": []},
        },
    }
    found["buses"]["net"]["options"] = {}
    found["messages"] = {
        name: {"bus": "net", "carries": [f"{part}.{port}" for port in ports]}
        for name, part, ports in (
            ("state_m", "master", ("q", "dq")),
            ("state_s", "slave", ("q", "dq")),
            ("torque_m", "master_control", ("xi", "tau")),
            ("torque_s", "slave_control", ("xi", "tau")),
        )
    }
    system = system_of(found, tmp_path, "run.stop=1")
    rows = run_twin(system, tmp_path / "run")
    sent = rows["control"]["sent"].reshape(-1, 2, 4)
    beyond = [False] * len(sent)
    for i, part in enumerate(("master_control", "slave_control")):
        q, tau, xi = (
            signal(system, rows, "control", f"{part}.{port}") for port in ("q", "tau", "xi")
        )
        beyond |= (q > 0.9).any(axis=1)
        limited = np.where(q > 0.9, np.clip(tau, -0.5, 0), np.clip(tau, -0.5, 0.5))
        assert np.array_equal(sent[:, i, :2], xi) and np.abs(xi).max() > 0.5
        assert np.array_equal(sent[:, i, 2:], limited) and np.abs(tau).max() > 0.5
    assert np.array_equal(rows["control"]["guard"] & GuardBit.POSITION != 0, beyond)
    assert 0 < beyond.sum() < len(beyond)
