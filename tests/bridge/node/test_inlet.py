"""Values that an inlet gives a component, and faults of an emulated drive of our own."""

from __future__ import annotations

import ctypes as c

import pytest

from bridge.native import node as native
from bridge.native.commanded import Phase
from bridge.native.message import Header
from bridge.native.node import MotorFault
from bridge.native.safety import DriveRequest, DriveState, LifeState, Status, Why
from bridge.native.vendor import VendorFault
from tests.bridge.deployments import document, named, system_of
from tests.bridge.slots import Slots

ON, OFF = DriveRequest.POWER_ON, DriveRequest.POWER_OFF
DISABLE, TRIP = DriveRequest.DISABLE, DriveRequest.TRIP
MS = 1_000_000


@pytest.fixture(name="arm")
def arm_(tmp_path):
    """``master`` of can.toml, the node of an emulated drive, ACTIVE; nobody else is there."""
    with Slots(named("can", "run.stop=1"), "master", tmp_path) as slots:
        slots.struct.n_peers = 0
        slots.begin()
        yield slots


def driven(arm):
    """The inlet of the drive, with no watchdog of its own and no silence that stops."""
    s = arm.struct
    (inlet,) = (inlet for inlet in s.inlets[: s.n_inlets] if inlet.drive)
    inlet.drive.contents.watchdog.timeout_ns = inlet.stop_ns = 0
    return inlet


def requests(packed):
    """Requests of a slot, in their order."""
    return tuple(packed >> 3 * k & 7 for k in range(10) if packed >> 3 * k & 7)


def happens(arm, *faults):
    """(requests, state of the drive, DRIVE or WATCHDOG raised) of 8 slots, ACTIVE in each.

    `faults`: (slot, what, code).
    """
    s, inlet, found = arm.struct, driven(arm), []
    table = (MotorFault * (len(faults) + 1))()
    for entry, (slot, fault, code) in zip(table, faults, strict=False):
        entry.t_ns, entry.fault, entry.code = slot * s.h_ns, fault, code
    table[len(faults)].fault = VendorFault.TRIP  # of t = 0, behind the end of the table
    inlet.faults, inlet.n_faults, inlet.happened = table, len(faults), 0
    for _ in range(8):
        s.life.state, s.life.now = LifeState.ACTIVE, 0
        arm.step()
        raised = Why(s.life.now) & (Why.DRIVE | Why.WATCHDOG)
        found.append(
            (requests(inlet.requests), DriveState(inlet.drive.contents.state).name, raised)
        )
    assert inlet.happened == len(faults)
    return found


NOTHING = ((), "ENABLED", Why(0))


def test_a_trip_is_a_fault_of_the_drive_in_its_slot_and_no_other_entry_of_its_table(arm):
    found = happens(arm, (3, VendorFault.TRIP, 0))
    tripped = ((), "FAULT", Why.DRIVE)
    assert found == [NOTHING] * 3 + [((TRIP,), *tripped[1:])] + [tripped] * 4


def test_power_goes_and_comes(arm):
    found = happens(arm, (2, VendorFault.REBOOT, 1), (4, VendorFault.REBOOT, 0))
    off, up = ((), "OFF", Why.DRIVE), ((), "READY", Why.DRIVE)
    assert found == [NOTHING] * 2 + [((OFF,), *off[1:]), off, ((ON,), *up[1:])] + [up] * 3


def test_a_drive_that_is_hot_trips_until_it_is_cool(arm):
    """Cleared in slot 4 it trips once more; in slot 6, when it is cool, it does not."""
    drive, asked = driven(arm).drive.contents, []
    inlet = driven(arm)
    table = (MotorFault * 2)(MotorFault(2 * arm.struct.h_ns, VendorFault.HOT, 2),
                             MotorFault(5 * arm.struct.h_ns, VendorFault.HOT, 0))  # fmt: skip
    inlet.faults, inlet.n_faults = table, 2
    for slot in range(8):
        if slot in (4, 6):
            drive.state = DriveState.READY
        arm.step()
        asked.append(requests(inlet.requests))
    assert asked == [(), (), (TRIP,), (), (TRIP,), (), (), ()]
    assert drive.state == DriveState.READY


