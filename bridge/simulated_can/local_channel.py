"""A bus object's place on a simulated channel: of this process, or of another."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable, Sequence
from typing import Protocol, final

import can
from can.typechecking import CanFilters

from bridge.simulated_can.channel import Channel, ChannelPort, Wanted
from bridge.simulated_can.options import ChannelOptions, PortOptions, agree
from bridge.simulated_can.periodic import PeriodicTask, Sender
from bridge.simulated_can.protocol import address_of, is_remote
from bridge.simulated_can.remote_channel import RemoteChannel, RemotePeriodicTask
from cosim.bus.frames import ControllerState
from cosim.bus.settings import Disturbance
from cosim.bus.timing import BusTiming


class BusPlace(Protocol):
    """The questions of a bus object to its channel. Times are seconds of the channel."""

    @property
    def timing(self) -> BusTiming:
        """The bit rates."""

    def time(self) -> float:
        """Time of the channel in s, plus the date of its opening in wall time."""

    def status(self) -> tuple[ControllerState, int, int]:
        """State, TEC and REC now."""

    def lost(self) -> int:
        """Frames that were received while the receive queue was full."""

    def load(self, window: float) -> float:
        """The share of the last `window` (s) in which the bus was busy, 0 to 1."""

    def sleep(self, seconds: float) -> None:
        """Wait for so many seconds (s) of the channel."""

    def disturb(self, disturbance: Disturbance) -> None:
        """Add a disturbance from the end of the transmission under way on."""

    def flush(self) -> None:
        """Drop what waits in the transmit queue."""

    def reset(self) -> None:
        """Restart the controller, as after bus-off."""

    def filter(self, filters: CanFilters | None) -> None:
        """Receive only what passes one of these filters; None: everything."""

    def send(self, message: can.Message, timeout: float | None) -> None:
        """Queue a message, waiting up to `timeout` (s) for room."""

    def receive(self, wanted: Wanted | None, timeout: float | None) -> can.Message | None:
        """The oldest message that is `wanted`, waiting up to `timeout` (s; None: for ever)."""

    def periodic(
        self,
        sender: Sender,
        messages: can.Message | Sequence[can.Message],
        period: float,
        duration: float | None,
        modifier: Callable[[can.Message], None] | None,
    ) -> PeriodicTask | RemotePeriodicTask | None:
        """Messages every `period` (s) for `duration` (s); None: it cannot with a `modifier`."""

    def leave(self) -> None:
        """Leave the bus; what was queued is still sent."""


@final
class LocalChannel:
    """A channel of this process, for one bus object; see :class:`BusPlace`."""

    def __init__(self, name: Hashable, options: ChannelOptions, port: PortOptions) -> None:
        self._channel, self._port = _join(name, options, port)
        self.timing = self._channel.timing

    def time(self) -> float:
        """Time of the channel in s, plus the date of its opening in wall time."""
        return self._channel.time(self._port)

    def status(self) -> tuple[ControllerState, int, int]:
        """State, TEC and REC now."""
        return self._channel.state(self._port)

    def lost(self) -> int:
        """Frames that were received while the receive queue was full."""
        return self._port.lost

    def load(self, window: float) -> float:
        """The share of the last `window` (s) in which the bus was busy, 0 to 1."""
        return self._channel.load(window)

    def sleep(self, seconds: float) -> None:
        """Wait for so many seconds (s) of the channel."""
        self._channel.sleep(seconds)

    def disturb(self, disturbance: Disturbance) -> None:
        """Add a disturbance from the end of the transmission under way on."""
        self._channel.disturb(disturbance)

    def flush(self) -> None:
        """Drop what waits in the transmit queue."""
        self._channel.flush(self._port)

    def reset(self) -> None:
        """Restart the controller, as after bus-off."""
        self._channel.reset(self._port)

    def filter(self, filters: CanFilters | None) -> None:
        """Nothing to do: messages are filtered when they are received."""

    def send(self, message: can.Message, timeout: float | None) -> None:
        """Queue a message, waiting up to `timeout` (s) for room."""
        self._channel.send(self._port, message, timeout)

    def receive(self, wanted: Wanted | None, timeout: float | None) -> can.Message | None:
        """The oldest message that is `wanted`, waiting up to `timeout` (s; None: for ever)."""
        return self._channel.receive(self._port, wanted, timeout)

    def periodic(
        self,
        sender: Sender,
        messages: can.Message | Sequence[can.Message],
        period: float,
        duration: float | None,
        modifier: Callable[[can.Message], None] | None,
    ) -> PeriodicTask:
        """Messages every `period` (s) of the channel for `duration` (s; None: no end)."""
        return PeriodicTask(sender, self._channel, messages, period, duration, modifier)

    def leave(self) -> None:
        """Leave the bus; what was queued is still sent."""
        _leave(self._channel, self._port)


def place_on(name: Hashable, options: ChannelOptions, port: PortOptions) -> BusPlace:
    """A place on the channel: ``NAME@ADDRESS`` is of another process. Raises ChannelOptionError."""
    name = address_of(name)
    if is_remote(name):
        return RemoteChannel(str(name), options, port)
    return LocalChannel(name, options, port)


_channels: dict[Hashable, Channel] = {}
_channels_lock = threading.Lock()


def _join(
    name: Hashable, options: ChannelOptions, port: PortOptions
) -> tuple[Channel, ChannelPort]:
    """Join a channel of this process, or make it. Raises ChannelOptionError if options differ."""
    with _channels_lock:
        channel = _channels.get(name)
        if channel is None:
            channel = _channels[name] = Channel(name, options)
        else:
            agree(name, channel.options, options)
        return channel, channel.open(port)


def _leave(channel: Channel, port: ChannelPort) -> None:
    """Leave a channel; the last one ends it."""
    with _channels_lock:
        channel.close(port)
        if not channel.ports and _channels.get(channel.name) is channel:
            del _channels[channel.name]


def channel_names() -> list[Hashable]:
    """The channels of this process that are open."""
    with _channels_lock:
        return list(_channels)
