"""Drives of a node in its struct, against the texts of their profiles."""

from __future__ import annotations

import pytest

from bridge.native import node as native
from bridge.native.bus import Bus
from bridge.native.commanded import Failure, Lacks, Phase
from bridge.native.frame import Ring
from bridge.wiring.commanded import EVENTS
from bridge.wiring.wiring import WiredNode
from tests.bridge.deployments import document, named, system_of

SHORT = "run.stop=0.2"
MS = 1_000_000  # ns


def test_steps_of_a_bring_up_wait_as_long_as_their_profile_says(wired):
    """The steps of CiA 402, with "1 s" and the default of the profile; nothing is sent again."""
    node = wired(named("can-cia402", SHORT), "master_control")
    commanded = node.commanded
    assert len(commanded.drives) == 2
    for drive, entry in zip(commanded.drives, commanded.structs, strict=False):
        said = [step[0] if isinstance(step, tuple) else step for step in drive.steps()]
        steps = entry.steps[: entry.n_steps]
        assert len(steps) == len(said) > 2
        waits = {raw.within for raw in said}
        assert "1 s" in waits and len(waits) > 1
        for raw, step in zip(said, steps, strict=True):
            if raw.within == "1 s":
                assert step.within_ns == 1_000 * MS
            else:
                assert 0 < step.within_ns < 1_000 * MS, raw


def test_changes_of_drives_are_kept_where_there_are_drives(wired):
    drives = wired(named("can-damiao", SHORT), "master_control").struct
    none = wired(named("can", SHORT), "master_control").struct
    assert drives.n_commanded == 2 and none.n_commanded == 0
    assert drives.drive_events.capacity == EVENTS and drives.drive_events.events
    assert none.drive_events.capacity == 0 and not none.drive_events.events


def test_faults_of_a_drive_are_a_table_in_the_order_of_time(wired):
    node = wired(named("can-damiao", SHORT), "master")
    motors = node.inlet_bindings.motors
    first, second = motors.drives[:2]
    motors.suffer(second.bus, second.node, [(0.5, 1, 0x80), (1.25, 2, 0)])
    entry = motors.structs[1]
    table = [(f.t_ns, f.fault, f.code) for f in entry.faults[: entry.n_faults]]
    assert table == [(500 * MS, 1, 0x80), (1250 * MS, 2, 0)]
    assert motors.structs[0].n_faults == 0 and entry.happened == 0
    motors.suffer(first.bus, first.node, [])
    assert motors.structs[0].n_faults == 0


def test_encoders_measure_what_a_message_carries(wired):
    """Positions and velocities in messages of their own, and none in a controller's."""
    arm = wired(named("can-classic", SHORT), "master")
    measured = {
        o.message: (e.measured_q, e.measured_dq)
        for o, e in zip(arm.plan.outlets, arm.outlet_bindings.outlets, strict=False)
    }
    assert measured == {"POS_1": (0, -1), "VEL_1": (-1, 0)}
    assert all(e.drive for e in arm.outlet_bindings.outlets[: len(measured)])
    control = wired(named("can-classic", SHORT), "master_control")
    for entry in control.outlet_bindings.outlets[: len(control.plan.outlets)]:
        assert (entry.measured_q, entry.measured_dq) == (-1, -1) and not entry.drive


def test_only_messages_with_torques_have_the_age_of_the_drive(wired, tmp_path):
    found = document("can")
    found["nodes"]["master"]["drive"]["max_age"] = "40 ms"
    found["messages"]["LINK_4"]["max_age"] = "70 ms"
    system = system_of(found, tmp_path, SHORT)
    bound = wired(system, "master").inlet_bindings
    ages = [bound._max_age(system.messages[name]) for name in ("LINK_2", "LINK_4", "STATE_3")]
    assert ages == [40 * MS, 70 * MS, 0]


def test_drives_that_are_given_up_are_told_from_those_that_serve(wired):
    """One of two drives serves, one is in trouble; drives with one reason share a sentence."""
    commanded = wired(named("can-damiao", SHORT), "master_control").commanded
    first, second = commanded.structs
    numbers = [drive.node for drive in commanded.drives]
    first.phase = second.phase = Phase.SERVING
    assert commanded.given_up() == commanded.not_ready() == []
    second.phase, second.lacks = Phase.RISING, Lacks.BRINGUP
    second.row = -1
    assert commanded.given_up() == []
    (text,) = commanded.not_ready()
    assert text.startswith(f"drive {numbers[1]} on bus ") and "it tells nothing" in text
    second.row, second.word = 0, 0x00  # what the first row of the table matches
    assert "it tells DISABLED" in commanded.not_ready()[0]
    second.lacks, second.position_ns = Lacks.POSITION, 80 * MS
    assert "has told no position for 80 ms" in commanded.not_ready()[0]
    second.position_ns = 0
    assert "has told no position for 0 ms" in commanded.not_ready()[0]
    second.position_ns = -1
    assert "has told no position yet" in commanded.not_ready()[0]
    second.failure, second.phase = Failure.SILENT, Phase.FAILED
    (text,) = commanded.given_up()
    assert text.startswith(f"drive {numbers[1]} on bus ")
    assert "has told nothing for too long, at last nothing" in text
    first.failure, first.phase = Failure.SILENT, Phase.FAILED
    (text,) = commanded.given_up()
    assert text.startswith(f"drive {numbers[0]} (and {numbers[1]}) on bus ")
    assert commanded.index(commanded.drives[1].bus, numbers[1]) == 1
    assert commanded.index("no bus", numbers[1]) == -1


