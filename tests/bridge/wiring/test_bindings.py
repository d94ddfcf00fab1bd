"""Structs of a node that point at each other, against the deployment that they are made of."""

from __future__ import annotations

import ctypes as c
from types import SimpleNamespace

import pytest

from bridge.native import node as native
from bridge.native.bus import Bus
from bridge.native.commanded import Failure, Phase, StepKind
from bridge.native.frame import Ring
from bridge.native.node import NodeStruct
from bridge.wiring import wiring
from bridge.wiring.beginning import begin_active, begin_cold
from bridge.wiring.commanded import DRIVES, CommandedDrives
from bridge.wiring.outlets import forwardings
from bridge.wiring.wiring import WiredNode
from cosim.base.errors import ScenarioError
from cosim.native import structs
from tests.bridge.deployments import document, named, system_of
from tests.bridge.slots import Slots

SHORT = "run.stop=0.2"
MS = 1_000_000  # ns


@pytest.mark.parametrize(
    ("name", "parts"),
    [("can-damiao", ("state",)), ("six_axis", ("state",)), ("can-cia402", ("state", "speed"))],
)
def test_each_emulated_drive_tells_its_own_messages(wired, name, parts):
    """A drive of CiA 402 tells its position and its velocity apart, in this order."""
    node = wired(named(name, SHORT), "master")
    messages, motors = node.plan.outlets, node.inlet_bindings.motors
    for n, motor in enumerate(motors.structs, 1):
        told = [messages[number].message for number in motor.outlets if number >= 0]
        assert told == [f"master_{part}_{n}" for part in parts]
        for part, number in enumerate(motor.outlets[: len(parts)]):
            entry = node.outlet_bindings.outlets[number]
            assert c.addressof(entry.motor.contents) == c.addressof(motor) and entry.part == part
    assert sum(bool(entry.motor) for entry in node.outlet_bindings.outlets) == sum(
        number >= 0 for motor in motors.structs for number in motor.outlets
    )


@pytest.mark.parametrize("deployment", ["can", "can-classic", "gateway"])
def test_a_heartbeat_is_heard_on_the_buses_of_its_peer_only(wired, deployment):
    system = named(deployment, SHORT)
    for name in system.nodes:
        struct, known = wired(system, name).struct, system.peers_of(name)
        for bus, entry in zip(system.buses_of(name), struct.services, strict=False):
            beats = (c.c_void_p * len(known)).from_address(entry.peers)
            heard = {peer for peer, beat in zip(known, beats, strict=True) if beat}
            assert heard == {peer for peer in known if bus in system.buses_of(peer)}, (name, bus)


def test_a_node_knows_whose_drives_take_its_torques(wired):
    takes = {}
    system = named("can", SHORT)
    for name in system.nodes:
        found = {peer for peer, struct in wired(system, name).peers.items() if struct.takes}
        takes[name] = found
    arms = {"master_control": {"master"}, "slave_control": {"slave"}}
    assert takes == {"master": set(), "slave": set()} | arms


