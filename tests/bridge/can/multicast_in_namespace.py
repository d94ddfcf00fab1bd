"""The contract of buses on udp_multicast between two processes, in a separate network namespace.

test_bus_multicast.py starts it and creates the namespace: a multicast packet that leaves the
loopback interface is sent on `leak0` there, and counted.
"""

import multiprocessing
import os
from collections.abc import Iterator, Sequence
from itertools import count
from multiprocessing.connection import Connection
from pathlib import Path

import can
import pytest

from bridge.can.health import interface_counters
from bridge.can.interface import CanBusSpec, attach
from bridge.can.multicast import open_group
from bridge.can.socket import BusError
from bridge.native import pace
from bridge.native.bus import Accept
from bridge.native.frame import Frame
from bridge.native.journal import Journal
from tests.bridge.can.bus_contract import BusContract, collect, keys, numbered

assert os.environ.get("COSIM_TEST_NAMESPACE") == "1", "only in the namespace of the test"
PORTS = count(42000)


def serve(connection: Connection) -> None:
    """A node in a process of its own: sends what it is told, tells what it received."""
    while request := connection.recv():
        name, value = request
        if name == "open":
            other = attach(CanBusSpec("peer", "udp_multicast", fd=True, options={"port": value}))
            connection.send(None)
        elif name == "send":
            connection.send([other.bus.send(Frame.from_buffer_copy(raw)) for raw in value])
        elif name == "take":
            connection.send([bytes(frame) for frame in collect(other.bus, value)])
        else:
            other.close()


class ProcessPeer:
    def __init__(self, connection: Connection, port: int) -> None:
        self.connection = connection
        self.ask("open", port)

    def ask(self, name: str, value: object) -> list:
        self.connection.send((name, value))
        return self.connection.recv()

    def send(self, frames: Sequence[Frame]) -> None:
        assert set(self.ask("send", [bytes(frame) for frame in frames])) <= {0}

    def take(self, n: int) -> list[Frame]:
        return [Frame.from_buffer_copy(raw) for raw in self.ask("take", n)]

    def close(self) -> None:
        self.connection.send(("close", None))


@pytest.fixture(scope="module")
def process() -> Iterator[Connection]:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    child = context.Process(target=serve, args=(theirs,))
    child.start()
    yield ours
    ours.send(None)
    child.join()


class TestMulticast(BusContract):
    @pytest.fixture
    def connect(self, process: Connection):
        def connect(log: Journal, accepts: Sequence[Accept] | None):
            port = next(PORTS)
            spec = CanBusSpec("a", "udp_multicast", fd=True, options={"port": port})
            ours = attach(spec, number=3, log=log, accepts=accepts)
            return ours, ProcessPeer(process, port)

        return connect


def sent_by(interface: str) -> int:
    found = interface_counters(interface)
    assert found is not None
    return found.sent


def test_no_packet_leaves_the_loopback_interface():
    """Neither frames nor the announcement of the group; then a control that does leave."""
    before, on_lo = sent_by("leak0"), sent_by("lo")
    a, b = (attach(CanBusSpec(n, "udp_multicast", fd=True)) for n in "ab")
    for frame in numbered(50):
        a.bus.send(frame)
    assert len(collect(b.bus, 50)) == 50
    a.close()
    b.close()
    assert sent_by("leak0") == before
    assert sent_by("lo") >= on_lo + 50
    with open_group(local=False) as abroad:
        abroad.send(can.Message(arbitration_id=1))
    assert sent_by("leak0") > before


def test_local_takes_nothing_from_other_interfaces():
    """A plain python-can bus sends where the routes lead: it is not heard; it hears us."""
    plain = can.Bus(interface="udp_multicast", channel="239.74.163.2")
    ours = attach(CanBusSpec("a", "udp_multicast", fd=True))
    plain.send(can.Message(arbitration_id=1, is_extended_id=False))
    assert plain.recv(5) is not None  # its own, looped back
    ours.bus.send(Frame.of(2, b"x"))
    message = plain.recv(5)
    assert message is not None and (message.arbitration_id, bytes(message.data)) == (2, b"x")
    assert ours.bus.drain() == []
    plain.shutdown()
    ours.close()


def test_what_the_kernel_dropped_is_counted():
    """A receiver with a small queue that does not read: what is missing is in `lost`."""
    receiver, sender = open_group(), open_group()
    receiver._in.setsockopt(1, 8, 4096)
    for k in range(500):
        sender.send(can.Message(arbitration_id=k))
    found = list(iter(lambda: receiver.recv(0.1), None))
    sender.send(can.Message(arbitration_id=500))
    assert receiver.recv(5).arbitration_id == 500  # it carries the count
    assert 0 < len(found) < 500
    assert receiver.lost == 500 - len(found)
    for bus in (receiver, sender):
        bus.shutdown()


def test_classic_bus_neither_sends_nor_takes_can_fd():
    with open_group(fd=False) as classic, open_group() as other:
        other.send(can.Message(arbitration_id=1, is_fd=True))
        other.send(can.Message(arbitration_id=2))
        assert classic.recv(5).arbitration_id == 2
        with pytest.raises(can.CanOperationError, match="CAN FD frame on a classic bus"):
            classic.send(can.Message(is_fd=True))


@pytest.mark.parametrize("group", ["10.0.0.1", "hello", "ff15::1"])
def test_what_is_no_group_is_refused(group: str):
    with pytest.raises(BusError, match=r"expected (a|an IPv4) group"):
        open_group(group)


def test_times_of_frames_are_of_this_machines_clock(tmp_path: Path):
    a, b = (attach(CanBusSpec(n, "udp_multicast")) for n in "ab")
    a.bus.send(Frame.of(1))
    (frame,) = collect(b.bus, 1)
    assert frame.t_ns <= pace.now()
    assert keys([frame]) == [(1, 0, b"")]
    a.close()
    b.close()