def test_a_drive_that_drops_is_disabled_each_time_it_is_enabled(arm):
    drive, inlet, asked = driven(arm).drive.contents, driven(arm), []
    table = (MotorFault * 2)(MotorFault(arm.struct.h_ns, VendorFault.DROP, 1),
                             MotorFault(5 * arm.struct.h_ns, VendorFault.DROP, 0))  # fmt: skip
    inlet.faults, inlet.n_faults = table, 2
    for slot in range(7):
        if slot in (3, 6):
            drive.state = DriveState.ENABLED
        arm.step()
        asked.append(requests(inlet.requests))
    assert asked == [(), (DISABLE,), (), (DISABLE,), (), (), ()]


WHY = [  # life, drive, tripped -> reason
    ("ACTIVE", "ENABLED", 0, 0), ("ACTIVE", "READY", 0, Why.DRIVE), ("ACTIVE", "OFF", 0, Why.DRIVE),
    ("ACTIVE", "FAULT", 0, Why.WATCHDOG), ("ACTIVE", "FAULT", 1, Why.DRIVE),
    ("INACTIVE", "READY", 0, 0), ("INACTIVE", "FAULT", 0, Why.WATCHDOG),
    ("STOPPING", "READY", 0, 0), ("STOPPING", "FAULT", 1, Why.DRIVE),
    ("FAULT", "FAULT", 0, 0), ("FAULT", "FAULT", 1, 0), ("FAULT", "READY", 0, 0),
    ("ACTIVE", "ENABLED", 1, 0),
]  # fmt: skip


@pytest.mark.parametrize(("life", "drive", "tripped", "why"), WHY)
def test_why_a_drive_that_is_off_stops_its_node(arm, life, drive, tripped, why):
    s, inlet = arm.struct, driven(arm)
    state = DriveState[drive]
    s.life.state, s.life.ramp, s.life.ramp_ticks = LifeState[life], 99, 100
    inlet.drive.contents.state, inlet.tripped = state, tripped
    arm.step()
    assert Why(s.life.now) & (Why.DRIVE | Why.WATCHDOG) == Why(why)
    assert inlet.tripped == (tripped and state == DriveState.FAULT)


# ---- signals ----


@pytest.fixture(name="node")
def node_(tmp_path):
    """``master_control`` of can.toml, ACTIVE, and without need of anybody else."""
    found = document("can")
    found["nodes"]["master_control"] |= {"requires": [], "stale": {}}
    with Slots(system_of(found, tmp_path), "master_control", tmp_path) as slots:
        slots.begin()
        yield slots