@pytest.mark.parametrize("name", ["can-damiao", "six_axis", "can-cia402"])
def test_emulated_drives_of_vendors_take_their_time_to_answer(wired, name):
    bound = wired(named(name, SHORT), "master").inlet_bindings.motors
    drives = [motor.vendor for motor in bound.structs]
    assert all(0 < v.answer_ns <= MS and 0 < v.jitter_ns <= MS for v in drives)
    assert len({v.seed for v in drives}) == len(drives)  # each its own jitter


@pytest.mark.parametrize("clock", [native.WALL, native.SIMULATED])
def test_drives_of_vendors_tell_their_state_on_every_clock(tmp_path, clock):
    system = named("can-damiao", SHORT)
    names = system.buses_of("master_control")
    buses = {bus: Bus.from_rings(Ring(64), Ring(64), n) for n, bus in enumerate(names)}
    node = WiredNode(system, "master_control", buses, tmp_path / "journal", clock)
    try:
        assert [entry.within_ns for entry in node.commanded.structs] == [100 * MS, 100 * MS]
    finally:
        node.__exit__()


def test_a_node_with_two_arms_gives_each_its_own_torque_position_and_velocity(wired, tmp_path):
    found = document("can")
    found["nodes"]["master"]["components"] = ["master", "slave"]
    del found["nodes"]["slave"]
    found["nodes"]["slave_control"]["requires"] = ["master"]
    node = wired(system_of(found, tmp_path, SHORT), "master")
    slots, seen = node.plan.plan.slots(), set()
    for inlet, entry in zip(node.plan.inlets, node.inlet_bindings.inlets, strict=False):
        if inlet.target.port == "tau":
            name = inlet.component
            assert entry.target == slots[f"{name}.tau"].start
            assert (entry.q, entry.dq) == (slots[f"{name}.q"].start, slots[f"{name}.dq"].start)
            seen.add(name)
    assert seen == {"master", "slave"}


def test_the_position_of_a_drive_is_its_own_and_no_velocity_is_taken_for_one(wired):
    """CiA 402 tells position and velocity in messages of their own, the other drives in one."""
    for name in ("can-cia402", "can-damiao"):
        node = wired(named(name, SHORT), "master_control")
        drives = {m: r.drive for m, r in node.inlet_bindings.receptions.items()}
        assert drives["master_state_1"] == 0 and drives["master_state_2"] == 1
        assert {n for m, n in drives.items() if not m.startswith("master_state")} <= {-1}
    assert {r.drive for r in wired(named("can", SHORT), "master_control")
            .inlet_bindings.receptions.values()} == {-1}  # fmt: skip


@pytest.mark.parametrize(
    ("deployment", "node", "moves"),
    [("can", "master", 1), ("can", "master_control", 0), ("can-damiao", "master", 0)],
)
def test_a_life_that_moves_is_one_with_a_drive_of_our_own_protocol(wired, deployment, node, moves):
    assert wired(named(deployment, SHORT), node).struct.life.moves == moves


def test_an_odrive_tells_its_state_as_often_as_its_profile_says(wired):
    """Every 10 ms; drives of other vendors answer commands, or tell it in each frame."""
    beats = {}
    for name, node in (("six_axis", "master"), ("six_axis", "slave"), ("can-damiao", "master")):
        motors = wired(named(name, SHORT), node).inlet_bindings.motors
        for drive, entry in zip(motors.drives, motors.structs, strict=False):
            beats.setdefault(drive.profile.vendor, set()).add(entry.vendor.beat_ns)
    assert beats == {"odrive": {10 * MS}, "damiao": {0}}


def test_a_node_knows_where_position_and_velocity_of_a_drive_are(wired):
    """Damiao drives tell both in a message, the velocity behind the position; CiA 402 in two."""
    for name, velocity in (("can-damiao", 1), ("can-cia402", 0)):
        structs = wired(named(name, SHORT), "master_control").commanded.structs
        assert [(s.q_at, s.dq_at) for s in structs] == [(0, velocity)] * 2


def test_drives_of_cia_402_alone_know_the_number_of_their_host(wired):
    hosts = {}
    for name in ("can-cia402", "can-damiao"):
        entries = wired(named(name, SHORT), "master").inlet_bindings.motors
        hosts[name] = {e.vendor.host for e, _ in zip(entries.structs, entries.drives, strict=False)}
    assert hosts["can-damiao"] == {0} and 0 not in hosts["can-cia402"]
