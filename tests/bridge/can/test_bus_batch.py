"""A socket returns several frames in one system call, with the same results."""

from __future__ import annotations

import errno
import socket
import struct
import sys

import pytest

from bridge.native.bus import Bus
from bridge.native.enums import BUS_BATCH as BATCH
from bridge.native.frame import Flags, Frame

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="sockets of the tick are Linux's")


class Pair:
    """A pair of UNIX sockets, which keep the bounds of frames as SocketCAN does."""

    def __init__(self):
        self.here, self.there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.bus = Bus.from_socket(self.here.fileno())

    def send(self, *numbers):
        for n in numbers:
            self.there.send(struct.pack("=IB3x8s", 0x100 + n, 8, bytes(8)))

    def drain(self):
        return [frame.id - 0x100 for frame in self.bus.drain()]


@pytest.fixture
def pair():
    made = Pair()
    with made.here, made.there:
        yield made


@pytest.mark.parametrize("n", [0, 1, BATCH - 1, BATCH, BATCH + 1, 3 * BATCH])
def test_a_drain_gives_all_there_is_in_order(pair, n):
    for _ in range(2):
        pair.send(*range(n))
        assert pair.drain() == list(range(n))
    assert pair.bus.struct.received == 2 * n


EFF, RTR, ERR = 1 << 31, 1 << 30, 1 << 29  # linux/can.h: flags of an identifier,
BRS, ESI, FDF = 1, 2, 4  # and of a CAN FD frame
KINDS = [  # our flags, identifier -> identifier and flags of the kernel
    (0, 0x7FF, 0x7FF, 0), (Flags.EXTENDED, 0x1FFFFFFF, 0x1FFFFFFF | EFF, 0),
    (Flags.REMOTE, 0x123, 0x123 | RTR, 0), (Flags.REMOTE | Flags.EXTENDED, 5, 5 | EFF | RTR, 0),
    (Flags.FD, 0x123, 0x123, 0), (Flags.FD | Flags.BRS, 0x123, 0x123, BRS),
    (Flags.FD | Flags.ESI, 0x123, 0x123, ESI),
    (Flags.FD | Flags.BRS | Flags.ESI | Flags.EXTENDED, 9, 9 | EFF, BRS | ESI),
]  # fmt: skip


@pytest.mark.parametrize(("flags", "identifier", "raw", "fd"), KINDS)
@pytest.mark.parametrize("length", [0, 3, 8])
def test_a_frame_is_the_struct_of_the_kernel_both_ways(pair, flags, identifier, raw, fd, length):
    """72 bytes for CAN FD, else 16; a remote frame has a length, but no data."""
    data, size = bytes(range(1, 9)), 64 if flags & Flags.FD else 8
    there = struct.pack(f"=IBBxx{size}s", raw, length, fd, data[:length])
    assert pair.bus.send(Frame.of(identifier, data[:length], int(flags))) == 0
    got = pair.there.recv(100)
    assert len(got) == size + 8 and (got[0:5], got[5] & ~FDF) == (there[0:5], fd)
    if not flags & Flags.REMOTE:
        assert got[8 : 8 + length] == data[:length]
    pair.there.send(struct.pack(f"=IBBxx{size}s", raw, length, fd, data))
    (frame,) = pair.bus.drain()
    assert (frame.id, frame.flags, frame.length) == (identifier, int(flags), length)
    kept = bytes(8) if flags & Flags.REMOTE else data[:length].ljust(8, b"\0")
    assert bytes(frame.data[:8]) == kept


@pytest.mark.parametrize("length", range(70))
@pytest.mark.parametrize("flags", [0, Flags.FD])
def test_lengths_that_no_frame_has_are_refused(pair, length, flags):
    possible = [*range(9), *((12, 16, 20, 24, 32, 48, 64) if flags else ())]
    result = pair.bus.send(Frame.of(1, bytes(length), int(flags)))
    assert result == (0 if length in possible else errno.EINVAL)


def test_a_frame_with_errors_keeps_its_class(pair):
    pair.there.send(struct.pack("=IBBxx8s", 0x144 | ERR, 8, 0, bytes(8)))
    assert pair.drain() == [] and pair.bus.struct.error_frames == 1


def test_what_is_no_frame_is_passed_over(pair):
    for _ in range(2):
        pair.there.send(b"no frame")
        pair.send(1)
        for _ in range(BATCH + 1):
            pair.there.send(b"no frame")
        pair.send(2)
        assert pair.drain() + pair.drain() == [1, 2]


def test_only_what_is_no_frame_hides_nothing_that_comes_later(pair):
    pair.there.send(b"no frame")
    assert pair.drain() == []
    pair.send(1)
    assert pair.drain() == [1]


def test_after_the_last_frame_comes_what_has_come_meanwhile(pair):
    pair.send(1)
    assert pair.drain() == [1]
    pair.send(2)
    assert pair.drain() == [2]


def test_who_has_left_finds_what_has_come_meanwhile(pair):
    frame = Frame()
    pair.send(1, 2)
    assert pair.bus.receive(frame) and frame.id == 0x101
    pair.bus.struct.emptied = 0  # bus_leave(): as a node does with a frame that is too early
    pair.send(3)
    assert pair.drain() == [2, 3]


def test_stamps_are_those_of_the_arrival(pair):
    pair.send(1, 2, 3)
    first, second, third = pair.bus.drain()
    assert 0 < first.t_ns < second.t_ns < third.t_ns


def test_frames_for_which_the_socket_had_no_room_are_counted():
    """By the kernel, since the socket was made. UDP has the same counter as SocketCAN."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as there,
    ):
        here.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 0)  # the least that there is
        here.bind(("127.0.0.1", 0))
        bus, got = Bus.from_socket(here.fileno()), 0
        for sent in (100, 200, 300):
            for _ in range(100):
                there.sendto(struct.pack("=IB3x8s", 0x100, 8, bytes(8)), here.getsockname())
            got += len(bus.drain())
            there.sendto(struct.pack("=IB3x8s", 0x100, 8, bytes(8)), here.getsockname())
            got += len(bus.drain())  # it comes with the number lost before it
            assert 0 < bus.struct.overruns == sent + sent // 100 - got


def test_an_error_that_the_socket_reports_hides_no_frame():
    """Nobody is there when the first datagram goes out; then somebody is, and answers."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here:
        here.bind(("127.0.0.1", 0))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as gone:
            gone.bind(("127.0.0.1", 0))
            place = gone.getsockname()
            here.connect(place)
        bus = Bus.from_socket(here.fileno())
        here.send(b"is nobody there")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as there:
            there.bind(place)
            there.sendto(struct.pack("=IB3x8s", 0x101, 8, bytes(8)), here.getsockname())
            assert [frame.id for frame in bus.drain()] == [0x101]
        assert bus.struct.last_errno == errno.ECONNREFUSED
