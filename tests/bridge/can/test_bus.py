"""Buses that need no kernel: rings in memory, and python-can's virtual interface."""

import errno
import socket
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.can.health import BusHealth, bus_health, interface_counters
from bridge.can.interface import CanBusSpec, attach, configuration, parse_spec
from bridge.can.socket import BusError
from bridge.can.threaded import RingedInterface
from bridge.native import frame as frames
from bridge.native.bus import (
    Accept,
    Bus,
    BusKind,
    BusState,
    TrafficStruct,
    last_second,
    traffic_add,
)
from bridge.native.frame import Flags, Frame, Ring
from bridge.native.journal import Journal
from cosim.base.clock import sleep, stopwatch
from cosim.base.errors import CosimError
from tests.bridge.can.bus_contract import (
    PATIENCE,
    BusContract,
    BusPeer,
    Pair,
    PythonCanPeer,
    numbered,
    numbers,
)

CHANNELS = count()


@dataclass
class InMemory:
    bus: Bus

    def health(self, now_ns: int) -> BusHealth:
        return bus_health(self.bus, "memory", now_ns)

    def close(self) -> None:
        pass


class TestMemory(BusContract):
    @pytest.fixture
    def connect(self):
        def connect(log: Journal, accepts: Sequence[Accept] | None):
            a, b = Ring(8192), Ring(8192)
            ours = Bus.from_rings(a, b, 3, log, accepts=accepts, kind=BusKind.MEMORY)
            return InMemory(ours), BusPeer(Bus.from_rings(b, a, kind=BusKind.MEMORY))

        return connect

    def test_times_are_monotonic_and_lie_where_things_happened(self, pair: Pair):
        """No clock is read: times are the caller's."""
        pair.peer.send([Frame.of(1, t_ns=12345)])
        assert pair.take(1)[0].t_ns == 12345


class TestVirtual(BusContract):
    @pytest.fixture
    def connect(self):
        def connect(log: Journal, accepts: Sequence[Accept] | None):
            channel = f"contract{next(CHANNELS)}"
            protocol = can.CanProtocol.CAN_FD
            peer = PythonCanPeer(can.Bus(channel, interface="virtual", protocol=protocol))
            spec = CanBusSpec("a", "virtual", channel, options={"protocol": protocol})
            return attach(spec, number=3, log=log, accepts=accepts), peer

        return connect


@given(st.lists(st.one_of(st.none(), st.binary(max_size=64))), st.sampled_from([1, 2, 8]))
def test_a_ring_is_a_bounded_queue(operations: list[bytes | None], capacity: int):
    """None takes one out, bytes put one in; against a list."""
    ring, model, dropped, taken = Ring(capacity), [], 0, 0
    for data in operations:
        if data is not None:
            fits = len(model) < capacity
            assert ring.put(Frame.of(1, data)) == fits
            model += [data] if fits else []
            dropped += not fits
        else:
            frame = Frame()
            assert ring.get(frame) == bool(model)
            if model:
                assert (frame.payload, frame.sequence) == (model.pop(0), taken)
                taken += 1
        assert (len(ring), ring.dropped) == (len(model), dropped)


def test_a_ring_between_two_threads_loses_nothing_it_does_not_count():
    """One thread writes as quickly as it can, one reads; 16 places."""
    ring, n, found = Ring(16), 20_000, []

    def write() -> None:
        for frame in numbered(n):
            ring.put(frame)

    writer = threading.Thread(target=write)
    writer.start()
    frame = Frame()
    while writer.is_alive() or len(ring):
        while ring.get(frame):
            found.append(int.from_bytes(frame.payload, "little"))
    writer.join()
    assert found == sorted(set(found))
    assert len(found) + ring.dropped == n


@pytest.mark.parametrize("capacity", [0, 3, -4])
def test_ring_of_another_size_is_refused(capacity: int):
    with pytest.raises(CosimError, match="expected a power of two"):
        Ring(capacity)


def test_more_data_than_a_frame_holds_is_refused():
    with pytest.raises(CosimError, match="233 bytes; at most 232 fit"):
        Frame.of(1, bytes(233))


def test_overrun_ring_counts_what_it_lost_and_keeps_the_oldest():
    a, b = Ring(16), Ring(16)
    ours, peer = (Bus.from_rings(*r, kind=BusKind.MEMORY) for r in ((a, b), (b, a)))
    results = [peer.send(frame) for frame in numbered(20)]
    assert [r == 0 for r in results] == [True] * 16 + [False] * 4
    assert peer.struct.send_failed == 4 and peer.struct.last_errno == results[-1]
    assert numbers(ours.drain()) == list(range(16))
    assert ours.struct.overruns == 4
    assert not bus_health(peer, "peer", 0).ok
    assert bus_health(peer, "peer", 0).sentence().startswith("peer: active, 4 not sent, ")


