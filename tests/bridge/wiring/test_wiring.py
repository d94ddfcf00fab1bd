"""A node's struct against its deployment, in numbers worked out by hand; and what lives share."""

from __future__ import annotations

import ctypes as c

import numpy as np
import pytest

from bridge.native import node as native
from bridge.native.vendor import VendorFault
from bridge.wiring.wiring import WiredNode, heard_dtype, heard_rows, row_dtype
from cosim.base.errors import RunError
from cosim.native import structs
from cosim.native.enums import Code
from tests.bridge.deployments import NETWORK, document, named, system_of
from tests.bridge.slots import Slots

SHORT = "run.stop=0.2"
MS = 1_000_000  # ns


def changed(tmp_path, nodes, name="can", settings=(SHORT,), **others):
    """A deployment with other values of its nodes and of itself."""
    found = document(name) | others
    for node, values in nodes.items():
        found["nodes"][node] |= values
    return system_of(found, tmp_path, *settings)


# ---- time ----------------------------------------------------------------------------------------


def test_times_of_a_node_are_those_of_its_deployment(wired, tmp_path):
    nodes = {
        "master": {"heartbeat": "20 ms", "overrun": "30 ms"},
        "master_control": {"phase": "0.7 ms", "heartbeat": "18 ms", "overrun": "40 ms"},
        "slave_control": {"heartbeat": 0.0},
    }
    system = changed(tmp_path, nodes, sync="master", patience=7.5)
    arm, control, slave = (
        wired(system, name).struct for name in ("master", "master_control", "slave_control")
    )
    assert (arm.h_ns, control.h_ns) == (1 * MS, 5 * MS)
    assert (arm.slots, control.slots) == (200, 40)
    assert (arm.phase_ns, control.phase_ns) == (0, 700_000)
    assert (arm.overrun_ns, control.overrun_ns) == (30 * MS, 40 * MS)
    assert arm.patience_ns == control.patience_ns == 7_500 * MS
    # 18 ms are 3.6 slots of 5 ms; 0 is no heartbeat.
    assert (arm.heartbeat_slots, control.heartbeat_slots, slave.heartbeat_slots) == (20, 4, 0)
    assert control.sync_slots == slave.sync_slots == 0
    assert arm.sync_slots == system.sync_ticks


def test_a_heartbeat_that_is_faster_than_the_slots_comes_in_each(wired, tmp_path):
    system = changed(tmp_path, {"master_control": {"heartbeat": "1 ms"}})
    assert wired(system, "master_control").struct.heartbeat_slots == 1


