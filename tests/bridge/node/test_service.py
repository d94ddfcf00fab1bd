"""The services that a node sends, on the simulated clock: tables of docs/safety.md and CiA 301."""

from __future__ import annotations

import ctypes as c

import pytest

from bridge.native import node as native
from bridge.native.frame import Frame
from bridge.native.message import Header
from bridge.native.safety import LifeState, Status, Why
from tests.bridge.deployments import document, named, system_of
from tests.bridge.slots import Slots

MS = 1_000_000
HOST, SYNC = 0x702, 0x80  # CANopen: heartbeat of node 2; SYNC


def sent(node, bus):
    """Frames that the node has sent on a bus since the last call."""
    ring, found = node.struct.buses[node.names.index(bus)].tx, [Frame()]
    while native.functions().ring_get(ring, c.byref(found[-1])):
        found.append(Frame())
    return found[:-1]


def slot(node, bus="left"):
    """The next slot of the node; what it sent on a bus, by identifier."""
    assert native.functions().node_step(c.byref(node.struct)) == 0
    by = {}
    for frame in sent(node, bus):
        by.setdefault(frame.id, []).append(frame)
    return by


@pytest.fixture(name="node")
def node_(tmp_path):
    """``master_control`` (number 2) of can.toml, without need of anybody else."""
    found = document("can")
    found["nodes"]["master_control"] |= {"requires": [], "stale": {}}
    with Slots(system_of(found, tmp_path), "master_control", tmp_path) as slots:
        slots.begin()
        yield slots


@pytest.fixture(name="host")
def host_(tmp_path):
    """``master_control`` of can-cia402.toml, which is node 2 to its drives."""
    with Slots(named("can-cia402"), "master_control", tmp_path) as slots:
        yield slots


# ---- emergency stops ----


def estops(node, slots, bus="left"):
    """How many it sends in each of so many slots of 5 ms."""
    of = node.system.services[bus].estop.message.id
    return [len(slot(node, bus).get(of, [])) for _ in range(slots)]


def hear_estop(node):
    frame = node.system.services["left"].estop.frame([1, 0], Header())
    node.put("left", frame, node.struct.slot * node.struct.h_ns * 1e-9)


def test_an_emergency_stop_that_is_heard_is_passed_on_ten_times_every_10_ms(node):
    assert node.struct.h_ns == 5 * MS
    assert estops(node, 4) == [0] * 4
    hear_estop(node)
    assert estops(node, 30) == [1, 0] * 10 + [0] * 10
    assert node.struct.alarms == 0
    native.functions().node_tell(c.byref(node.struct), 4)  # RESET
    assert estops(node, 4) == [0] * 4 and node.struct.life.reasons == 0
    hear_estop(node)
    assert estops(node, 5) == [1, 0, 1, 0, 1]  # another one is new


def test_an_emergency_stop_of_its_own_is_sent_until_reset(node):
    node.struct.alarm = 1
    assert estops(node, 50) == [1, 0] * 25
    native.functions().node_tell(c.byref(node.struct), 4)
    assert estops(node, 10) == [0] * 10
    assert node.struct.alarm == 0


def test_an_emergency_stop_tells_who_sends_it_and_all_reasons(node):
    node.struct.alarm, node.struct.life.now = 1, Why.STALE
    encoding = node.system.services["left"].estop
    (frame,) = slot(node)[encoding.message.id]
    _, values, _ = encoding.decode(frame.payload)
    assert values.tolist() == [2, Why.ESTOP | Why.STALE]


# ---- heartbeats and SYNC ----


