"""Structs of a node that point at each other, against the deployment that they are made of."""

from __future__ import annotations

import ctypes as c
from types import SimpleNamespace

import pytest

from bridge.native.commanded import Failure, StepKind
from bridge.native.node import NodeStruct
from bridge.wiring.beginning import begin_active, begin_cold
from bridge.wiring.commanded import DRIVES, CommandedDrives
from cosim.base.errors import ScenarioError
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
