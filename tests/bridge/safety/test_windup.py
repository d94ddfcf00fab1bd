"""A guard takes torque away: a controller that does not know it winds its estimates up."""

from __future__ import annotations

import numpy as np
import pytest

from bridge.faults.load import build
from bridge.node.fault_injection import inject
from bridge.preflight import deployment
from bridge.replay import replay, twin
from tests.bridge.deployments import document, named, signal, system_of

UNAWARE = [f"components.{arm}_control.parameters.tau_max=1e9" for arm in ("master", "slave")]
#: The encoders of one arm are heard 60 ms late, for 2 s: its control loop oscillates, and the guard
#: is at its limit. A host whose threads wait for a processor does the same.
LATE = {
    "kind": "delay", "node": "master_control", "message": "STATE_1", "by": 0.06,
    "from": 5.0, "to": 7.0,
}  # fmt: skip


def simulated(folder, *settings):
    """Greatest estimate, and how far the arms are apart at the end, of a twin of a soak."""
    calm = [
        "run.step='5 ms'", "run.stop='20 s'", "deploy.latency=false",
        'deploy.nodes.master_control.stale={"master_control.q"={stop="500 ms"}}',
        "deploy.nodes.master.drive.watchdog='500 ms'",
    ]  # fmt: skip
    system = named("can", *calm, *settings)
    script = build({"title": "late", "seed": 1, "fault": [LATE]}, folder / "script.toml")
    alive = []

    def faulty(node):
        alive.append(inject(node, script, folder / f"{node.name}.faults"))

    with twin.wired_nodes(system, folder, faulty) as nodes:
        twin.run(system, nodes)
    rows = replay.load(folder)
    theta = signal(system, rows, "master_control", "master_control.theta_hat")
    q = [signal(system, rows, arm, f"{arm}.q")[-1] for arm in ("master", "slave")]
    return float(np.abs(theta).max()), float(np.abs(q[0] - q[1]).max())


def test_a_controller_that_knows_its_limit_recovers(tmp_path):
    (tmp_path / "aware").mkdir()
    (tmp_path / "unaware").mkdir()
    greatest, apart = simulated(tmp_path / "aware")
    assert greatest < 10 and apart < 0.05
    greatest, apart = simulated(tmp_path / "unaware", *UNAWARE)
    assert greatest > 100 and apart > 0.3  # what the deployments did before


def findings(system):
    return [f for f in deployment.check(system) if f.rule == "windup"]


def test_a_controller_that_does_not_know_its_guard_is_a_warning(tmp_path):
    found = findings(named("can", *UNAWARE[:1]))
    assert [(f.where, f.number, f.severity) for f in found] == [("master_control", 1e9, "warning")]
    assert "components.master_control.parameters.tau_max" in found[0].advice
    assert findings(named("can", *(s.replace("1e9", "99") for s in UNAWARE))) == []
    tighter = document("can")
    tighter["nodes"]["slave_control"]["guard"]["tau_max"] = ["50 N.m", "60 N.m"]
    assert [f.where for f in findings(system_of(tighter, tmp_path))] == ["slave_control"]


@pytest.mark.parametrize("name", ["can", "zenoh"])
def test_a_guard_without_a_limit_of_torque_needs_none(tmp_path, name):
    found = document(name)
    for node in found["nodes"].values():
        if "guard" in node:
            del node["guard"]["tau_max"]
    found["set"] = {}
    assert findings(system_of(found, tmp_path)) == []
