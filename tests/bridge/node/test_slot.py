"""One slot of a node, against what docs/design.md says of it: what it watches, does and records."""

from __future__ import annotations

import ctypes as c

import pytest

from bridge.native import node as native
from bridge.native.bus import BusState
from bridge.native.commanded import Phase
from bridge.native.message import Header
from bridge.native.safety import Command, DriveRequest, DriveState, LifeState, Why
from tests.bridge.deployments import document, named, system_of
from tests.bridge.slots import Slots

ARM, START, STOP, RESET = Command.ARM, Command.START, Command.STOP, Command.RESET
RESTS, WAITS, SERVES = Phase.RESTING, Phase.RISING, Phase.SERVING


def tell(node, *commands):
    for command in commands:
        native.functions().node_tell(c.byref(node.struct), command)


@pytest.fixture(name="node")
def node_(tmp_path):
    """``master_control`` of can.toml, ACTIVE, and without need of anybody else."""
    found = document("can")
    found["nodes"]["master_control"] |= {"requires": [], "stale": {}}
    with Slots(system_of(found, tmp_path), "master_control", tmp_path) as slots:
        slots.begin()
        yield slots


@pytest.fixture(name="arm")
def arm_(tmp_path):
    """``master`` of can.toml, the node of an emulated drive."""
    with Slots(named("can", "run.stop=1"), "master", tmp_path) as slots:
        slots.begin()
        yield slots


# ---- what it watches ----


@pytest.mark.parametrize("state", [state for state in BusState if state < BusState.OFF])
def test_a_bus_with_errors_that_still_sends_is_no_reason_to_stop(node, state):
    for bus in node.struct.buses[: node.struct.n_buses]:
        bus.state = state
    assert node.step()["now"] & Why.BUS == 0


@pytest.mark.parametrize("state", [state for state in BusState if state >= BusState.OFF])
def test_a_bus_that_sends_no_more_stops_who_sends_on_it(node, state):
    """Buses on which it only listens do not count."""
    s = node.struct
    used = {outlet.bus for outlet in s.outlets[: s.n_outlets]}
    for number in range(s.n_buses):
        for k, bus in enumerate(s.buses[: s.n_buses]):
            bus.state = state if k == number else 0
        assert bool(node.step()["now"] & Why.BUS) == (number in used)


def test_only_its_own_outlets_are_watched(node):
    """The table has one more entry than it is told of."""
    s = node.struct
    s.n_outlets -= 1
    s.outlets[s.n_outlets].bus = 1 - s.outlets[0].bus
    s.buses[s.outlets[s.n_outlets].bus].state = BusState.OFF
    assert not any(o.bus == s.outlets[s.n_outlets].bus for o in s.outlets[: s.n_outlets])
    assert node.step()["now"] & Why.BUS == 0
    s.n_outlets += 1


@pytest.mark.parametrize("ending", [0, 1])
def test_a_peer_that_stops_counts_until_its_own_end(arm, ending):
    """A required peer in FAULT counts; one behind the end of the table is not looked at."""
    s = arm.struct
    peers = s.peers[: s.n_peers]
    assert len(peers) > 0
    s.n_peers -= 1
    hidden = peers[-1]
    hidden.required, hidden.state = 1, LifeState.FAULT
    assert arm.step()["now"] & Why.PEER == 0
    s.n_peers += 1
    s.ending = ending
    hidden.required, hidden.state = 1, LifeState.FAULT
    assert bool(arm.step()["now"] & Why.PEER) == (not ending)


# ---- emulated drives follow ----

FOLLOWS = [  # (life before, drive before, commands, life, drive)
    ("ACTIVE", "ENABLED", (), "ACTIVE", "ENABLED"),
    ("ACTIVE", "READY", (), "FAULT", "READY"),  # it is off: its node stops
    ("INACTIVE", "READY", (), "INACTIVE", "READY"),
    ("INACTIVE", "ENABLED", (), "INACTIVE", "ENABLED"),  # nothing has changed
    ("INACTIVE", "READY", (ARM,), "INACTIVE", "READY"),
    ("INACTIVE", "READY", (ARM, START), "ACTIVE", "ENABLED"),
    ("INACTIVE", "READY", (START,), "INACTIVE", "READY"),  # refused
    ("FAULT", "FAULT", (RESET,), "INACTIVE", "READY"),
    ("FAULT", "FAULT", (RESET, ARM, START), "ACTIVE", "ENABLED"),
    ("FAULT", "FAULT", (), "FAULT", "FAULT"),
    ("FAULT", "READY", (RESET,), "INACTIVE", "READY"),
    ("FAULT", "ENABLED", (RESET,), "INACTIVE", "READY"),
    ("STOPPING", "ENABLED", (), "INACTIVE", "READY"),
]


