"""Faults that the kernel makes: its gateway, its queueing disciplines, interfaces that go away."""

from __future__ import annotations

import errno
import socket
import statistics
import time

import pytest

from tests.vcan.peers import (
    Frame,
    call,
    gateway,
    open_socket,
    pair,
    pending,
    queueing,
    receive,
    send,
)

N = 40
DELAY = 0.02  # s


def _flight(source: str, target: str) -> float:
    """Median time of a frame from one bus to another, s."""
    times = []
    with pair(source, target) as (a, b):
        for i in range(N):
            start = time.monotonic()
            send(a, [Frame(i, b"")])
            assert receive(b, 1)[0].identifier == i
            times.append(time.monotonic() - start)
    return statistics.median(times)


def _arrived(bus: str, n: int) -> list[int]:
    """Which of n numbered frames reach another socket of the bus; waits for a last one."""
    with pair(bus, bus) as (a, b):
        send(a, [Frame(i % 0x700, i.to_bytes(4, "big")) for i in range(n)])
        time.sleep(0.2)
        return [int.from_bytes(frame.data, "big") for frame in pending(b)]


def test_netem_delays(vcan: tuple[str, str]) -> None:
    without = _flight(vcan[0], vcan[0])
    with queueing(vcan[0], "netem", "delay", f"{DELAY * 1e3:g}ms"):
        delayed = _flight(vcan[0], vcan[0])
    assert delayed - without > 0.5 * DELAY


def test_netem_loses_all_some_and_none(vcan: tuple[str, str]) -> None:
    assert _arrived(vcan[0], 400) == list(range(400))
    with queueing(vcan[0], "netem", "loss", "100%"):
        assert _arrived(vcan[0], 400) == []
    with queueing(vcan[0], "netem", "loss", "50%"):
        some = _arrived(vcan[0], 400)
    assert some == sorted(set(some))
    assert 100 < len(some) < 300
    assert _arrived(vcan[0], 400) == list(range(400))


def test_netem_duplicates(vcan: tuple[str, str]) -> None:
    with queueing(vcan[0], "netem", "duplicate", "100%"):
        twice = _arrived(vcan[0], 50)
    assert sorted(twice) == sorted([*range(50), *range(50)])


def test_a_queue_that_is_full_refuses_or_drops(vcan: tuple[str, str]) -> None:
    with (
        queueing(vcan[0], "netem", "limit", "10", "delay", "50ms"),
        pair(vcan[0], vcan[0]) as (a, b),
    ):
        refused = 0
        for i in range(100):
            try:
                send(a, [Frame(i, b"")])
            except OSError as error:
                assert error.errno == errno.ENOBUFS
                refused += 1
        time.sleep(0.3)
        arrived = len(pending(b))
    assert 10 <= arrived < 100
    assert refused in (0, 100 - arrived)  # an error of the sender, or silent


def test_the_gateway_corrupts(vcan: tuple[str, str]) -> None:
    with gateway(*vcan, "-m", "XOR:D:0.0.0100000000000080"), pair(*vcan) as (a, b):
        send(a, [Frame(0x123, bytes(8)), Frame(0x124, b"\xff" * 8)])
        first, second = receive(b, 2)
    assert first == Frame(0x123, b"\x01" + bytes(6) + b"\x80")
    assert second == Frame(0x124, b"\xfe" + b"\xff" * 6 + b"\x7f")


def test_the_gateway_drops_what_does_not_fit_its_filter(vcan: tuple[str, str]) -> None:
    with gateway(*vcan, "-f", "123~7FF"), pair(*vcan) as (a, b):
        send(a, [Frame(number, b"") for number in (0x122, 0x123, 0x124)])
        assert [frame.identifier for frame in receive(b, 2)] == [0x122, 0x124]
        assert pending(b) == []


def test_the_gateway_counts_what_a_bus_that_is_down_did_not_take(vcan: tuple[str, str]) -> None:
    with gateway(*vcan), open_socket(vcan[0]) as a:
        call("ip", "link", "set", vcan[1], "down")
        send(a, [Frame(1, b"")] * 7)
        assert "0 handled 7 dropped" in call("cangw", "-L", check=False)


def test_two_buses_with_a_gateway_are_one_for_some(vcan: tuple[str, str]) -> None:
    there, back = gateway(*vcan, "-f", "100:700"), gateway(vcan[1], vcan[0], "-f", "200:700")
    with there, back, pair(*vcan) as (a, b):
        send(a, [Frame(0x101, b"a"), Frame(0x201, b"a")])
        send(b, [Frame(0x102, b"b"), Frame(0x202, b"b")])
        assert receive(b, 1) == [Frame(0x101, b"a")]
        assert receive(a, 1) == [Frame(0x202, b"b")]
        assert pending(a) == pending(b) == []


def test_the_gateway_forwards_fd_with_a_rule_for_it(vcan: tuple[str, str]) -> None:
    frame = Frame(0x3A1, bytes(range(64)), fd=True)
    with gateway(*vcan, "-X"), pair(*vcan, fd=True) as (a, b):
        send(a, [frame])
        assert receive(b, 1) == [frame]


def test_after_the_gateway_is_gone_the_buses_are_apart(vcan: tuple[str, str]) -> None:
    with gateway(*vcan):
        pass
    with pair(*vcan) as (a, b):
        send(a, [Frame(1, b"")])
        time.sleep(0.05)
        assert pending(b) == []


def test_an_interface_that_goes_down_is_seen_and_comes_back(vcan: tuple[str, str]) -> None:
    with pair(vcan[0], vcan[0]) as (a, b):
        call("ip", "link", "set", vcan[0], "down")
        with pytest.raises(OSError) as seen:
            b.recv(16)
        assert seen.value.errno == errno.ENETDOWN
        assert a.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) == errno.ENETDOWN
        with pytest.raises(OSError) as refused:
            send(a, [Frame(1, b"")])
        assert refused.value.errno == errno.ENETDOWN
        call("ip", "link", "set", vcan[0], "up")
        send(a, [Frame(2, b"x")])
        assert receive(b, 1) == [Frame(2, b"x")]


def test_an_interface_that_is_taken_away_is_seen(fresh_bus: str) -> None:
    with open_socket(fresh_bus) as sock:
        call("ip", "link", "del", "dev", fresh_bus)
        with pytest.raises(OSError) as seen:
            sock.recv(16)
    assert seen.value.errno in (errno.ENETDOWN, errno.ENODEV)
