"""What we take for granted of the kernel: raw sockets, loopback, filters, scheduling, files."""

from __future__ import annotations

import contextlib
import mmap
import os
import select
import signal
import socket
import struct
import time
from pathlib import Path

import can
import pytest

from tests.children import fork
from tests.vcan.peers import Frame, call, open_socket, pair, pending, receive, send

FRAMES = [
    Frame(0x123, b""),
    Frame(0x7FF, bytes(range(8))),
    Frame(0x12345678, b"\xff" * 8, extended=True),
]


def test_frames_arrive_as_sent_in_order_and_not_at_their_sender(vcan: tuple[str, str]) -> None:
    with pair(vcan[0], vcan[0]) as (a, b), open_socket(vcan[1]) as other:
        send(a, FRAMES)
        assert receive(b, 3) == FRAMES
        assert pending(a) == pending(other) == []


def test_a_socket_may_hear_itself(vcan: tuple[str, str]) -> None:
    with open_socket(vcan[0]) as sock:
        sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_RECV_OWN_MSGS, 1)
        send(sock, FRAMES)
        assert receive(sock, 3) == FRAMES


@pytest.mark.parametrize("length", [0, 8, 12, 24, 64])
def test_can_fd(vcan: tuple[str, str], length: int) -> None:
    frame = Frame(0x3A1, bytes(range(length)), fd=True)
    with pair(vcan[0], vcan[0], fd=True) as (a, b), open_socket(vcan[0]) as classic:
        send(a, [frame])
        assert receive(b, 1) == [frame]
        assert pending(classic) == []


def test_a_classic_bus_refuses_fd(fresh_bus: str) -> None:
    call("ip", "link", "set", fresh_bus, "down")
    call("ip", "link", "set", fresh_bus, "mtu", "16", "up")
    with open_socket(fresh_bus, fd=True) as sock, pytest.raises(OSError):
        send(sock, [Frame(1, bytes(12), fd=True)])


def test_the_kernel_filters(vcan: tuple[str, str]) -> None:
    with pair(vcan[0], vcan[0]) as (a, b):
        rules = struct.pack("=IIII", 0x100, 0x7F0, 0x7FF, 0x7FF)
        b.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, rules)
        send(a, [Frame(number, b"") for number in (0x0FF, 0x100, 0x10F, 0x110, 0x7FF)])
        assert [frame.identifier for frame in receive(b, 3)] == [0x100, 0x10F, 0x7FF]
        assert pending(b) == []


def test_python_can_and_a_plain_socket_understand_each_other(vcan: tuple[str, str]) -> None:
    bus = can.Bus(interface="socketcan", channel=vcan[0], fd=True)
    with bus, open_socket(vcan[0], fd=True) as sock:
        bus.send(can.Message(arbitration_id=0x12345678, data=b"abc"))
        assert receive(sock, 1) == [Frame(0x12345678, b"abc", extended=True)]
        send(sock, [Frame(0x3A1, bytes(64), fd=True)])
        got = bus.recv(20)
    assert got and got.is_fd and not got.is_extended_id
    assert (got.arbitration_id, bytes(got.data)) == (0x3A1, bytes(64))


def test_the_kernel_sends_by_itself(vcan: tuple[str, str]) -> None:
    with can.Bus(interface="socketcan", channel=vcan[0]) as bus, open_socket(vcan[0]) as sock:
        task = bus.send_periodic(can.Message(arbitration_id=5, is_extended_id=False), 0.01)
        assert receive(sock, 5) == [Frame(5, b"")] * 5
        task.stop()


def test_a_pair_of_interfaces_is_a_wire(vcan: tuple[str, str]) -> None:
    call("ip", "link", "add", "dev", "vx0", "type", "vxcan", "peer", "name", "vx1")
    try:
        for end in ("vx0", "vx1"):
            call("ip", "link", "set", end, "up")
        with pair("vx0", "vx1") as (a, b):
            send(a, FRAMES)
            assert receive(b, 3) == FRAMES
    finally:
        call("ip", "link", "del", "dev", "vx0")


def test_stamps_do_not_run_backwards(vcan: tuple[str, str]) -> None:
    with pair(vcan[0], vcan[0]) as (a, b):
        b.setsockopt(socket.SOL_SOCKET, 35, 1)  # SO_TIMESTAMPNS
        stamps = []
        for _ in range(20):
            send(a, FRAMES[:1])
            _, extra, _, _ = b.recvmsg(16, 64)
            stamps.append(struct.unpack("qq", extra[0][2]))
    assert stamps == sorted(stamps)


def test_real_time_priority_is_granted() -> None:
    before = os.sched_getscheduler(0)
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
    try:
        assert os.sched_getscheduler(0) == os.SCHED_FIFO
        start = time.monotonic_ns()
        select.select([], [], [], 0.01)
        assert time.monotonic_ns() - start >= 10_000_000
    finally:
        os.sched_setscheduler(0, before, os.sched_param(0))


def _writes(path: Path, go: socket.socket) -> int:
    with path.open("r+b") as file, mmap.mmap(file.fileno(), 1 << 16) as shared:
        for i in range(1000):
            struct.pack_into("<Q", shared, 64 + 8 * i, i + 1)
            struct.pack_into("<Q", shared, 0, i + 1)
        go.send(b"!")
        signal.pause()
    return 0


def test_what_was_written_to_a_mapped_file_survives_its_writer(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    path.write_bytes(bytes(1 << 16))
    with contextlib.ExitStack() as stack:
        mine, theirs = map(stack.enter_context, socket.socketpair())
        writer = fork(lambda: _writes(path, theirs))
        assert mine.recv(1) == b"!"
        with path.open("rb") as file:
            live = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            assert struct.unpack_from("<Q", live) == (1000,)
        os.kill(writer, signal.SIGKILL)
        _, status = os.waitpid(writer, 0)
        assert os.waitstatus_to_exitcode(status) == -signal.SIGKILL
    data = path.read_bytes()
    assert struct.unpack_from("<1000Q", data, 64) == tuple(range(1, 1001))
