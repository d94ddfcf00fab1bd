"""Receivers of other libraries, one call per cycle, are the semantics that docs/links.md names."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator

import can
import pytest
import zenoh

from cosim.base.clock import sleep
from cosim.links.laws import Constant
from cosim.links.semantics import Grid, PacketSemantics, QueueSemantics, Rule
from cosim.links.table import DrawnTable

TICKS = 60
GRID = Grid(1, 3, 0.001)  # a sample each tick, and a look each three
LARGE = QueueSemantics(1000)


def rows(rule: Rule) -> list[int]:
    """The samples that a link without delay holds."""
    return DrawnTable("x", GRID, Constant(0.0), rule, 0).stream().rows(TICKS // 3).tolist()


def driven(send: Callable[[int], object], take: Callable[[], int | None]) -> list[int]:
    """The samples held by a receiver that takes in every third tick; None: nothing is there."""
    held, found = -1, []
    for tick in range(TICKS - 2):
        send(tick)
        if tick % GRID.n_r == 0:
            taken = take()
            held = held if taken is None else taken
            found.append(held)
    return found


def until(condition: Callable[[], bool]) -> None:
    """Wait for another thread."""
    for _ in range(10_000):
        if condition():
            return
        sleep(0.001)
    raise AssertionError("nothing came within 10 s")


# ---- Zenoh --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def session() -> Iterator[zenoh.Session]:
    """A session that talks to itself."""
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", "[]")
    with zenoh.open(config) as opened:
        yield opened


def number(sample: zenoh.Sample | None) -> int | None:
    return None if sample is None else int(sample.payload.to_string())


@pytest.mark.parametrize(
    ("handler", "rule"),
    [
        (zenoh.handlers.RingChannel(4), QueueSemantics(4)),
        (zenoh.handlers.RingChannel(1), PacketSemantics("newest-stamp")),
        (zenoh.handlers.FifoChannel(100), LARGE),
        (None, LARGE),
    ],
    ids=["ring of 4", "ring of 1", "fifo", "default"],
)
def test_a_channel_of_zenoh(session, handler, rule):
    more = () if handler is None else (handler,)
    with session.declare_subscriber("queue/x", *more) as subscriber:
        found = driven(
            lambda j: session.put("queue/x", str(j)), lambda: number(subscriber.try_recv())
        )
    assert found == rows(rule)


def test_a_channel_of_zenoh_that_is_emptied_in_each_cycle(session):
    with session.declare_subscriber("queue/all", zenoh.handlers.RingChannel(4)) as subscriber:

        def take() -> int | None:
            last = None
            while (sample := subscriber.try_recv()) is not None:
                last = number(sample)
            return last

        found = driven(lambda j: session.put("queue/all", str(j)), take)
    assert found == rows(PacketSemantics("newest-stamp"))
    assert found == rows(QueueSemantics(4, take="all"))


@pytest.mark.parametrize(("handler", "room"), [((), 256), ((zenoh.handlers.FifoChannel(3),), 3)])
def test_a_full_fifo_of_zenoh_blocks_what_fills_it(session, handler, room):
    """256 places by default; nothing is dropped."""
    put = []

    def fill() -> None:
        for j in range(room + 5):
            session.put("queue/full", str(j))
            put.append(j)

    with session.declare_subscriber("queue/full", *handler) as subscriber:
        thread = threading.Thread(target=fill, daemon=True)
        thread.start()
        until(lambda: len(put) >= room)
        sleep(0.05)
        assert len(put) == room
        assert [number(subscriber.recv()) for _ in range(room + 5)] == list(range(room + 5))
        thread.join()


# ---- python-can ---------------------------------------------------------------------------------


@pytest.fixture
def buses() -> Iterator[tuple[can.BusABC, can.BusABC]]:
    """Two ends of a virtual bus."""
    with (
        can.Bus(interface="virtual", channel="queue") as sender,
        can.Bus(interface="virtual", channel="queue") as receiver,
    ):
        yield sender, receiver


def message(j: int) -> can.Message:
    return can.Message(arbitration_id=1, data=[j])


def test_a_buffered_reader_of_python_can(buses):
    """It has no limit, and one message is taken in each cycle."""
    sender, receiver = buses
    reader, arrived = can.BufferedReader(), []
    notifier = can.Notifier(receiver, [arrived.append, reader], timeout=0.01)

    def send(j: int) -> None:
        sender.send(message(j))
        until(lambda: len(arrived) == j + 1 and reader.buffer.qsize() == j + 1 - taken)

    taken = 0

    def take() -> int | None:
        nonlocal taken
        found = reader.get_message(timeout=0)
        taken += 1
        return None if found is None else found.data[0]

    found = driven(send, take)
    notifier.stop()
    assert found == rows(LARGE)


def test_a_listener_of_python_can_that_stores_its_message(buses):
    sender, receiver = buses
    stored = []
    notifier = can.Notifier(receiver, [lambda m: stored.append(m.data[0])], timeout=0.01)

    def send(j: int) -> None:
        sender.send(message(j))
        until(lambda: len(stored) == j + 1)

    found = driven(send, lambda: stored[-1])
    notifier.stop()
    assert found == rows(PacketSemantics("last-arrival"))


# ---- sockets ------------------------------------------------------------------------------------


def taken(receiver: socket.socket, size: int) -> int | None:
    """A number of `size` bytes from a socket; None: nothing is there."""
    try:
        data = receiver.recv(size)
    except BlockingIOError:
        return None
    return int.from_bytes(data, "big")


def datagrams(room: int) -> tuple[socket.socket, socket.socket]:
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, room)
    receiver.bind(("127.0.0.1", 0))
    receiver.setblocking(False)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sender.connect(receiver.getsockname())
    return sender, receiver


def test_a_udp_socket_of_which_one_datagram_is_read_per_cycle():
    sender, receiver = datagrams(1 << 20)
    with sender, receiver:
        found = driven(lambda j: sender.send(j.to_bytes(8, "big")), lambda: taken(receiver, 8))
    assert found == rows(LARGE)


def test_a_udp_socket_that_is_emptied_in_each_cycle():
    sender, receiver = datagrams(1 << 20)

    def take() -> int | None:
        last = None
        while (found := taken(receiver, 8)) is not None:
            last = found
        return last

    with sender, receiver:
        found = driven(lambda j: sender.send(j.to_bytes(8, "big")), take)
    assert found == rows(PacketSemantics("last-arrival"))


def test_a_full_udp_socket_drops_the_newest():
    """Its smallest buffer; of larger ones the kernel makes room in batches."""
    sender, receiver = datagrams(1)
    kept = []
    with sender, receiver:
        for j in range(1000):
            sender.send(j.to_bytes(64, "big"))
        while (found := taken(receiver, 64)) is not None:
            kept.append(found)
    assert 0 < len(kept) < 100
    assert kept == list(range(len(kept)))
    sender, receiver = datagrams(1)
    with sender, receiver:
        held = driven(lambda j: sender.send(j.to_bytes(64, "big")), lambda: taken(receiver, 64))
    assert held == rows(QueueSemantics(len(kept), "newest"))


def streams() -> tuple[socket.socket, socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        sender = socket.create_connection(server.getsockname())
        receiver, _ = server.accept()
    for end in (sender, receiver):
        end.setblocking(False)
    sender.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return sender, receiver


def test_a_tcp_stream_of_which_one_message_is_read_per_cycle():
    sender, receiver = streams()
    with sender, receiver:
        found = driven(lambda j: sender.send(j.to_bytes(8, "big")), lambda: taken(receiver, 8))
    assert found == rows(LARGE)


def test_a_tcp_stream_of_which_all_is_read():
    sender, receiver = streams()
    with sender, receiver:
        found = driven(
            lambda j: sender.send(j.to_bytes(8, "big")),
            lambda: int.from_bytes(receiver.recv(1 << 16)[-8:], "big"),
        )
    assert found == rows(PacketSemantics("fifo"))


def test_a_full_tcp_stream_stops_its_sender_and_drops_nothing():
    sender, receiver = streams()
    block, sent, got = bytes(1 << 16), 0, 0
    with sender, receiver:
        with pytest.raises(BlockingIOError):
            while True:
                sent += sender.send(block)
        receiver.setblocking(True)
        while got < sent:
            got += len(receiver.recv(1 << 16))
    assert got == sent
