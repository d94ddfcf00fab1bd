"""Replay: the same bits from sequence numbers, and where they are not the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bridge.deployment.system import make_system
from bridge.native import node as native
from bridge.native.safety import LifeState
from bridge.records.node_lives import ByLife, Life
from bridge.replay import replay, twin
from bridge.wiring.wiring import WiredNode
from cosim.base.errors import ScenarioError
from tests.bridge.deployments import document, named, run_twin, system_of

STOP = "run.stop=3"
CASES = {
    "can": lambda: named("can", STOP),
    "can-classic": lambda: named("can-classic", STOP),
    "network-can": lambda: named("network-can", STOP),
}


@pytest.fixture(params=sorted(CASES))
def recorded(request, tmp_path):
    """(system, rows by node) of a twin."""
    system = CASES[request.param]()
    return system, run_twin(system, tmp_path / "twin")


@pytest.fixture
def arms(tmp_path):
    """(system, copies of the rows by node) of can.toml."""
    system = named("can", STOP)
    return system, ByLife({k: r.copy() for k, r in run_twin(system, tmp_path / "twin").items()})


def replayed(system, rows, folder):
    """The replay of rows, with what the twin or the lives beside `folder` have heard."""
    place = next(
        p for f in (folder, folder.parent) for p in (f / "twin", f / "lives") if p.is_dir()
    )
    return replay.replay(system, rows, replay.received_by_life(place), folder)


def exact(found):
    return found.first is None and found.greatest == 0.0


def test_a_replay_is_the_recording_to_the_bit(recorded, tmp_path):
    system, rows = recorded
    found = replayed(system, rows, tmp_path)
    assert exact(found)
    assert found.alone == ()
    assert found.slots == {name: len(r) for name, r in rows.items()}


def test_nothing_but_sequence_numbers_and_events_is_taken_from_the_recording(arms, tmp_path):
    """Every computed signal is destroyed: the replay finds them all again, and says they differ."""
    system, rows = arms
    wiped = {life: r.copy() for life, r in rows.items()}
    for life, r in wiped.items():
        inputs = [i.target for i in system.nodes[life.node].inlets]
        keep = r["signals"][0].copy()
        r["signals"][1:] = np.nan
        r["sent"][:] = np.nan
        r["signals"][0] = keep
        assert inputs
    found = replayed(system, wiped, tmp_path)
    assert found.first is not None
    again = replay.load(tmp_path)
    for name, r in rows.items():
        assert again[name]["signals"].tobytes() == r["signals"].tobytes()
        for time in ("deadline_ns", "woke_ns"):
            assert again[name][time].tolist() == r[time].tolist()
            assert len(set(r[time])) == len(r)


@pytest.mark.parametrize(
    ("node", "signal", "slot"),
    [
        ("master", "master.q[1]", 1234),
        ("master_control", "master_control.theta_hat[2]", 300),
        ("slave_control", "slave_control.tau[0]", 599),
        ("slave", "slave.dq[0]", 0),
    ],
)
def test_one_bit_altered_is_found(arms, node, signal, slot, tmp_path):
    system, rows = arms
    names = {
        n: s.start + i
        for s in system.nodes[node].plan.slots().values()
        for i, n in enumerate(s.scalars())
    }
    value = rows[node]["signals"][slot, names[signal]]
    altered = (value.view(np.int64) ^ 1).view(np.float64)
    rows[node]["signals"][slot, names[signal]] = altered
    first = replayed(system, rows, tmp_path).first
    assert (first.life, first.slot, first.signal) == (Life(node), slot, signal)
    assert (first.recorded, first.found) == (altered, value)
    assert f"{node}, slot {slot}" in str(first)
    assert signal in str(first)


def test_one_bit_of_what_was_sent_is_found(arms, tmp_path):
    system, rows = arms
    rows["slave"]["sent"][77, 2] += 1e-9
    first = replayed(system, rows, tmp_path).first
    assert (first.life, first.slot, first.signal) == (Life("slave"), 77, "sent slave.dq[0]")


def test_another_sample_than_was_held_is_found_where_it_was_used(arms, tmp_path):
    system, rows = arms
    inlets = [i.target.name for i in system.nodes["master"].inlets]
    rows["master"]["inlets"]["held"][1000, inlets.index("master.tau")] -= 1
    first = replayed(system, rows, tmp_path).first
    assert (first.life, first.slot) == (Life("master"), 1001)  # row k+1 shows what tick k did


def test_an_event_of_the_life_cycle_that_did_not_happen_is_found(arms, tmp_path):
    system, rows = arms
    rows["slave_control"]["now"][200] = 1
    first = replayed(system, rows, tmp_path).first
    assert (first.life, first.slot) == (Life("slave_control"), 200)
    assert first.signal.startswith("sent slave_control.tau")


def changed(name, path, value):
    """A deployment with one value changed."""
    found = document(name)
    *parents, last = path.split(".")
    table = found
    for part in parents:
        table = table[part]
    table[last] = value
    return found


STOPS = {"tau_max": 5, "stops": ["torque"]}


@pytest.mark.parametrize(
    ("name", "path", "value", "node"),
    [
        ("can", "nodes.master_control.guard", STOPS, "master_control"),
        ("can-classic", "nodes.slave_control.guard", STOPS, "slave_control"),
        ("can-classic", "messages.TAU_2.period", "500 ms", "master"),
        ("can-classic", "messages.VEL_1.period", "500 ms", "master_control"),
        ("can", "messages.LINK_4.period", "250 ms", "slave"),
    ],
)
def test_runs_that_were_stopped_replay_too(name, path, value, node, tmp_path):
    """By a guard, a drive's watchdog, an input that stays away."""
    system = system_of(changed(name, path, value), tmp_path, STOP)
    rows = run_twin(system, tmp_path / "twin")
    assert rows[node]["state"][-1] == LifeState.FAULT
    found = replayed(system, rows, tmp_path)
    assert exact(found), str(found.first)
    del rows[Life(node)]
    assert exact(replayed(system, rows, tmp_path))


