"""Tables of a node end where they say: the entry behind the last one leads nowhere."""

from __future__ import annotations

import ctypes as c

import pytest

from bridge.native import node as native
from bridge.native.commanded import Phase
from bridge.native.message import Header
from bridge.native.node import WALL
from bridge.native.safety import LifeState, Status, Why
from tests.bridge.deployments import document, named, system_of
from tests.bridge.node.test_epoch_judged import NOTHING, Waiting
from tests.bridge.node.test_service import slot
from tests.bridge.slots import Slots

SAMPLE = LifeState.ACTIVE | Status.SIMULATED


def nowhere(entry, *names):
    """Pointers of an entry lead to no memory."""
    for name in names:
        offset = getattr(type(entry), name).offset
        c.c_uint64.from_address(c.addressof(entry) + offset).value = 16


@pytest.fixture(name="node")
def node_(tmp_path):
    """``master_control`` of can.toml, without need of anybody else."""
    found = document("can")
    found["nodes"]["master_control"] |= {"requires": [], "stale": {}}
    with Slots(system_of(found, tmp_path), "master_control", tmp_path) as slots:
        slots.begin()
        yield slots


def say(node, encoding, values, status=SAMPLE, bus="left"):
    frame = encoding.frame(values, Header(status=status))
    node.put(bus, frame, node.struct.slot * node.struct.h_ns * 1e-9)
    return node.step()


def test_a_reception_behind_the_table_is_no_receiver_and_no_sample_of_a_peer(node):
    s, left = node.struct, node.system.services["left"]
    assert s.n_receptions > 1
    last = s.receptions[s.n_receptions - 1]
    s.n_receptions -= 1
    nowhere(last, "message", "receiver", "values", "limits")
    name = list(node.wired.inlet_bindings.receptions)[-1]
    carried = node.system.messages[name]
    last.sender = 1
    for boots in (1, 2):  # the peer begins again
        say(node, left.heartbeats[1], [LifeState.ACTIVE, 0, boots, 0])
    unknown = s.unknown
    say(node, carried.encoding, [0.0] * 4, bus=carried.bus)
    assert s.unknown == unknown + 1 and last.misfits == 0


def test_a_heartbeat_of_a_peer_behind_the_table_is_an_unknown_frame(node):
    s = node.struct
    peers = s.peers[: s.n_peers]
    last = peers[-1]
    bus = next(b for b in node.names if last.number in node.system.services[b].heartbeats)
    s.n_peers -= 1
    last.state, before = -1, s.unknown
    beat = node.system.services[bus].heartbeats[last.number]
    say(node, beat, [LifeState.ACTIVE, 0, 1, 0], Status.SIMULATED, bus)
    assert (last.state, last.heard, s.unknown) == (-1, 0, before + 1)
    last.number, last.required = 1, 1
    say(
        node,
        node.system.messages["STATE_1"].encoding,
        [0.0] * 4,
        LifeState.FAULT | Status.SIMULATED,
    )
    assert last.state == -1


def test_positions_of_drives_behind_the_table_are_not_awaited(tmp_path):
    with Slots(named("can-damiao"), "master_control", tmp_path) as node:
        s = node.struct
        for drive in node.wired.commanded.structs:
            drive.phase, drive.within_ns, drive.up_ns = Phase.SERVING, 10**9, 0
        for reception in s.receptions[: s.n_receptions]:
            reception.previewed_ns = 5
        last = s.receptions[s.n_receptions - 1]
        last.previewed_ns, last.newest, last.drive = -1, -1, 1
        assert not native.functions().bringup_ready(c.byref(s), 5)
        s.n_receptions -= 1
        assert native.functions().bringup_ready(c.byref(s), 5)


@pytest.mark.parametrize("drives", [0, 1])
def test_an_encoder_of_a_drive_behind_the_table_of_inlets_is_not_old(tmp_path, drives):
    with Slots(named("can-cia402"), "master_control", tmp_path) as node:
        s = node.struct
        s.begun, s.now_ns = 1, 10**9
        for inlet in s.inlets[: s.n_inlets]:
            inlet.stop_ns, inlet.heard_ns = 50, 10**9
            inlet.last_newest = inlet.reception.contents.newest
        last = s.inlets[s.n_inlets - 1]
        of = c.addressof(last.reception.contents) - c.addressof(s.receptions[0])
        number = of // c.sizeof(type(s.receptions[0]))
        for drive in node.wired.commanded.structs:
            drive.phase, drive.n_told, drive.heard, drive.within_ns = Phase.SERVING, 1, 1, 0
            drive.row, drive.q_of, drive.dq_of = 0, -1, -1
            drive.told[0].kind = 3
        node.wired.commanded.structs[drives].q_of = number
        last.heard_ns = 0
        s.n_inlets -= 1
        native.functions().bringup_watch(c.byref(s), 10**9)
        assert all(d.phase == Phase.SERVING for d in node.wired.commanded.structs)
        s.n_inlets += 1
        native.functions().bringup_watch(c.byref(s), 10**9)
        assert node.wired.commanded.structs[drives].phase == Phase.FAILED


def test_a_sample_behind_the_table_contradicts_no_epoch_and_none_is_missed(tmp_path):
    with Slots(named("can", "run.stop=60"), "master_control", tmp_path, WALL) as slots:
        waiting, s = Waiting(slots, "left"), slots.struct
        assert waiting.thinks(NOTHING) == "unknown"  # long stamps tell seconds, and none came
        kept = s.n_receptions
        s.n_receptions = 0
        waiting.slots.wired.inlet_bindings.receptions.clear()
        first = s.receptions[0]
        first.early, first.early_ns, first.receiver.contents.time_bits = 1, 0, 32
        assert waiting.thinks(NOTHING) == "believed"
        s.n_receptions = kept


def test_messages_behind_the_table_of_outlets_are_not_watched_or_told(node):
    s = node.struct
    last = s.outlets[s.n_outlets - 1]
    last.bus = 1 - s.outlets[0].bus
    s.n_outlets -= 1
    s.buses[last.bus].state = 3
    assert slot(node) and not s.life.reasons & Why.BUS
    s.n_outlets += 1