def hear_state(node, k, values):
    """Sample `k` of STATE_1 arrives in time for the next slot."""
    message = node.system.messages["STATE_1"]
    t = k * message.period_ns
    header = Header(k, LifeState.ACTIVE | Status.SIMULATED, t // 1000)
    node.put("left", message.encoding.frame(values, header), t * 1e-9)


def first_of_state(node):
    """The first inlet of STATE_1, and the signals that it writes."""
    s = node.struct
    reception = node.wired.inlet_bindings.receptions["STATE_1"]
    inlet = next(
        inlet
        for inlet in s.inlets[: s.n_inlets]
        if c.addressof(inlet.reception.contents) == c.addressof(reception) and inlet.count >= 2
    )
    return inlet, (c.c_double * inlet.count).from_address(s.signals + 8 * inlet.target)


def test_a_value_has_its_gain_and_offset_and_before_the_first_one_the_initial_value(node):
    inlet, signals = first_of_state(node)
    initial = list(signals)
    inlet.gain, inlet.offset = -2.0, 0.75
    assert list(signals) == initial
    for _ in range(3):
        node.step()
        assert list(signals) == initial
    signals[0] = 99.0
    node.step()
    assert list(signals) == initial  # as a law may go back to before the first sample
    values = [0.25, 0.5, 0.125, -0.25]
    hear_state(node, node.struct.slot, values)
    node.step(), node.step()
    mine = values[inlet.first : inlet.first + inlet.count]
    assert list(signals) == pytest.approx([0.75 - 2.0 * x for x in mine], abs=1e-3)


@pytest.mark.parametrize("offset", [0, 400_000])
@pytest.mark.parametrize("phase", [0, 700_000])
def test_ages_of_a_sample_count_from_its_nominal_time_and_from_its_arrival(node, offset, phase):
    """Before the first sample, its age is that of sample 0."""
    inlet, signals = first_of_state(node)
    s, of = node.struct, inlet.reception.contents
    of.offset_ns, s.phase_ns = offset, phase
    inlet.age, inlet.link_age = inlet.target, inlet.target + 1
    arrived = held = 0
    for slot in range(9):
        if slot in (3, 4, 7):
            of.newest += 1
            arrived = slot
        node.step()
        held = max(0, inlet.held)
        now = slot * s.h_ns
        assert signals[0] == pytest.approx((now - arrived * s.h_ns) * 1e-9, abs=1e-12), slot
        sent = held * of.period_ns + offset
        assert signals[1] == pytest.approx((now + phase - sent) * 1e-9, abs=1e-12), slot


@pytest.mark.parametrize(("stop", "silence", "stale"), [
    (0, 10**12, False), (50 * MS, 50 * MS, False), (50 * MS, 50 * MS + 1, True), (1, 1, False),
    (1, 2, True),
])  # fmt: skip
def test_a_silence_longer_than_an_input_may_be_old_stops_the_node(node, stop, silence, stale):
    inlet, _ = first_of_state(node)
    s = node.struct
    for other in s.inlets[: s.n_inlets]:
        other.stop_ns = 0
    node.step()
    inlet.stop_ns, inlet.heard_ns = stop, s.slot * s.h_ns - silence
    node.step()
    assert bool(s.life.now & Why.STALE) is stale


@pytest.mark.parametrize("phase", list(Phase))
def test_a_drive_that_is_not_up_may_tell_no_position(tmp_path, phase):
    """Only what a drive that serves does not tell is missed."""
    with Slots(named("can-damiao"), "master_control", tmp_path) as slots:
        slots.begin()
        s = slots.struct
        drives = slots.wired.commanded.structs
        for inlet in s.inlets[: s.n_inlets]:
            inlet.stop_ns = 1 if inlet.reception.contents.drive == 1 else 0
            inlet.heard_ns = -1000
        for drive in drives:
            drive.phase, drive.n_told = Phase.SERVING, 0
        drives[1].phase = phase
        s.life.state, s.life.armed = LifeState.STOPPING, 0
        s.life.ramp, s.life.ramp_ticks = 99, 100
        slots.step()
        assert bool(s.life.now & Why.STALE) == (phase is Phase.SERVING)


@pytest.mark.parametrize(("name", "age"), [("age", 0.0), ("link_age", 1e-3)])
def test_the_first_signal_of_all_may_be_an_age(node, name, age):
    inlet, _ = first_of_state(node)
    signals = (c.c_double * 1).from_address(node.struct.signals)
    inlet.age = inlet.link_age = -1
    setattr(inlet, name, 0)
    node.struct.phase_ns = MS
    for k in range(3):
        signals[0] = -7.0
        inlet_pass(inlet, k, node)
        assert signals[0] == pytest.approx(age)


def inlet_pass(inlet, k, node):
    """Its pass of tick `k` alone, without the components behind it."""
    assert native.functions().inlet_pass(c.byref(inlet), k, node.struct.signals) == 0