def test_a_line_knows_how_much_later_its_receiver_looks_than_its_sender_sends(wired, tmp_path):
    found = document("can")
    found["nodes"]["master"]["phase"] = "0.2 ms"
    found["nodes"]["master_control"]["phase"] = "0.7 ms"
    node = wired(system_of(found, tmp_path, SHORT), "master_control")
    offsets = {i.message: node.lines[i.target.name].struct.phase_ns for i in node.plan.inlets}
    sent = {m: node.system.messages[m].offset_ns for m in offsets}
    assert sent["STATE_1"] == MS // 5 and set(offsets) == {"STATE_1", "LINK_4"}
    assert offsets == {m: 7 * MS // 10 - sent[m] for m in offsets}


def test_a_journal_has_room_for_every_slot_and_some_more(wired):
    node = wired(named("can", SHORT), "master")
    assert node.plan.slots == 200 < node.journal.struct.capacity < 300


@pytest.mark.parametrize("begin", [begin_active, begin_cold])
@pytest.mark.parametrize("slot", [0, 7])
def test_a_node_that_begins_later_counts_from_there(tmp_path, begin, slot):
    with Slots(named("can-damiao", SHORT), "master", tmp_path) as slots:
        slots.struct.slot = slot
        begin(slots.wired)
        assert slots.struct.host_due_ns == slot * slots.struct.h_ns


def test_as_many_drives_as_a_row_has_bits_are_taken(wired):
    node = wired(named("can-damiao", SHORT), "master_control")
    drive, buses = node.commanded.drives[0], node.system.buses_of("master_control")
    assert len(CommandedDrives([drive] * DRIVES, buses, NodeStruct(), "").drives) == DRIVES == 64
    with pytest.raises(ScenarioError, match="commands 65 drives, expected at most 64"):
        CommandedDrives([drive] * 65, buses, NodeStruct(), "here")


def test_a_drive_that_does_not_follow_is_told_with_what_was_expected_of_it(wired):
    commanded = wired(named("can-damiao", SHORT), "master_control").commanded
    drive, entry = commanded.drives[0], commanded.structs[0]
    entry.failure = Failure.ANSWER
    said = set()
    for step in range(entry.n_steps):
        entry.failed_step = step
        names = drive.expected(step)
        (text,) = commanded.given_up()
        expected = " or ".join(names) if names else "an answer"
        assert f"did not follow: expected {expected}, it tells nothing" in text
        said.add(bool(names))
    assert True in said


@pytest.mark.parametrize("status", ["", "a message"])
@pytest.mark.parametrize("expect", [(), ("enabled",)])
def test_a_step_waits_for_a_state_where_the_drive_tells_one(wired, status, expect):
    """A drive without a status message, or a step without an expectation: only time passes."""
    commanded = wired(named("can-cia402", SHORT), "master_control").commanded
    drive = commanded.drives[0]
    raw = SimpleNamespace(
        within="1 s", again="0 s", expect=expect, at=lambda node, value: (0x200, bytes(8))
    )
    told = SimpleNamespace(message=status, bits=lambda names: 0b101 if names else 0)
    profile = SimpleNamespace(path=drive.profile.path, status=told)
    one = SimpleNamespace(
        profile=profile, bus=drive.bus, node=1, watchdog_value=0, frame=drive.frame
    )
    step = commanded._step(one, raw)
    waits = bool(status and expect)
    assert (step.kind == StepKind.STATE) == waits and step.states == (0b101 if waits else 0)


def test_an_answer_is_compared_where_it_is_neither_exact_nor_a_value(wired):
    """The upper of two bytes has to be exact, and the lower one is compared as a mask says."""
    commanded = wired(named("can-cia402", SHORT), "master_control").commanded
    drive = commanded.drives[0]
    raw = SimpleNamespace(within="1 s", again="0 s", at=lambda node, value: (0x600, bytes(8)))
    reply = SimpleNamespace(
        at=lambda node, value: (0x580, b"\x34\x12"), value_mask=lambda node: 0xFF00
    )
    step = commanded._step(drive, (raw, reply))
    assert (step.kind, step.value, step.exact, step.mask) == (StepKind.FRAME, 0x1234, 0xFF00, 0xFF)


def test_where_position_and_velocity_of_a_drive_are_told(wired):
    for name, q, dq in (("can-cia402", "state", "speed"), ("can-damiao", "state", "state")):
        node = wired(named(name, SHORT), "master_control")
        heard = list(node.inlet_bindings.receptions)
        told = [(heard[s.q_of], heard[s.dq_of]) for s in node.commanded.structs]
        assert told == [(f"master_{q}_{n}", f"master_{dq}_{n}") for n in (1, 2)]


def test_a_host_of_cia_402_beats_four_times_in_the_time_its_drives_wait(wired):
    node = wired(named("can-cia402", SHORT), "master_control")
    assert node.struct.host_ns == 12_500_000  # they wait 50 ms
    entries = dict(zip(node.system.buses_of("master_control"), node.struct.services, strict=False))
    assert bool(entries["left"].host_heartbeat) and bool(entries["left"].host_sync)
    assert entries["left"].host_sync_slots == 1
    assert not entries["link"].host_heartbeat and not entries["link"].host_sync
    assert wired(named("can-damiao", SHORT), "master_control").struct.host_ns == 0


def test_of_several_buses_the_one_that_waits_least_says_how_often_a_host_beats(wired):
    """One after the other, in any order."""
    node = wired(named("can-cia402", SHORT), "master_control")
    service = node.system.services["left"]
    for timeout, expected in ((0.04, 10), (0.08, 10), (0.02, 5)):
        other = SimpleNamespace(
            timeout=timeout, host_heartbeats=service.host_heartbeats, host_sync=None
        )
        node._bind_host("left", native.Services(), other)
        assert node.struct.host_ns == expected * MS


@pytest.mark.parametrize(("name", "torques"), [("can", [(0, 2)]), ("can-cia402", [(0, 1), (1, 1)])])
def test_each_guard_sees_the_joints_of_its_torque(wired, name, torques):
    node = wired(named(name, SHORT), "master_control")
    slots, outlets = node.plan.plan.slots(), node.outlet_bindings.outlets
    q, dq = (slots[f"master_control.{port}"].start for port in ("q", "dq"))
    found = [(e.q - q, e.dq - dq, e.joints) for e in outlets if e.guard]
    assert found == [(first, first, joints) for first, joints in torques]


@pytest.mark.parametrize(("deployment", "node"), [("can", "master_control"), ("zenoh", "master")])
@pytest.mark.parametrize("port", ["age", "nothing"])
def test_a_guard_sees_only_what_has_as_many_joints_as_its_torque(
    wired, tmp_path, deployment, node, port
):
    """The torque leaves the node, or stays in it; `age` is one number, and `nothing` is no port."""
    found = document(deployment)
    found["nodes"][node]["guard"] = {"tau_max": "3 N.m", "dq": port}
    bound = wired(system_of(found, tmp_path, SHORT), node)
    entries = [e for e in bound.outlet_bindings.outlets if e.guard]
    entries += bound.struct.insides[: bound.struct.n_insides]
    (entry,) = entries
    assert entry.dq == -1
    assert entry.q == bound.plan.plan.slots()["master_control.q"].start


def test_gates_of_a_node_are_its_inlets_and_outlets_each_its_own(wired):
    node = wired(named("can-cia402", SHORT), "master_control")
    for plans, bound, entries in (
        (node.plan.inlets, node.inlet_bindings, node.inlet_bindings.inlets),
        (node.plan.outlets, node.outlet_bindings, node.outlet_bindings.outlets),
    ):
        assert len(plans) > 2
        for each, entry in zip(plans, entries, strict=True):
            assert bound.gates[each.gate][1] == c.addressof(entry)


def test_a_gateway_forwards_each_message_by_the_one_it_is_made_of(wired):
    node = wired(named("gateway", SHORT), "left_gateway")
    of = {f.message: f.of for f in node.plan.forwards}
    assert len(set(of.values())) > 1 and set(node.forwards) == set(of)
    for message, reception in node.inlet_bindings.receptions.items():
        made = [f for f in forwardings(node.system, "left_gateway", {message: reception})]
        names = {name for one in made for name in one.made}
        assert names == {name for name, source in of.items() if source == message}
        assert reception.n_forwards == len(names)
    for name, entry in node.forwards.items():
        carried = node.system.messages[name]
        sources = (c.c_int32 * entry.width).from_address(entry.sources)
        assert list(sources) == list(carried.forward.sources)
        assert node.system.buses_of("left_gateway")[entry.bus] == carried.bus


def test_a_life_begins_as_much_later_as_its_initialization_takes(tmp_path, monkeypatch):
    monkeypatch.setattr(wiring, "stopwatch", lambda: lambda: 0.25)
    with Slots(named("can", SHORT), "master", tmp_path) as slots:
        lead = (wiring.LEAD + 0.25 * wiring.LONGER) * 1e9
        assert abs(slots.struct.lead_ns - lead) <= 1 and wiring.LEAD > 0 < wiring.LONGER


def test_c_records_where_the_engine_looks(tmp_path):
    with Slots(named("can", SHORT), "master", tmp_path) as slots:
        s, state = slots.struct, slots.wired.engine.state
        for address, field in ((s.record, "record"), (s.record_row, "row")):
            at = c.cast(address, c.c_void_p).value
            assert at == c.addressof(state) + getattr(structs.EngineStruct, field).offset


def test_changes_of_drives_are_told_by_the_clock_of_the_run(wired):
    node = wired(named("can-damiao", SHORT), "master_control")
    kept, node.struct.start_ns = node.struct.drive_events, 2_000 * MS
    for n, (drive, phase, failure) in enumerate(
        [(1, Phase.SERVING, Failure.NOT), (0, Phase.FAILED, Failure.SILENT)]
    ):
        event = kept.events[n]
        event.t_ns, event.drive, event.row = (2_500 + n) * MS, drive, -1
        event.phase, event.failure = phase, failure
    kept.n = 2
    names = [drive.name for drive in node.commanded.drives]
    assert node.commanded.events() == [
        {"t": 0.5, "drive": names[1], "phase": "serving", "told": "", "failure": ""},
        {"t": 0.501, "drive": names[0], "phase": "failed", "told": "", "failure": "silent"},
    ]
    assert wired(named("can", SHORT), "master_control").commanded.events() == []


@pytest.mark.parametrize("clock", [native.WALL, native.SIMULATED])
def test_drives_of_no_vendor_are_missed_on_the_wall_clock_only(tmp_path, clock, monkeypatch):
    """In simulated time they are mirrors, which may not tell their state."""
    system = named("can-damiao", SHORT)
    names = system.buses_of("master_control")
    buses = {bus: Bus.from_rings(Ring(64), Ring(64), n) for n, bus in enumerate(names)}
    made = WiredNode(system, "master_control", buses, tmp_path / "journal", clock)
    try:
        drive, entry = made.commanded.drives[0], made.commanded.structs[0]
        profile = drive.profile
        monkeypatch.setattr(type(profile), "vendor", "", raising=True)
        made.commanded._bind(drive, entry)
        assert entry.within_ns == (100 * MS if clock == native.WALL else 0)
    finally:
        made.__exit__()