def test_full_log_is_counted_and_the_bus_goes_on(tmp_path):
    log = Journal.create(tmp_path / "j", frames.frame_dtype(8), 3)
    ring = Ring(16)
    bus = Bus.from_rings(ring, ring, log=log, kind=BusKind.MEMORY)
    assert {bus.send(frame) for frame in numbered(5)} == {0}
    assert len(bus.drain()) == 5
    assert (len(log), bus_health(bus, "a", 0).log_dropped) == (3, 7)


def test_a_message_longer_than_a_row_of_the_log_is_cut_there_only(tmp_path):
    log = Journal.create(tmp_path / "j", frames.frame_dtype(64), 3)
    ring = Ring(16)
    bus = Bus.from_rings(ring, ring, log=log, kind=BusKind.MEMORY)
    bus.send(Frame.of(1, bytes(range(200))))
    assert bus.drain()[0].payload == bytes(range(200))
    (row, _) = Journal.open(log.path)
    assert row["length"] == 200 and row["data"].tobytes() == bytes(range(64))


def test_traffic_of_the_last_second():
    """100 frames a second for 3 s; neither the older ones nor those of this 100 ms count."""
    traffic = TrafficStruct()
    for k in range(300):
        traffic_add(traffic, Frame.of(1, bytes(8), t_ns=k * 10_000_000))
    rate = last_second(traffic, 3_000_000_000)
    assert rate.frames == 100
    assert rate.bits == pytest.approx(100 * (111 + 98 / 30))
    assert rate.load(500_000) == pytest.approx(rate.bits / 500_000)
    assert last_second(traffic, 3_050_000_000).frames == 100
    assert last_second(traffic, 3_500_000_000).frames == 50
    assert last_second(traffic, 9_000_000_000).frames == 0


@pytest.mark.parametrize(
    ("flags", "length", "nominal", "data", "nominal_worst", "data_worst"),
    [
        (0, 8, 111, 0, 135, 0),
        (Flags.EXTENDED, 8, 131, 0, 160, 0),
        (Flags.FD | Flags.BRS, 8, 29, 97, 33, 114),
        (Flags.FD | Flags.BRS, 64, 29, 550, 33, 679),
        (Flags.FD, 64, 579, 0, 712, 0),
    ],
)  # fmt: skip
def test_bits_lie_between_no_stuffing_and_the_worst(
    flags, length, nominal, data, nominal_worst, data_worst
):
    traffic = TrafficStruct()
    traffic_add(traffic, Frame.of(1, bytes(length), flags))
    assert nominal < traffic.bits < nominal_worst
    assert (data < traffic.data_bits < data_worst) if data else traffic.data_bits == 0


def test_python_can_options_are_taken_as_its_users_write_them():
    spec = parse_spec(
        "a",
        ["-i", "udp_multicast", "-c", "239.1.2.3", "--fd", "--bus-kwargs", "port=99", "local=0"],
    )
    assert spec == CanBusSpec(
        "a", "udp_multicast", "239.1.2.3", fd=True, local=False, options={"port": 99}
    )
    with pytest.raises(BusError, match=r"bus a: .*invalid choice: 'cann'"):
        parse_spec("a", ["-i", "cann"])
    with pytest.raises(BusError, match="unrecognized arguments: --nonsense"):
        parse_spec("a", ["--nonsense"])