# ---- journals that are not there, or not to the end ---------------------------------------------


@pytest.mark.parametrize("missing", ["master", "slave_control", "master_control"])
def test_a_journal_that_is_missing_is_stood_in_for_by_what_others_received(arms, missing, tmp_path):
    system, rows = arms
    del rows[Life(missing)]
    found = replayed(system, rows, tmp_path)
    assert exact(found)
    sent = {name for name, m in system.messages.items() if m.node == missing}
    assert found.alone == tuple(sorted(sent))


def test_any_one_journal_is_enough(recorded, tmp_path):
    system, rows = recorded
    for name, r in rows.items():
        folder = tmp_path / f"only {name}"
        folder.mkdir()
        found = replayed(system, {name: r}, folder)
        assert exact(found)
        assert found.alone == system.received_by(name.node)


@pytest.mark.parametrize("node", ["master", "master_control", "slave"])
@pytest.mark.parametrize("share", [0.0, 0.31, 0.99])
def test_a_journal_that_was_cut_off_is_replayed_as_far_as_it_goes(arms, node, share, tmp_path):
    system, rows = arms
    rows[Life(node)] = rows[node][: max(1, int(share * len(rows[node])))]
    found = replayed(system, rows, tmp_path)
    assert exact(found)
    assert found.slots[Life(node)] == len(rows[node])
    assert set(found.alone) == {n for n, m in system.messages.items() if m.node == node}


def test_rows_that_are_missing_in_the_middle_are_said(arms, tmp_path):
    system, rows = arms
    rows[Life("slave")] = np.delete(rows["slave"], np.s_[100:200])
    with pytest.raises(ScenarioError, match="slave: slot 200 comes after slot 99; rows"):
        replayed(system, rows, tmp_path)


# ---- a node that was killed and started again ---------------------------------------------------