@pytest.mark.parametrize(("before", "state", "commands", "life", "drive"), FOLLOWS)
def test_emulated_drives_follow_their_node(arm, before, state, commands, life, drive):
    s, mine = arm.struct, arm.wired.drives[0].struct
    s.life.state, s.life.armed = LifeState[before], before == "ACTIVE"
    s.life.ramp, mine.state = 1, DriveState[state]
    tell(arm, *commands)
    arm.step(), arm.step()
    assert (LifeState(s.life.state).name, DriveState(mine.state).name) == (life, drive)


@pytest.mark.parametrize("state", [DriveState.ENABLED, DriveState.READY])
def test_a_fault_stops_the_drive_that_is_enabled(arm, state):
    mine = arm.wired.drives[0].struct
    arm.struct.life.state, mine.state = LifeState.INACTIVE, state
    arm.struct.life.now = Why.COMPONENT
    assert arm.step()["state"] == LifeState.FAULT
    assert mine.state == (DriveState.FAULT if state is DriveState.ENABLED else state)


def test_drives_behind_the_end_of_the_table_do_not_follow(arm):
    s, mine = arm.struct, arm.wired.drives[0].struct
    (place,) = (k for k, inlet in enumerate(s.inlets[: s.n_inlets]) if inlet.drive)
    s.life.state, s.life.armed, mine.state = LifeState.INACTIVE, 1, DriveState.READY
    before, s.n_inlets = s.n_inlets, place
    native.functions().node_enable(c.byref(s), 0)
    assert mine.state == DriveState.READY
    tell(arm, START)
    arm.step()
    s.n_inlets = before
    assert s.life.state == LifeState.ACTIVE and mine.state == DriveState.READY


def test_what_is_enabled_is_on_and_its_watchdog_begins(arm):
    mine = arm.wired.drives[0]
    mine.request(DriveRequest.POWER_OFF, 0)
    native.functions().node_enable(c.byref(arm.struct), 7_000_000)
    assert mine.state is DriveState.ENABLED
    assert mine.struct.watchdog.last_ns == arm.struct.host_due_ns == 7_000_000
    assert arm.struct.begun == 1 and arm.struct.alarms == -1


# ---- a START that waits for drives ----

HELD = [  # (life, armed, phase, deferred, commands) -> (life, deferred, commands of the slot)
    (("INACTIVE", 1, SERVES, 0, ()), ("INACTIVE", 0, ())),
    (("INACTIVE", 1, WAITS, 0, ()), ("INACTIVE", 0, ())),
    (("INACTIVE", 1, WAITS, 0, (START,)), ("INACTIVE", 1, ())),
    (("INACTIVE", 1, SERVES, 0, (START,)), ("ACTIVE", 0, (START,))),
    (("INACTIVE", 1, WAITS, 1, ()), ("INACTIVE", 1, ())),
    (("INACTIVE", 1, SERVES, 1, ()), ("ACTIVE", 0, (START,))),
    (("INACTIVE", 0, SERVES, 1, ()), ("INACTIVE", 0, ())),  # drives rest where it is not armed
    (("INACTIVE", 0, WAITS, 0, (START,)), ("INACTIVE", 0, (START,))),  # refused at once
    (("INACTIVE", 0, WAITS, 0, (ARM, START)), ("INACTIVE", 1, (ARM,))),
    (("INACTIVE", 0, WAITS, 0, (START, ARM)), ("INACTIVE", 0, (START, ARM))),
    (("INACTIVE", 0, SERVES, 0, (ARM,)), ("INACTIVE", 0, (ARM,))),
    (("FAULT", 0, RESTS, 1, ()), ("FAULT", 1, ())),  # a RESET decides
    (("FAULT", 0, RESTS, 0, (RESET, ARM, START)), ("INACTIVE", 1, (RESET, ARM))),
    (("FAULT", 0, RESTS, 1, (RESET,)), ("INACTIVE", 0, (RESET,))),
    (("ACTIVE", 1, SERVES, 1, ()), ("ACTIVE", 0, ())),
    (("STOPPING", 0, SERVES, 1, ()), ("STOPPING", 0, ())),
    (("INACTIVE", 1, WAITS, 1, (STOP,)), ("INACTIVE", 0, (STOP,))),
]


