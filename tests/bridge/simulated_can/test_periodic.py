"""Periodic messages and time-outs on a simulated bus that goes with the wall clock."""

from __future__ import annotations

import threading
import time
from itertools import pairwise
from typing import Any

import can
import pytest

from bridge.simulated_can.bus import CosimBus
from bridge.simulated_can.channel import Channel
from bridge.simulated_can.pace import WallPace
from tests.bridge.simulated_can.benches import Bench, bench, message

__all__ = ["bench"]


def received(bus: CosimBus, count: int) -> list[can.Message]:
    found = [bus.recv(20.0) for _ in range(count)]
    return [m for m in found if m is not None]


@pytest.mark.parametrize("asleep", [0.0, 0.15])
def test_messages_keep_their_period_whether_anybody_listens_or_not(
    bench: Bench, asleep: float
) -> None:
    sender, listener = bench.bus(speed=1.0), bench.bus(speed=1.0)
    task = sender.send_periodic(message(0x123, bytes(8)), 0.01, 0.2)
    time.sleep(asleep)  # the channel goes on without a call, and catches up
    times = [m.timestamp for m in received(listener, 20)]
    assert [b - a for a, b in pairwise(times)] == pytest.approx([0.01] * 19, abs=1e-6)
    assert listener.recv(0.05) is None
    assert task.stopped  # type: ignore[attr-defined]
    assert task.end_time == pytest.approx(times[0] + 0.2, abs=1e-3)  # type: ignore[attr-defined]


def test_a_task_says_when_it_ends_as_soon_as_it_is_started(bench: Bench) -> None:
    """As python-can's own tasks do; again after a new start."""
    sender = bench.bus(speed=1.0)
    task: Any = sender.send_periodic(message(0x123), 0.01, 0.2)
    first = task.end_time
    assert first is not None
    task.stop()
    time.sleep(0.01)
    task.start()
    assert task.end_time >= first + 0.01
    assert sender.send_periodic(message(0x124), 0.01).end_time is None  # type: ignore[attr-defined]


def test_many_tasks_are_sent_in_turn(bench: Bench) -> None:
    """150 of them once met in a call of a call."""
    sender, listener = bench.bus(speed=1.0), bench.bus(speed=1.0)
    tasks: list[Any] = [sender.send_periodic(message(0x100 + i, bytes(8)), 0.1) for i in range(150)]
    time.sleep(0.25)
    expected = [0x100 + i for i in range(150)]
    # On a busy machine the first tasks are due again before the last ones have begun.
    found: dict[int, None] = {}
    while len(found) < 150:
        found[received(listener, 1)[0].arbitration_id] = None
    assert list(found) == expected
    for task in tasks:
        task.stop()
    assert all(task.stopped for task in tasks)


def test_what_has_come_is_received_without_catching_up(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A slow machine may never catch up with many tasks: it received nothing at all then."""
    sender, listener = bench.bus(speed=1.0), bench.bus(speed=1.0)
    for k in range(2):
        sender.send(message(0x100 + k))
    time.sleep(0.02)
    assert listener.time  # asking for the time catches up: both have arrived

    def late(*_: object) -> None:
        raise AssertionError("caught up")

    monkeypatch.setattr(WallPace, "catch_up", late)
    assert len(received(listener, 2)) == 2


def test_calls_return_although_the_channel_falls_further_and_further_behind(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a machine that needs more than a second for a second of traffic, a call never returned."""
    sender, listener = bench.bus(speed=1.0), bench.bus(speed=1.0)
    advance, found = Channel.advance, []

    def slow(channel: Channel, until_ps: int) -> None:
        time.sleep(60e-12 * (until_ps - channel.now_ps))
        advance(channel, until_ps)

    def calls() -> None:
        for k in range(2):
            sender.send(message(0x100 + k))
        found.extend(received(listener, 2))
        found.append(listener.recv(0.1))

    monkeypatch.setattr(Channel, "advance", slow)
    time.sleep(0.5)
    thread = threading.Thread(target=calls, daemon=True)
    thread.start()
    thread.join(100)
    monkeypatch.setattr(Channel, "advance", advance)
    assert [m and m.arbitration_id for m in found] == [0x100, 0x101, None]


def test_a_time_out_is_of_the_channel(bench: Bench) -> None:
    """At a hundredth of the speed a hundredth of a second takes one, and at a hundredfold 10 ms."""
    fast = bench.bus(speed=100.0)
    began = fast.time
    assert fast.recv(2.0) is None
    assert 2.0 <= fast.time - began < 100.0  # 2 s of the wall are 200 s there


def test_what_a_modifier_sends_besides_is_no_call_of_a_call(bench: Bench) -> None:
    sender, listener = bench.bus(speed=1.0), bench.bus(speed=1.0)
    task = sender.send_periodic(
        message(0x1, bytes(1)), 0.01, 0.05, modifier_callback=lambda m: sender.send(message(0x2))
    )
    found = received(listener, 10)
    assert sorted(m.arbitration_id for m in found) == [1] * 5 + [2] * 5
    assert task.duration == 0.05