def with_restart(system, folder: Path, node: str, dies: float, again: float):
    """A twin in which a node is gone from `dies` to `again`, s; rows by life."""
    folder.mkdir()
    wired = {n: make(system, n, folder / f"{n}.journal", 0.0) for n in system.nodes}
    everybody = dict(wired)
    try:
        go(system, wired, dies)
        first = wired.pop(node)
        go(system, wired, again)
        life = Life(node, 2)
        fresh = make_system(system.scenario, system.deployment)
        everybody[life] = make(fresh, node, folder / life.file("journal"), again, boots=1)
        wired[life] = everybody[life]
        order = [life if n == node else n for n in system.nodes]
        go(system, {n: wired[n] for n in order}, system.plan.ticks * system.plan.h)
        assert first.struct.slot < first.plan.slots
    finally:
        for w in everybody.values():
            w.__exit__()
    return replay.load(folder)


def make(system, node, path, t, boots=0):
    wired = WiredNode(
        system, node, twin.memory_buses(system, node), path, native.SIMULATED, boots=boots
    )
    wired.__enter__()
    s = wired.struct
    s.slot = s.first = round(t / wired.plan.h)
    s.life.state, s.life.armed = LifeState.ACTIVE, 1
    for i in range(s.n_inlets):
        wired.inlet_bindings.inlets[i].heard_ns = s.slot * s.h_ns
    native.functions().node_enable(s, s.slot * s.h_ns)
    return wired


def go(system, wired, until):
    """All nodes to t = `until`, s."""
    for w in wired.values():
        w.struct.slots = round(until / w.plan.h)
    twin.run(system, wired)


@pytest.mark.parametrize(
    ("node", "again"),
    [("slave_control", 1.05), ("slave_control", 2.0), ("master", 1.05), ("master_control", 1.5)],
)
def test_a_second_life_is_replayed_too(node, again, tmp_path):
    system = named("can", STOP)
    rows = with_restart(system, tmp_path / "lives", node, 1.0, again)
    assert set(rows) == {*map(Life, system.nodes), Life(node, 2)}
    assert rows[Life(node, 2)]["slot"][0] * system.nodes[node].h == pytest.approx(again)
    found = replayed(system, rows, tmp_path)
    assert exact(found), str(found.first)
    assert found.alone == ()


def test_a_node_killed_between_sending_and_its_row_is_no_obstacle(tmp_path):
    """The frame is out, the row is not: what was sent is taken from who received it."""
    system = named("can", STOP)
    rows = with_restart(system, tmp_path / "lives", "slave_control", 1.0, 1.05)
    rows[Life("slave_control")] = rows["slave_control"][:-1]
    found = replayed(system, rows, tmp_path)
    assert exact(found), str(found.first)
    assert found.alone == ("LINK_4",)


def test_a_robot_of_the_network_that_was_away(tmp_path):
    system = named("network-can", STOP)
    rows = with_restart(system, tmp_path / "lives", "robot3", 1.0, 1.6)
    assert exact(replayed(system, rows, tmp_path))
    whole = run_twin(system, tmp_path / "twin")
    slot = system.nodes["robot3"].plan.slots()["control3.w"]
    again = rows["robot3@2"]["signals"][:, slot.start]
    assert again.tolist() == whole["robot3"]["signals"][1600:, slot.start].tolist()


# ---- what is not a recording of this ------------------------------------------------------------


def test_a_folder_without_journals_is_said(tmp_path):
    with pytest.raises(ScenarioError, match=r"no journals \(\*\.journal\) of nodes"):
        replay.load(tmp_path)


def test_rows_of_another_deployment_are_refused(arms, tmp_path):
    system, rows = arms
    found = document()
    found["messages"]["LINK_2"]["carries"] = ["master_control.xi", "master_control.tau"]
    found["messages"]["LINK_2"]["signals"] = ["xi1", "xi2", "tau1", "tau2"]
    found["messages"]["STATE_1"] |= {"carries": ["master.q", "master.dq", "master.tau_h"]}
    found["messages"]["STATE_1"]["signals"] = ["q1", "q2", "dq1", "dq2"]
    with pytest.raises(ScenarioError, match="4 signals for 6 values"):
        system_of(found, tmp_path, STOP)
    rows[Life("master")] = rows["slave_control"]
    with pytest.raises(ScenarioError, match="master was recorded with other signals"):
        replayed(system, rows, tmp_path)
