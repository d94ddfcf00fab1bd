"""The bus object of a client, in the process that has the bus."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, final

import can

from bridge.simulated_can.channel import Channel, ChannelPort
from bridge.simulated_can.frames import ERROR, EXTENDED, frame_of_message
from bridge.simulated_can.periodic import PeriodicTask
from bridge.simulated_can.protocol import unpack_frame, unpack_message
from cosim.base.convert import convert
from cosim.bus.settings import Disturbance, ErrorRate, Interruption, ScriptedError

_DISTURBANCES: dict[str, Any] = {
    kind.__name__: kind for kind in (ErrorRate, Interruption, ScriptedError)
}
_PATIENCE = 1.0
"""The longest wait of a call, in wall time, for messages that were sent before it, s."""


@final
class RemotePort:
    """The bus object of a client, here.

    `posts`: its client may post messages. Messages are numbered by it, from 1.
    """

    def __init__(self, channel: Channel, port: ChannelPort, posts: bool) -> None:
        self._channel, self._port = channel, port
        self._posts, self._taken, self._sending, self._threads = posts, 0, 0, 0
        self._waiting = 0
        self._changed = threading.Condition()
        self._filters: list[list[Any]] = []
        self._tasks: list[PeriodicTask] = []
        self._methods: dict[str, Callable[..., Any]] = {
            "time": lambda: channel.time(port),
            "status": lambda: list(channel.state(port)),
            "lost": lambda: port.lost,
            "load": channel.load,
            "sleep": channel.sleep,
            "disturb": self._disturb,
            "flush": lambda: channel.flush(port),
            "reset": lambda: channel.reset(port),
            "filter": self._filter,
            "send": self._send,
            "receive": self._receive,
            "periodic": self._periodic,
            "start": lambda n: self._tasks[n].start(),
            "stopped": lambda n: self._tasks[n].stopped,
            "stop": lambda n: self._tasks[n].stop(),
            "modify": lambda n, m: self._tasks[n].modify_data(self._carried(m)),
        }

    def call(self, method: str, *arguments: Any) -> Any:
        """The answer to a call of the client. Raises LookupError for a method there is not."""
        return self._methods[method](*arguments)

    def count(self, threads: int) -> None:
        """So many more threads of the client use it."""
        with self._changed:
            self._threads += threads
            self._changed.notify_all()

    def reach(self, messages: int | None) -> None:
        """Wait until so many messages have been taken; None: until no thread uses it."""
        if messages is not None and messages <= self._taken:
            return
        if messages is None and not self._posts:
            return
        with self._changed:
            self._waiting += 1
            self._changed.wait_for(
                lambda: not self._threads if messages is None else messages <= self._taken,
                _PATIENCE,
            )
            self._waiting -= 1

    def take(self, number: int) -> None:
        """The message of this number has come, the last before it had: later calls can go on."""
        self._taken = number
        if self._waiting:
            with self._changed:
                self._changed.notify_all()

    def post(self, number: int, packed: list[Any]) -> None:
        """Queue the message of this number, for which there was room."""
        try:
            self._queue(packed, None)
        finally:
            self.take(number)

    def room(self) -> int:
        """The number of the last message that the client may post."""
        taken = self._taken  # before it looks for room, which messages take before they count
        if not self._posts or self._sending or self._tasks:
            return 0
        return taken + self._channel.room(self._port)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Queue a message of a periodic task, waiting up to `timeout` (s) for room."""
        self._channel.send(self._port, msg, timeout)

    def close(self) -> None:
        """Leave the bus."""
        for task in self._tasks:
            task.stop()
        self._channel.close(self._port)

    def _send(self, packed: list[Any], timeout: float | None) -> None:
        """Queue a message, for which others do not take the room meanwhile."""
        with self._changed:
            self._sending += 1
        try:
            self._queue(packed, timeout)
        finally:
            with self._changed:
                self._sending -= 1

    def _queue(self, packed: list[Any], timeout: float | None) -> None:
        channel = self._channel
        channel.send_frame(self._port, unpack_frame(packed, channel.name, channel.timing), timeout)

    def _receive(self, timeout: float | None, most: int) -> list[Any]:
        wanted = self._wanted if self._filters else None
        return self._channel.receive_several(self._port, wanted, timeout, most)

    def _filter(self, filters: list[list[Any]]) -> None:
        self._filters = [
            [int(identifier), int(mask), None if extended is None else bool(extended)]
            for identifier, mask, extended in filters
        ]

    def _wanted(self, packed: list[Any]) -> bool:
        found, flags = packed[:2]
        return flags & ERROR > 0 or any(
            (identifier ^ found) & mask == 0 and extended in (None, flags & EXTENDED > 0)
            for identifier, mask, extended in self._filters
        )

    def _disturb(self, kind: str, fields: dict[str, Any]) -> None:
        found: Disturbance = convert(fields, _DISTURBANCES[kind], Path(kind))
        self._channel.disturb(found)

    def _carried(self, messages: list[Any]) -> list[can.Message]:
        """Messages that this bus can carry. Raises ChannelOperationError, ValueError, TypeError."""
        found = [unpack_message(m, "") for m in messages]
        for message in found:
            frame_of_message(message, self._channel.name, self._channel.timing)
        return found

    def _periodic(self, messages: list[Any], period: float, duration: float | None) -> int:
        sent = self._carried(messages)
        self._tasks.append(PeriodicTask(self, self._channel, sent, period, duration))
        return len(self._tasks) - 1
