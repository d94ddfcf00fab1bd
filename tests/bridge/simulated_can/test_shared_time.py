"""Threads that wait in simulated channels, and channels that have one time."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import ExitStack
from time import sleep

import pytest

from bridge.bus_server.several_buses import served_buses
from bridge.simulated_can import pace
from bridge.simulated_can.bus import CosimBus
from bridge.simulated_can.channel import Channel
from bridge.simulated_can.options import ChannelOptions
from bridge.simulated_can.shared_time import SharedTime
from cosim.bus.timing import BusTiming
from tests.bridge.simulated_can.benches import Bench, bench, message

__all__ = ["bench"]
KILO = BusTiming(125e3)


def together(*actions: Callable[[], None]) -> None:
    """Run each in a thread of its own; fail if one does not end."""
    threads = [threading.Thread(target=action, daemon=True) for action in actions]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20)
    assert not any(thread.is_alive() for thread in threads)


def test_threads_that_only_sleep_wake_at_their_times(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pace, "PATIENCE_NS", 10**10)  # the machine may be busy
    woke, all_there = [], threading.Barrier(2)

    def nap(seconds: float, times: int) -> None:
        bus = bench.bus()
        all_there.wait()
        for _ in range(times):
            bus.sleep(seconds)
            woke.append((round(bus.time * 1e6), seconds))

    together(lambda: nap(0.003, 4), lambda: nap(0.004, 2))
    expected = [(3000, 0.003), (4000, 0.004), (6000, 0.003), (8000, 0.004), (9000, 0.003)]
    assert woke == [*expected, (12000, 0.003)]


def test_a_sleep_ends_though_a_thread_is_away(bench: Bench) -> None:
    """This thread opens the bus and then does something else for longer than 20 ms."""
    bus, woke = bench.bus(), []

    def nap() -> None:
        bus.sleep(0.2)
        woke.append(bus.time)

    together(nap)
    assert woke == [0.2]


@pytest.fixture
def pair() -> object:
    """Two served buses of one time, and what makes a bus object on one of them."""
    with ExitStack() as stack, served_buses({"a": KILO, "b": KILO}, simulated=True) as channels:

        def bus(name: str) -> CosimBus:
            found = CosimBus(channels[name], speed="simulated")
            stack.callback(found.shutdown)
            return found

        yield bus


def test_a_thread_that_waits_in_one_channel_waits_in_all(pair: Callable[[str], CosimBus]) -> None:
    """The first works for longer than a channel's patience; the other waits for it all the same,
    also with a frame of its own that could be sent, which loses the arbitration.
    """
    arrived, all_there = [], threading.Barrier(2)

    def first() -> None:
        a, b = pair("a"), pair("b")
        assert a.time == b.time == 0.0
        all_there.wait()
        for _ in range(3):
            a.sleep(0.001)
            sleep(0.05)
            b.send(message(0x100))

    def second() -> None:
        b = pair("b")
        assert b.time == 0.0
        all_there.wait()
        for k in (1, 2, 3):
            b.sleep(k * 0.001 - b.time)
            b.send(message(0x200))
            got = b.recv(1.0)
            assert got is not None and got.arbitration_id == 0x100
            arrived.append(round(got.timestamp * 1e6) - 1000 * k)

    together(first, second)
    assert len(set(arrived)) == 1 and 350 < arrived[0] < 450


def test_who_has_ended_is_not_waited_for(pair: Callable[[str], CosimBus]) -> None:
    times = []

    def short() -> None:
        bus = pair("a")
        assert bus.time == 0.0
        bus.shutdown()

    def long() -> None:
        bus = pair("b")
        bus.sleep(0.5)
        times.append(bus.time)

    together(short)
    together(long)
    assert times == [0.5]


def test_a_channel_that_joins_is_at_the_time_of_the_others() -> None:
    time = SharedTime()
    first = Channel("first", ChannelOptions(timing=KILO), time)
    with time.lock:
        time.advance(7_000_000)
    assert time.next_ps() is None
    second = Channel("second", ChannelOptions(timing=KILO), time)
    assert second.now_ps == first.now_ps == time.now_ps == 7_000_000
