"""A mirror whose interface fails and comes back; real interfaces are in tests/vcan."""

from __future__ import annotations

import queue
from typing import Any, ClassVar

import can
import pytest

from bridge.bus_server import mirror
from bridge.simulated_can.channel import Channel
from bridge.simulated_can.options import PortOptions, channel_options
from cosim.base.queues import take
from tests.bridge.bench import until
from tests.bridge.simulated_can.benches import message


class Interface:
    """A SocketCAN bus object; `broken`: as while its interface is down."""

    broken = False
    opened = 0
    sent: ClassVar[list[int]] = []
    inbox: ClassVar[queue.SimpleQueue[can.Message]] = queue.SimpleQueue()

    def __init__(self, **_: Any) -> None:
        type(self).opened += 1

    def recv(self, timeout: float) -> can.Message | None:
        if self.broken:
            raise can.CanOperationError("Network is down", 100)
        try:
            return take(self.inbox, min(timeout, 0.01))
        except queue.Empty:
            return None

    def send(self, msg: can.Message, timeout: float) -> None:
        if self.broken:
            raise can.CanOperationError("Network is down", 100)
        self.sent.append(msg.arbitration_id)

    def shutdown(self) -> None:
        """Nothing to do."""


def test_both_directions_go_on_when_the_interface_is_up_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(can, "Bus", Interface)
    monkeypatch.setattr(mirror, "_POLL", 0.01)
    channel = Channel("bench", channel_options("bench", bitrate=1_000_000, speed=1.0))
    port = channel.open(PortOptions())
    mirrored = mirror.BusMirror(channel, "can0")
    monkeypatch.setattr(Interface, "broken", True)
    channel.send(port, message(1), None)
    until(lambda: mirrored.refused == 1 and Interface.opened > 2)
    monkeypatch.setattr(Interface, "broken", False)
    channel.send(port, message(2), None)
    until(lambda: Interface.sent == [2])
    Interface.inbox.put(message(3))
    found = channel.receive(port, lambda m: True, 20.0)
    assert found is not None and found.arbitration_id == 3
    mirrored.close()
