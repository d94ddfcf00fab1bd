"""Messages that a running gateway forwards, and those that it does not."""

from __future__ import annotations

import socket
import struct
import sys

import pytest

from bridge.native.frame import Frame
from bridge.native.message import Header
from bridge.native.safety import LifeState, Status, Why
from cosim.base.clock import monotonic_ns
from tests.bridge.bench import until
from tests.bridge.deployments import named
from tests.bridge.gates import SAMPLE, Gate

#: Slots so long that whatever is forwarded is not forwarded in one.
SLOW = ('deploy.nodes.left_gateway.step="100 s"', "run.stop=1000")


@pytest.fixture(scope="module")
def gate(tmp_path_factory):
    with Gate(named("gateway", *SLOW), "left_gateway", tmp_path_factory.mktemp("gate")) as found:
        yield found


def test_number_time_status_and_values_go_on_at_once(gate):
    slot, number = gate.struct.slot, gate.next("LINK_2")
    gate.say("LINK_2", number, [1, 2, 0.25, -0.5], SAMPLE | Status.DEADMAN)
    ((values, header),) = gate.heard("xi_master")
    assert values == [0.25, -0.5]
    assert (header.counter, header.t_us) == (number, number * 5000 + 500)
    assert header.status == SAMPLE | Status.DEADMAN
    assert gate.struct.slot == slot  # not in one of its slots


def test_a_counter_of_eight_bits_goes_on_unwrapped(gate):
    number = max(gate.next("LINK_2"), 260)
    gate.say("LINK_2", number, [1, 2, 3, 4])
    ((_, header),) = gate.heard("xi_master")
    assert header.counter == number and header.t_us == number * 5000 + 500


def test_what_comes_late_keeps_its_number(gate):
    number = gate.next("xi_slave")
    gate.say("xi_slave", number, [0.5, 1.5], late=0.9)
    ((values, header),) = gate.heard("XI_4")
    assert values == [0.5, 1.5] and header.counter == number % 256
    assert header.t_us == number * 5000 + 500


def test_a_stamp_ahead_of_the_clock_waits_for_no_slot(gate):
    carried, number = gate.system.messages["LINK_2"], gate.next("LINK_2")
    header = Header(number, SAMPLE, number * 5000 + 500)
    frame = carried.encoding.frame([0, 0, 8, 8], header, monotonic_ns() + 100_000_000)
    gate.rings["left"][0].put(frame)
    assert [values for values, _ in gate.heard("xi_master")] == [[8, 8]]


def test_what_is_refused_does_not_go_on(gate):
    number = gate.next("LINK_2")
    link, xi = (gate.wired.receivers[name] for name in ("LINK_2", "xi_slave"))
    accepted, sent = link.ok, gate.wired.forwards["xi_master"].sent
    gate.say("LINK_2", number, [0, 0, 1, 1])
    assert len(gate.heard("xi_master")) == 1
    wrong = Frame.from_buffer_copy(gate.say("LINK_2", number, [0, 0, 2, 2]))  # repeated
    wrong.data[12] ^= 1
    gate.put("left", wrong)
    gate.say("LINK_2", number - 2, [0, 0, 3, 3])  # older
    gate.say("LINK_2", number + 1, [0, 0, float("nan"), 0])
    number = gate.next("xi_slave")
    gate.say("xi_slave", number, [float("inf"), 0])
    gate.say("xi_slave", number + 1, [7, 7], late=2.2)  # beyond max_age
    gate.say("LINK_2", gate.next("LINK_2"), [0, 0, 5, 5])
    assert [values for values, _ in gate.heard("xi_master")] == [[5, 5]]
    assert gate.heard("XI_4", 0) == []
    assert (link.repeated, link.crc, link.reordered) == (1, 1, 1)
    assert link.invalid == xi.invalid == xi.stale == 1
    forward = gate.wired.forwards["xi_master"]
    assert forward.sent - sent == link.ok - accepted == 2
    assert forward.transit.count == forward.sent and 0 < forward.transit.maximum < 10**10