@pytest.mark.parametrize(
    ("reasons", "status"),
    [
        (0, 0), (Why.ESTOP, Status.ESTOP), (Why.STALE, Status.STALE), (Why.PEER, 0),
        (Why.ESTOP | Why.STALE, Status.ESTOP | Status.STALE),
    ],
)  # fmt: skip
@pytest.mark.parametrize("simulated", [0, 1])
def test_a_heartbeat_tells_life_reasons_boots_and_arming(node, reasons, status, simulated):
    s, encoding = node.struct, node.system.services["left"].heartbeats[2]
    s.simulated, s.boots, s.heartbeat_slots, s.beats = simulated, 4096 + 17, 1, 3
    s.life.state, s.life.reasons, s.life.armed = LifeState.FAULT, reasons, 0
    (frame,) = slot(node)[encoding.message.id]
    _, values, header = encoding.decode(frame.payload)
    assert values.tolist() == [LifeState.FAULT, reasons, 17, 0]
    assert header.status == status | (Status.SIMULATED if simulated else 0)
    assert header.counter == 3
    s.life.state, s.life.reasons, s.life.armed = LifeState.INACTIVE, 0, 1
    (frame,) = slot(node)[encoding.message.id]
    assert encoding.decode(frame.payload)[1].tolist() == [LifeState.INACTIVE, 0, 17, 1]


def test_syncs_count_from_1_to_240_and_from_there_to_1(node):
    s, encoding = node.struct, node.system.services["left"].sync
    s.sync_slots, said = 1, []
    for count in (0, 1, 238, 239, 240):
        s.sync_count = count
        (frame,) = slot(node)[encoding.message.id]
        said += encoding.decode(frame.payload)[1].tolist()
    assert said == [1, 2, 239, 240, 1]


# ---- what drives of CANopen are told ----

#: State of a heartbeat (CiA 301, 7.2.8.3.2.2): boot-up, pre-operational, operational, stopped.
STATES = {
    LifeState.UNCONFIGURED: 0x00, LifeState.INACTIVE: 0x7F, LifeState.ACTIVE: 0x05,
    LifeState.STOPPING: 0x05, LifeState.FAULT: 0x04, LifeState.FINISHED: 0x04,
}  # fmt: skip


def tell(host, t):
    """What the drives are told at `t` ns: states of heartbeats."""
    native.functions().node_host(c.byref(host.struct), t)
    return [frame.payload[0] for frame in sent(host, "left") if frame.id == HOST]


@pytest.mark.parametrize("state", LifeState)
def test_drives_hear_the_state_of_their_host(host, state):
    host.struct.life.state, host.struct.host_due_ns = state, 0
    assert tell(host, 0) == [STATES[state]]


def test_heartbeats_of_a_host_keep_their_period_and_a_late_one_is_not_made_up_for(host):
    s = host.struct
    period = s.host_ns
    s.host_due_ns = 100 * MS
    assert tell(host, 100 * MS - 1) == []
    assert len(tell(host, 100 * MS + 1)) == 1
    assert s.host_due_ns == 100 * MS + period  # not a little later each time
    assert tell(host, 100 * MS + period - 1) == []
    late = 100 * MS + 2 * period  # exactly when the next one is due, too
    assert len(tell(host, late)) == 1 and s.host_due_ns == late + period
    assert tell(host, late) == []
    s.host_ns = 0
    assert tell(host, late + 100 * period) == []


def test_syncs_of_a_host_come_every_so_many_slots_also_before_the_first_one(host):
    s, bus = host.struct, host.names.index("left")
    s.services[bus].host_sync_slots = 3
    period = 3 * s.h_ns
    s.host_sync_ns = 100 * period

    def syncs(t):
        native.functions().node_host_sync_early(c.byref(s), t)
        return sum(frame.id == SYNC for frame in sent(host, "left"))

    times = (period - 1, 0, 1, period - 1, period, 2 * period, 2 * period + 5, 4 * period + 1)
    found = [syncs(100 * period + t) for t in times[1:]]
    assert found == [0, 0, 0, 1, 1, 0, 1]
    host.begin()
    assert [len(slot(host).get(SYNC, [])) for _ in range(7)] == [1, 0, 0, 1, 0, 0, 1]