@pytest.mark.parametrize(("given", "expected"), HELD)
def test_a_start_waits_for_the_drives(tmp_path, given, expected):
    life, armed, phase, deferred, commands = given
    with Slots(named("can-damiao"), "master_control", tmp_path) as node:
        s = node.struct
        for drive in node.wired.commanded.structs:
            drive.phase, drive.n_told = phase, 0
        for reception in s.receptions[: s.n_receptions]:
            reception.drive = -1  # positions are another matter
        s.life.state, s.life.armed, s.deferred = LifeState[life], armed, deferred
        s.life.ramp, s.disable_ns = s.life.ramp_ticks, 1 << 62
        tell(node, *commands)
        found = node.step()["commands"]
        kept = tuple(found >> 3 * k & 7 for k in range(10) if found >> 3 * k & 7)
        assert (LifeState(s.life.state).name, s.deferred, kept) == expected


# ---- what it records and says ----


@pytest.mark.parametrize("offset", [0, 300_000])
def test_a_row_has_the_times_and_the_ages_of_its_slot(node, offset):
    """An age counts from the nominal time of the held sample to when the node woke; -1: none.

    `offset`: time of a sender's first sample, ns.
    """
    encoding = node.system.messages["STATE_1"].encoding
    s, ages = node.struct, set()
    for reception in s.receptions[: s.n_receptions]:
        reception.offset_ns = reception.receiver.contents.offset_ns = offset
    for slot in range(12):
        if slot in (0, 2, 3, 7):
            t = slot * s.h_ns + offset
            header = Header(slot, LifeState.ACTIVE, t // 1000)
            node.put("left", encoding.frame([0.0] * 4, header), t * 1e-9)
        row = node.step()
        deadline = slot * s.h_ns + s.phase_ns
        assert (row["slot"], row["deadline_ns"], row["woke_ns"]) == (slot, deadline, deadline)
        assert row["received_ns"] == row["done_ns"] == deadline and row["send_ns"] == 0
        for k, inlet in enumerate(s.inlets[: s.n_inlets]):
            of = inlet.reception.contents
            held = inlet.held
            sent = held * of.period_ns + offset
            found = row["inlets"][k]
            assert found["held"] == held and found["newest"] == inlet.newest
            assert found["transit_ns"] == of.transit_ns
            assert found["age_ns"] == (deadline - sent if held >= 0 else -1)
            ages.add(int(found["age_ns"]))
    assert {-1} < ages


@pytest.mark.parametrize("every", [1, 3])
def test_heartbeats_and_syncs_come_every_so_many_slots(node, every):
    s = node.struct
    s.heartbeat_slots = s.sync_slots = every
    beats, syncs = s.beats, s.sync_count
    for slot in range(9):
        node.step()
        assert s.beats - beats == s.sync_count - syncs == slot // every + 1
    s.heartbeat_slots = s.sync_slots = 0
    beats, syncs = s.beats, s.sync_count
    node.step()
    assert (s.beats, s.sync_count) == (beats, syncs)


@pytest.mark.parametrize(("slot", "rows"), [(0, [0, 0]), (1, [1, 1]), (6, [6, 2]), (7, [7, 3])])
def test_tables_of_a_life_that_joins_go_on_with_the_next_row(node, slot, rows):
    """A row of the second table counts for three slots; one that has begun is over."""
    place = (c.c_int64 * 3)(-9, -9, -9)
    found = [(c.addressof(place), 1), (c.addressof(place) + 8, 3), (c.addressof(place) + 16, 1)]
    s, kept = node.struct, (node.struct.played, node.struct.n_played, node.struct.slot)
    played = (native.PlayedStruct * 3)()
    for entry, (address, period) in zip(played, found, strict=True):
        entry.row, entry.period = address, period
    s.played, s.n_played, s.slot = c.cast(played, type(s.played)), 2, slot
    native.functions().node_enable(c.byref(s), 0)
    assert list(place) == [*rows, -9]
    s.played, s.n_played, s.slot = kept