def test_senders_that_do_not_run_yet_are_seen_behind_it(gate):
    gate.say("LINK_2", 0, [0, 0, 9, 9], LifeState.INACTIVE | Status.SIMULATED)
    ((values, header),) = gate.heard("xi_master")
    assert values == [9, 9] and header.status & 7 == LifeState.INACTIVE


def test_commands_go_to_the_other_buses_only(gate):
    nmt = gate.system.services["left"].nmt
    gate.put("left", nmt.frame([2, 9], Header()))  # STOP, to somebody else
    on_net = gate.system.services["net"].nmt
    assert [values for values, _ in gate.forwarded(on_net, "net")] == [[2, 9]]
    assert gate.frames(nmt, "left") == []
    assert gate.struct.life.state == LifeState.ACTIVE
    gate.put("net", on_net.frame([128, 3], Header()))
    assert [values for values, _ in gate.forwarded(nmt, "left")] == [[128, 3]]


def test_an_emergency_stop_goes_on_at_once(gate):
    estop, slot = gate.system.services["net"].estop, gate.struct.slot
    for _ in range(3):
        gate.put("net", estop.frame([4, int(Why.ESTOP)], Header()))
    assert len(gate.forwarded(gate.system.services["left"].estop, "left")) == 1
    assert gate.struct.slot == slot and gate.struct.life.now & Why.ESTOP


def test_in_fault_it_forwards_still(tmp_path):
    with Gate(named("gateway", "run.stop=1000"), "left_gateway", tmp_path) as gate:
        gate.put("net", gate.system.services["net"].estop.frame([4, int(Why.ESTOP)], Header()))
        until(lambda: gate.struct.life.state == LifeState.FAULT)
        gate.say("LINK_2", 60, [0, 0, 1, 1], LifeState.FAULT | Status.SIMULATED)
        ((_, header),) = gate.heard("xi_master")
        assert header.status & 7 == LifeState.FAULT  # its sender's


def test_a_start_over_the_network_starts_the_island_behind_it(tmp_path):
    with Gate(named("gateway", *SLOW), "left_gateway", tmp_path, start=False) as gate:
        gate.say("LINK_2", 0, [0, 0, 1, 1], LifeState.INACTIVE | Status.SIMULATED)
        assert len(gate.heard("xi_master")) == 1  # already
        gate.put("net", gate.system.services["net"].nmt.frame([1, 0], Header()))
        gate.begun()
        nmt = gate.system.services["left"].nmt
        assert [values for values, _ in gate.frames(nmt, "left")] == [[1, 0]]


def test_for_real_drives_nothing_simulated_goes_on(tmp_path):
    with Gate(named("gateway", *SLOW), "left_gateway", tmp_path, real=True) as gate:
        gate.say("LINK_2", 100, [0, 0, 1, 1])
        gate.say("LINK_2", 101, [0, 0, 2, 2], LifeState.ACTIVE)
        assert [values for values, _ in gate.heard("xi_master")] == [[2, 2]]
        assert gate.wired.receivers["LINK_2"].simulated == 1


@pytest.mark.skipif(sys.platform != "linux", reason="arrivals are stamped by Linux")
def test_it_sleeps_on_sockets_too(tmp_path):
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with near, far:
        far.settimeout(20)
        ends = {"left": near.fileno()}
        system = named("gateway", *SLOW)
        with Gate(system, "left_gateway", tmp_path, sockets=ends) as gate:
            frame = system.messages["LINK_2"].encoding.frame([1, 2, 3, 4], Header(0, SAMPLE, 500))
            far.send(struct.pack("IBB2x64s", frame.id, frame.length, 5, frame.payload))
            ((values, header),) = gate.heard("xi_master")
            assert values == [3, 4] and header.counter == 0
            gate.say("xi_slave", 20, [5, 6])
            raw = b""
            while not raw.startswith(struct.pack("I", 0x3A4)):  # heartbeats come, too
                raw = far.recv(72)
            _, values, header = system.messages["XI_4"].encoding.decode(raw[8 : 8 + raw[4]])
            assert [*values] == [5, 6] and header.counter == 20
            far.send(b"")  # it wakes and sees that it is to end
