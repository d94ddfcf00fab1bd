"""Old torques move no drive and feed no watchdog, however slowly they have grown old."""

from __future__ import annotations

from pathlib import Path

import pytest

from bridge.campaign import compressed
from bridge.deployment.system import load_system, make_system
from bridge.faults import load
from bridge.native.safety import DriveState
from bridge.results import verdict
from bridge.results.verdict import Word
from cosim.base.errors import ScenarioError
from cosim.loading.files import read_document
from cosim.scenario.spec import build
from tests.bridge.deployments import TELEOPERATION, document, named, system_of
from tests.bridge.heard_alone import alone, torque

N = 300  # samples of 5 ms
CARRIERS = [("can", "LINK_2", [3.0, 2.0, 0.0, 0.0]), ("can-classic", "TAU_2", [3.0, 2.0])]


def creeping(k, step):
    """The delay grows five times, s."""
    return 0.0005 + step * min(5, k // 40)


@pytest.mark.parametrize(("name", "message", "values"), CARRIERS)
def test_a_delay_that_creeps_trips_the_watchdog(tmp_path, name, message, values):
    """5 x 70 ms, each less than the 100 ms of the watchdog, and about a turn of a short stamp."""
    with alone(named(name), "master", tmp_path) as node:
        for k in range(N):
            node.say(message, k, values, creeping(k, 0.07))
        rows = node.run(1.5)
        (drive,) = node.wired.drives
        counts = node.counts(message)
        assert drive.state is DriveState.FAULT and drive.struct.faults == 1
        assert counts.stale > 100 and counts.ok == N - 70  # what has not come by then: 350 ms
        held = rows["inlets"]["held"][:, 0]
        old = rows["slot"] * 1_000_000 - held * 5_000_000
        assert old[(torque(rows, node) == values[:2]).all(axis=1)].max() <= 210_000_000


@pytest.mark.parametrize(("name", "message", "values"), CARRIERS)
def test_what_is_as_old_as_the_watchdog_waits_is_still_given(tmp_path, name, message, values):
    with alone(named(name), "master", tmp_path) as node:
        for k in range(N):
            node.say(message, k, values, creeping(k, 0.017))
        node.run(1.5)
        assert node.wired.drives[0].state is DriveState.ENABLED
        assert node.counts(message).stale == 0


def test_a_deployment_that_says_so_takes_older_ones(tmp_path):
    found = document("can")
    found["nodes"]["master"]["drive"]["max_age"] = "0.5 s"
    with alone(system_of(found, tmp_path), "master", tmp_path) as node:
        for k in range(N):
            node.say("LINK_2", k, [3.0, 2.0, 0.0, 0.0], creeping(k, 0.07))
        node.run(1.5)
        assert node.wired.drives[0].state is DriveState.ENABLED
        assert node.counts("LINK_2").stale == 0


@pytest.mark.parametrize("age", [0, -1, "nan"])
def test_an_age_that_cannot_be_is_refused(tmp_path, age):
    found = document("can")
    found["nodes"]["master"]["drive"]["max_age"] = age
    with pytest.raises(ScenarioError, match="max_age"):
        system_of(found, tmp_path)


def test_a_delay_that_creeps_is_in_the_verdict(tmp_path):
    system = load_system(TELEOPERATION, "can", ["run.stop=2.0"])
    table = {"kind": "delay", "node": "master", "message": "LINK_2", "probability": 1.0}
    steps = [
        {**table, "from": 0.5 + 0.2 * n, "to": 0.7 + 0.2 * n, "by": 0.07 * (n + 1)}
        for n in range(5)
    ]
    script = load.build({"seed": 1, "fault": steps}, Path("creeping.toml"))
    outcome = compressed.run(system, script, tmp_path)
    found = verdict.judge(system, outcome)
    assert found.word is Word.FAILED and "older than its drive allows" in found.text()
    assert outcome.replayed is not None and outcome.replayed.first is None


def delayed(delay):
    """The teleoperator with a link of torques to the master, in place of a wire."""
    scenario = read_document(TELEOPERATION)
    scenario["components"]["master"]["inputs"] = {}
    way = {"from": "master_control.tau", "to": "master.tau", "semantics": "newest-stamp"}
    scenario["links"].append({**way, "delay": {"law": "constant", "delay": delay}})
    return make_system(build(scenario, TELEOPERATION), named("can").deployment)


def test_the_age_that_a_law_adds_counts(tmp_path):
    """A link of torques whose delay is beyond the bound: none acts."""
    with alone(delayed("150 ms"), "master", tmp_path) as node:
        for k in range(100):
            node.say("LINK_2", k, [3.0, 2.0, 0.0, 0.0], 0.0005)
        rows = node.run(0.5)
        assert rows["inlets"]["held"][-1, 0] > 50
        assert not torque(rows, node)[rows["slot"] < 100].any()
        assert node.wired.drives[0].state is DriveState.FAULT
        assert node.counts("LINK_2").stale > 50


@pytest.mark.parametrize(("max_age", "given"), [(0, True), (49_500_000, True), (49_499_999, False)])
def test_a_torque_is_given_up_to_exactly_the_age_allowed(tmp_path, max_age, given):
    """Sample 0 alone, sent at 0.5 ms and held from 50 ms on; the bound is in ns, 0 means none."""
    with alone(delayed("49.5 ms"), "master", tmp_path) as node:
        (inlet,) = (i for i in node.wired.inlet_bindings.inlets if i.drive)
        inlet.max_age_ns = max_age
        node.say("LINK_2", 0, [3.0, 2.0, 0.0, 0.0])
        rows = node.run(0.08)
        assert rows["slot"][rows["inlets"]["held"][:, 0] == 0][0] == 50
        assert torque(rows, node)[rows["slot"] >= 50].any() == given
