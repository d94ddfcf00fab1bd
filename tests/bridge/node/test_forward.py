"""Statuses, counts and times of what a gateway forwards, on the simulated clock."""

from __future__ import annotations

import ctypes as c

import numpy as np
import pytest

from bridge.native import node as native
from bridge.native.frame import Frame
from bridge.native.message import Header, encode
from bridge.native.safety import LifeState, Status, Why
from tests.bridge.deployments import named
from tests.bridge.slots import Slots

TELLS, CUT, NONE = "all of a status", "a status without the state", "no status"
FLAGS = Status.DEADMAN | Status.STALE


class Gateway:
    """``left_gateway`` of gateway.toml, and the message LINK_2 that it forwards to the network."""

    def __init__(self, slots):
        self.slots, self.s = slots, slots.struct
        self.reception = slots.wired.inlet_bindings.receptions["LINK_2"]
        self.forward = slots.wired.forwards["xi_master"]
        self.codec = slots.system.messages["xi_master"].encoding

    def make(self, kind):
        """The message as one with such a status."""
        original = self.reception.message.contents
        message = type(original).from_buffer_copy(original)
        fields = (type(original.header.contents) * 3)(*original.header[:3])
        message.header = fields
        if kind is CUT:
            fields[message.status].length, fields[message.status].scale = 5, 8.0
        if kind is NONE:
            message.status = -1
        self.kept = message, fields
        self.reception.message = c.pointer(message)

    def say(self, k, status):
        """Sample `k` arrives for the next slot; statuses of what is forwarded then."""
        t = k * self.reception.period_ns + self.reception.offset_ns
        frame, values = Frame(), np.array([1.0, 2.0, 0.25, 0.5])
        encode(self.kept[0], values.ctypes.data, Header(k, status, t // 1000), frame)
        self.slots.put("left", frame, self.s.slot * self.s.h_ns * 1e-9)
        assert native.functions().node_step(c.byref(self.s)) == 0
        return [self.codec.decode(f.payload)[2].status for f in self.sent("net")]

    def sent(self, bus):
        ring, found = self.s.buses[self.slots.names.index(bus)].tx, [Frame()]
        while native.functions().ring_get(ring, c.byref(found[-1])):
            found.append(Frame())
        identifier = self.codec.message.id
        return [f for f in found[:-1] if f.id == identifier]


@pytest.fixture
def gateway(tmp_path):
    with Slots(named("gateway"), "left_gateway", tmp_path) as slots:
        slots.begin()
        yield Gateway(slots)


@pytest.mark.parametrize("simulated", [0, 1])
@pytest.mark.parametrize("peer", [-1, *LifeState])
@pytest.mark.parametrize("kind", [TELLS, CUT, NONE])
def test_the_status_of_a_sender_is_its_own_or_that_of_its_heartbeat(gateway, kind, peer, simulated):
    """A sender that tells no state counts as ACTIVE.

    A message without a status that comes to a simulated node counts as simulated.
    """
    gateway.make(kind)
    gateway.s.simulated = simulated
    gateway.reception.accept_simulated = 1
    for other in gateway.slots.wired.peers.values():
        other.state = LifeState.FAULT if other.number != gateway.reception.sender else peer
    own = {TELLS: LifeState.STOPPING, CUT: 0, NONE: 0}[kind]
    (status,) = gateway.say(0, FLAGS | own)
    told = peer if peer > LifeState.INACTIVE else LifeState.ACTIVE
    expected = {
        TELLS: FLAGS | LifeState.STOPPING,
        CUT: FLAGS | told,
        NONE: told | (Status.SIMULATED if simulated else 0),
    }
    assert status == expected[kind]


def test_a_peer_behind_the_table_is_not_asked(gateway):
    gateway.make(CUT)
    peers = list(gateway.s.peers[: gateway.s.n_peers])
    peers[-1].number, peers[-1].state = gateway.reception.sender, LifeState.FAULT
    for peer in peers[:-1]:
        peer.number = 99
    gateway.s.n_peers -= 1
    assert gateway.say(0, 0) == [LifeState.ACTIVE]
    gateway.s.n_peers += 1
    assert gateway.say(1, 0) == [LifeState.FAULT]


def test_samples_that_are_forwarded_are_counted_from_the_start_on(gateway):
    gateway.make(TELLS)
    gateway.s.begun = 0
    assert len(gateway.say(0, LifeState.ACTIVE)) == 1
    assert (gateway.forward.sent, gateway.forward.failed) == (0, 0)
    gateway.s.begun = 1
    assert len(gateway.say(1, LifeState.ACTIVE)) == 1
    assert (gateway.forward.sent, gateway.forward.failed) == (1, 0)
    bus = gateway.s.buses[gateway.forward.bus]
    room = bus.tx.contents.capacity
    bus.tx.contents.capacity = 0
    gateway.say(2, LifeState.ACTIVE)
    bus.tx.contents.capacity = room
    assert (gateway.forward.sent, gateway.forward.failed) == (1, 1)
    assert gateway.forward.transit.count == 0  # no time passes here


def test_what_is_forwarded_is_not_more_than_the_table_has(gateway):
    gateway.make(TELLS)
    gateway.reception.n_forwards -= 1
    assert gateway.say(0, LifeState.ACTIVE) == []


def test_a_frame_that_is_older_or_refused_is_not_forwarded(gateway):
    gateway.make(TELLS)
    assert [len(gateway.say(k, LifeState.ACTIVE)) for k in range(4)] == [1] * 4
    assert gateway.say(3, LifeState.ACTIVE) == gateway.say(2, LifeState.ACTIVE) == []


def test_a_fault_that_a_sample_tells_is_that_of_its_sender_at_once(gateway):
    """Sooner than its heartbeat, and of no other."""
    gateway.make(TELLS)
    gateway.say(0, LifeState.STOPPING)
    peers = gateway.slots.wired.peers.values()
    assert all(peer.state != LifeState.FAULT for peer in peers)
    gateway.say(1, LifeState.FAULT)
    of = {peer.number for peer in peers if peer.state == LifeState.FAULT}
    assert of == {gateway.reception.sender}
    assert not gateway.s.life.reasons & Why.BUS
