"""A simulated bus and a SocketCAN interface as one: what is sent on one appears on the other."""

from __future__ import annotations

import threading
from contextlib import suppress
from typing import final

import can

from bridge.simulated_can.channel import Channel
from bridge.simulated_can.options import ChannelOperationError, PortOptions
from cosim.base.errors import CosimError

_POLL = 0.2
"""How often the thread that reads the interface looks whether it is to end, s."""


class MirrorError(CosimError, OSError):
    """An interface that cannot be opened."""


@final
class BusMirror:
    """Passes frames between `channel` and the SocketCAN interface `name`, until it is closed.

    The mirror is one node of the simulated bus; frames of the interface wait in its queue, and are
    lost, and counted in `refused`, where that is full or the bus does not carry them, as are those
    to an interface that is down; it is opened again until it is up. Error frames are not passed on.
    Raises MirrorError where there is no such interface.
    """

    def __init__(self, channel: Channel, name: str) -> None:
        self._channel, self._name = channel, name
        self.refused = 0
        try:
            self._bus = self._open()
        except (OSError, can.CanError) as error:
            raise MirrorError(
                f"{name}: {error}; expected a SocketCAN interface that is up (ip link)"
            ) from error
        self._port = channel.open(PortOptions())
        self._ending = threading.Event()
        self._threads = [
            threading.Thread(target=run, daemon=True) for run in (self._inwards, self._outwards)
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Leave both."""
        self._ending.set()
        self._channel.close(self._port)
        for thread in self._threads:
            thread.join()
        self._bus.shutdown()

    def _inwards(self) -> None:
        while not self._ending.is_set():
            try:
                message = self._bus.recv(_POLL)
            except (can.CanError, OSError, ValueError):
                self._reopen()
                continue
            if message is None or message.is_error_frame:
                continue
            try:
                self._channel.send(self._port, message, None)
            except ChannelOperationError:
                self.refused += 1

    def _outwards(self) -> None:
        while True:
            try:
                message = self._channel.receive(self._port, _is_frame, None)
            except ChannelOperationError:
                return  # closed
            if message is not None:
                try:
                    self._bus.send(message, 1.0)
                except (can.CanError, OSError, ValueError):
                    self.refused += 1

    def _open(self) -> can.BusABC:
        return can.Bus(channel=self._name, interface="socketcan", fd=self._channel.timing.fd)

    def _reopen(self) -> None:
        """Open the interface again: it was set down, or removed and made anew."""
        self._ending.wait(_POLL)
        with suppress(OSError, can.CanError):
            before, self._bus = self._bus, self._open()
            before.shutdown()


def _is_frame(message: can.Message) -> bool:
    return not message.is_error_frame