def test_what_is_not_given_comes_from_python_cans_environment(monkeypatch):
    monkeypatch.setenv("CAN_INTERFACE", "virtual")
    monkeypatch.setenv("CAN_CHANNEL", "there")
    config = configuration(CanBusSpec("a"))
    assert (config["interface"], config["channel"]) == ("virtual", "there")
    assert configuration(CanBusSpec("a", channel="here"))["channel"] == "here"


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        (CanBusSpec("left", "pcann"), 'bus left: .*"pcann".*python-can supports .*socketcan'),
        (CanBusSpec("left", "socketcan"), "expected one like"),
        (CanBusSpec("left", "slcan", "/dev/nowhere"), r"bus left \(slcan\): "),
        (CanBusSpec("left", "udp_multicast", "ff15::1"), "IPv6 group does not stay"),
        (CanBusSpec("left", "kvaser", "0"), r"bus left \(kvaser\): "),
    ],
)  # fmt: skip
def test_a_bus_that_cannot_be_opened_says_why(spec: CanBusSpec, message: str, monkeypatch):
    for name in ("CAN_INTERFACE", "CAN_CHANNEL"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(BusError, match=message):
        attach(spec)


def test_what_a_driver_refuses_is_health_not_an_exception():
    attached = attach(CanBusSpec("a", "virtual", f"contract{next(CHANNELS)}"))
    try:
        assert attached.bus.send(Frame.of(1, bytes(200))) == 0  # the ring takes any message
        attached.close()
        health = attached.health(0)
        assert health.send_failed == 1 and "200" in health.last_error
        assert not health.ok
    finally:
        attached.close()


def test_what_was_sent_before_it_is_closed_goes_out(monkeypatch):
    """Also where it comes when the sender has just found nothing more to send."""
    channel = f"closed {next(CHANNELS)}"
    peer = can.Bus(interface="virtual", channel=channel)
    ours = RingedInterface(can.Bus(interface="virtual", channel=channel), 0, None, None, 64)
    get, closing = ours._tx.get, threading.Thread(target=ours.close)

    def late(frame: Frame) -> bool:
        found = get(frame)
        if not found and not closing.ident:
            ours.bus.send(Frame.of(2))
            closing.start()
            assert ours._stop.wait(PATIENCE)
        return found

    monkeypatch.setattr(ours._tx, "get", late)
    ours.bus.send(Frame.of(1))
    sent = [peer.recv(PATIENCE), peer.recv(PATIENCE)]
    closing.join()
    assert [m and m.arbitration_id for m in sent] == [1, 2]
    peer.shutdown()


def test_a_bus_that_takes_no_frame_is_closed_all_the_same() -> None:
    """A node alone on a bus gets no acknowledgement, and its queue stays full."""

    class Alone(can.BusABC):
        asked = 0

        def __init__(self) -> None:
            super().__init__("none")

        def send(self, msg, timeout=None):
            Alone.asked += 1
            sleep(timeout or 0)
            raise can.CanOperationError("the queue is full")

        def recv(self, timeout=None):
            sleep(timeout or 0)

    ours = RingedInterface(Alone(), 0, None, None, 8192)
    for frame in numbered(5000):
        ours.bus.send(frame)
    ours.close()  # 500 s, if each of them were tried
    assert 0 < Alone.asked < 500
    health = ours.health("bus", 0)
    assert health.send_failed == 5000
    assert health.last_error == "the bus did not take all frames when it was closed"


def test_a_driver_that_fails_is_a_bus_that_is_down_until_it_works(monkeypatch):
    def broken(self, timeout):
        raise can.CanOperationError("unplugged")

    def wait_for(state: BusState) -> None:
        elapsed = stopwatch()
        while attached.bus.state != state and elapsed() < PATIENCE:
            sleep(0.002)

    with monkeypatch.context() as unplugged:
        unplugged.setattr("can.interfaces.virtual.VirtualBus._recv_internal", broken)
        attached = attach(CanBusSpec("a", "virtual", f"contract{next(CHANNELS)}"))
        wait_for(BusState.DOWN)
        assert attached.health(0).sentence() == "a: down, unplugged"
    wait_for(BusState.ACTIVE)
    assert attached.health(0).sentence() == "a: active, 1 restarts"
    attached.close()


def test_counters_of_an_interface(tmp_path):
    table = tmp_path / "dev"
    table.write_text(
        "Inter-| Receive\n face |bytes\n vcan0: 80 10 1 2 0 0 0 0 160 20 3 4 0 0 0 0\n"
    )
    found = interface_counters("vcan0", table)
    assert found is not None
    assert (found.received, found.receive_errors, found.receive_dropped) == (10, 1, 2)
    assert (found.sent, found.send_errors, found.send_dropped) == (20, 3, 4)
    assert interface_counters("vcan1", table) is None
    assert interface_counters("vcan0", tmp_path / "none") is None


def test_a_kernel_without_can_is_said_with_what_helps(monkeypatch):
    def refuses(*_):
        raise OSError(errno.EAFNOSUPPORT, "Address family not supported by protocol")

    monkeypatch.setattr(socket, "socket", refuses)
    with pytest.raises(BusError, match=r"can0: .*`python -m bridge.vcan run -- .*udp_multicast"):
        attach(CanBusSpec("a", "socketcan", "can0"))