def test_a_node_that_is_no_drive_of_time_counts_its_own_slots_for_the_sync(wired, tmp_path):
    system = changed(tmp_path, {}, sync="master_control")
    assert wired(system, "master_control").struct.sync_slots == max(1, system.sync_ticks // 5)
    assert wired(system, "master").struct.sync_slots == 0


def test_a_gateway_moves_nothing_and_may_be_late(wired):
    system = named("gateway", SHORT)
    gateways = [n for n, spec in system.deployment.nodes.items() if not spec.components]
    for name in gateways:
        struct = wired(system, name).struct
        assert struct.overrun_ns == 0 and struct.gateway == 1
    others = set(system.nodes) - set(gateways)
    assert gateways and all(wired(system, name).struct.gateway == 0 for name in others)


def test_peers_are_those_that_are_heard_and_some_of_them_are_required(wired, tmp_path):
    system = changed(
        tmp_path, {"master_control": {"requires": ["slave_control"], "within": "80 ms"}}
    )
    node = wired(system, "master_control")
    numbers = {name: spec.number for name, spec in system.deployment.nodes.items()}
    required = {p.number for p in node.peers.values() if p.required}
    assert required == {numbers["slave_control"]}
    assert {p.number for p in node.peers.values()} == {numbers[n] for n in node.peers}
    assert node.struct.n_peers == len(node.peers)
    assert {p.heartbeat.timeout_ns for p in node.peers.values() if p.required} == {80 * MS}


# ---- rows ----------------------------------------------------------------------------------------


def test_a_row_has_room_for_what_the_node_sends_hears_and_computes():
    system = named("can", SHORT)
    plan = system.nodes["master_control"]
    row = row_dtype(plan)
    assert row["inlets"].shape == (len(plan.inlets),)
    assert row["sent"].shape == (4,)  # tau and xi of two joints
    assert row["signals"].shape == (plan.plan.n_signals,)
    # Six times, six fields of four bytes, the scale, and a set of drives: nothing between them.
    head = 6 * 8 + 6 * 4 + 8 + 8
    assert row.itemsize == head + 8 * (5 * len(plan.inlets) + 4 + plan.plan.n_signals)


def test_what_is_heard_has_the_width_of_the_widest_message(tmp_path):
    system = named("can", SHORT)
    assert heard_dtype(system, "master")["values"].shape == (4,)
    # 0.2 s of a message every 5 ms: 40, a quarter more, and 64.
    assert heard_rows(system, "master") == 50 + 64


# ---- a life that begins in the middle of a run ---------------------------------------------------


def test_a_life_that_cannot_begin_says_so_to_c(wired, monkeypatch):
    node = wired(named("can", SHORT), "master_control")
    begun = []
    monkeypatch.setattr(WiredNode, "begin", lambda self, slot: begun.append(slot))
    assert node._join(7) == 0 and node.failed == "" and begun == [7]

    def fails(self, slot):
        raise RunError("the model has no past")

    monkeypatch.setattr(WiredNode, "begin", fails)
    assert node._join(8) == 1 and "the model has no past" in node.failed


def test_inputs_keep_what_was_heard_before_a_life_and_outputs_begin_again(tmp_path):
    with Slots(named("can", SHORT), "master_control", tmp_path) as slots:
        node = slots.wired
        signals, plan = node.engine.signals, node.plan
        fresh = signals.copy()
        heard = np.zeros(signals.size, bool)
        for inlet in plan.inlets:
            heard[inlet.target.start : inlet.target.start + inlet.target.size] = True
        marked = np.where(heard, 100.0 + np.arange(signals.size), -1.0)
        signals[:] = marked
        node.begin(20)
        found = node.engine.signals
        assert (found[heard] == marked[heard]).all()
        assert not (found[~heard] == -1.0).any()
        assert fresh.shape == found.shape


def test_the_rows_of_all_tables_of_a_node_are_where_c_moves_them(tmp_path):
    """Each address is that of the counter in the engine's own struct, for the operation's table."""
    found = document("network-can")
    halves = {"left": (1, 2, 3), "right": (4, 5, 6)}
    found["nodes"] = {
        name: {"components": [f"{x}{i}" for i in half for x in ("robot", "control")], "number": n}
        for n, (name, half) in enumerate(halves.items(), 1)
    }
    system = system_of(found, tmp_path, "run.stop=1", scenario=NETWORK)
    with Slots(system, "left", tmp_path) as slots:
        state, struct = slots.wired.engine.state, slots.struct
        operations = [
            o
            for o in slots.wired.plan.plan.operations
            if o.code in (Code.PLAY, Code.PULL, Code.PUSH)
        ]
        assert len({o.index for o in operations if o.code == Code.PULL}) > 1
        assert struct.n_played == len(operations)
        players = c.cast(state.players, c.POINTER(structs.PlayerStruct))
        links = c.cast(state.links, c.POINTER(structs.LinkStruct))
        for number, o in enumerate(operations):
            if o.code == Code.PLAY:
                players[o.index].row = 1000 + number
            elif o.code == Code.PULL:
                links[o.index].row = 1000 + number
            else:
                links[o.index].before = 1000 + number
            assert c.c_int64.from_address(struct.played[number].row).value == 1000 + number
            assert struct.played[number].period == o.period


# ---- inlets --------------------------------------------------------------------------------------


def test_the_silence_that_an_input_bears(wired, tmp_path):
    """That of its own, else the deployment's, but four periods of its message at the least."""
    nodes = {"master_control": {"stale": {"master_control.q": {"stop": "70 ms"}}}}
    for silence, expected in (("2 s", 2_000 * MS), ("1 ms", 20 * MS), (0.0, 0)):
        system = changed(tmp_path, nodes, silence=silence)
        node = wired(system, "master_control")
        by_port = {
            inlet.target.port: entry
            for inlet, entry in zip(node.plan.inlets, node.inlet_bindings.inlets, strict=False)
        }
        assert by_port["q"].stop_ns == 70 * MS
        assert by_port["xi_in"].stop_ns == expected
        awaited = {m: bool(r.awaited) for m, r in node.inlet_bindings.receptions.items()}
        assert awaited == {"STATE_1": True, "LINK_4": expected > 0}


@pytest.mark.parametrize(
    ("of_message", "of_drive", "least"), [(0.0, 40, 40), ("30 ms", 40, 30), ("50 ms", 40, 40)]
)
def test_the_age_of_a_torque_is_that_of_its_message_or_of_its_drive(
    wired, tmp_path, of_message, of_drive, least
):
    found = document("can")
    found["messages"]["LINK_2"]["max_age"] = of_message
    found["nodes"]["master"]["drive"]["max_age"] = f"{of_drive} ms"
    system = system_of(found, tmp_path, SHORT)
    receptions = wired(system, "master").inlet_bindings.receptions
    assert receptions["LINK_2"].max_age_ns == least * MS
    other = wired(system, "slave_control").inlet_bindings.receptions
    assert other["LINK_2"].max_age_ns == (0 if not of_message else int(of_message.split()[0]) * MS)


def test_an_inlet_takes_its_values_from_where_they_are_and_puts_them_where_they_belong(wired):
    node = wired(named("can", SHORT), "master")
    (inlet,) = [i for i in node.plan.inlets if i.target.port == "tau"]
    entry = node.inlet_bindings.inlets[node.plan.inlets.index(inlet)]
    slots = node.plan.plan.slots()
    assert (entry.first, entry.count, entry.target) == (0, 2, slots["master.tau"].start)
    assert (entry.q, entry.dq) == (slots["master.q"].start, slots["master.dq"].start)
    assert entry.max_age_ns == 100 * MS  # the watchdog
    assert entry.period == 1 and entry.link_age == -1 and entry.later == 1
    (sent,) = node.outlet_bindings.outlets[:1]
    assert (sent.measured_q, sent.measured_dq) == (0, 2)
    assert (sent.every, sent.hit_ticks) == (5, 1)


def test_each_torque_of_an_arm_acts_on_the_joint_of_its_drive(wired):
    """Position and velocity of the joint are beside each other in the signals, joint by joint."""
    node = wired(named("can-damiao", SHORT), "master")
    slots = node.plan.plan.slots()
    entries = list(node.inlet_bindings.inlets[: len(node.plan.inlets)])
    first = {port: slots[f"master.{port}"].start for port in ("tau", "q", "dq")}
    found = sorted((e.target, e.q, e.dq) for e in entries if e.drive)
    assert found == [(first["tau"] + j, first["q"] + j, first["dq"] + j) for j in (0, 1)]


def test_a_drive_takes_steps_of_its_plant(wired, tmp_path):
    """The step is 1 ms, and 5 ms if the plant has a period of five ticks."""
    for period, h in (("1 ms", 0.001), ("5 ms", 0.005)):
        system = changed(tmp_path, {}, settings=(SHORT, f"components.master.period='{period}'"))
        node = wired(system, "master")
        (entry,) = node.inlet_bindings.own_drives
        assert entry.drive.contents.h == h and entry.drive.contents.joints == 2


def test_faults_of_a_drive_of_our_own_protocol_come_in_the_order_of_time(wired):
    """A drive that boots loses its power, and has it again 0.3 s later."""
    bindings = wired(named("can", SHORT), "master").inlet_bindings
    bindings.suffer([(0.5, VendorFault.REBOOT, 7), (0.6, VendorFault.HOT, 4)])
    (entry,) = bindings.own_drives
    table = [(f.t_ns, f.fault, f.code) for f in entry.faults[: entry.n_faults]]
    assert table == [
        (500 * MS, VendorFault.REBOOT, 1),
        (600 * MS, VendorFault.HOT, 4),
        (800 * MS, VendorFault.REBOOT, 0),
    ]
    bindings.suffer([])
    assert entry.n_faults == 0


def test_an_input_of_a_controller_beside_its_arm_is_looked_at_when_it_computes(wired):
    system = named("network-can", SHORT)
    node = wired(system, "robot1")
    assert {i.ticks for i in node.plan.inlets} == {5} and node.plan.ticks == 1
    entries = node.inlet_bindings.inlets[: len(node.plan.inlets)]
    assert {(e.period, e.later) for e in entries} == {(5, 0)}


def test_a_guard_sees_the_position_of_its_torque(wired):
    node = wired(named("can", SHORT), "master_control")
    (entry,), slots = node.outlet_bindings.outlets[:1], node.plan.plan.slots()
    assert (entry.guarded, entry.joints, entry.width) == (0, 2, 4)
    assert entry.q == slots["master_control.q"].start
    assert entry.dq == slots["master_control.dq"].start
    assert entry.measured_q == entry.measured_dq == -1
    sources = np.ctypeslib.as_array(c.cast(entry.sources, c.POINTER(c.c_int64)), (4,))
    tau, xi = slots["master_control.tau"].start, slots["master_control.xi"].start
    assert sources.tolist() == [tau, tau + 1, xi, xi + 1]


def test_a_guard_counts_in_periods_of_its_controller_inside_a_node_and_at_its_end(wired, tmp_path):
    """Controllers of a period of 5 ms with a base step of 1 ms, each beside its arm or apart."""
    outside = wired(changed(tmp_path, {}), "master_control")
    assert [g.struct.h for g in outside.guards.values()] == [0.005]
    guard = {"tau_max": "3 N.m"}
    inside = wired(changed(tmp_path, {"master": {"guard": guard}}, "zenoh"), "master")
    assert list(inside.guards) == ["master_control.tau"]
    assert inside.guards["master_control.tau"].struct.h == 0.005
    assert inside.struct.h_ns == 1 * MS


def test_as_many_joints_as_a_guard_takes_are_taken(wired, monkeypatch):
    monkeypatch.setattr("bridge.wiring.outlets.JOINTS", 2)
    (guard,) = wired(named("can", SHORT), "master_control").guards.values()
    assert guard.struct.joints == 2


# ---- files, and the clock of a replay ------------------------------------------------------------


def test_a_replay_writes_down_nothing_that_it_hears(tmp_path):
    system = named("can", SHORT)
    node = WiredNode(system, "master", {}, tmp_path / "x.journal", native.REPLAY)
    try:
        assert node.heard is None and not node.struct.heard and node.buses == []
        assert not (tmp_path / "x.heard").exists()
    finally:
        node.__exit__()
    other = Slots(system, "master", tmp_path).wired
    try:
        assert other.heard is not None and other.struct.heard
    finally:
        other.__exit__()
