"""A simulated bus for other processes: their bus objects are nodes of a channel of this process.

A client has one connection that opens its bus, and lasts as long as that, and one for each of its
threads. Each is served by a thread here, which takes part in the time of the channel as if it were
the client's: in simulated time the channel waits for the clients as for threads of one process.
"""

from __future__ import annotations

import itertools
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, final

import can

from bridge.bus_server.attention import Attention, attended
from bridge.bus_server.listener import Acceptor
from bridge.simulated_can.channel import Channel, ChannelPort
from bridge.simulated_can.frames import ERROR, EXTENDED, frame_of_message
from bridge.simulated_can.options import (
    ChannelOperationError,
    ChannelOptionError,
    ChannelOptions,
    PortOptions,
    agree,
    channel_options,
)
from bridge.simulated_can.pace import act_as
from bridge.simulated_can.periodic import PeriodicTask
from bridge.simulated_can.protocol import PACKED, CallSocket, unpack_frame, unpack_message
from cosim.base.convert import convert
from cosim.base.errors import CosimError
from cosim.bus.settings import Disturbance, ErrorRate, Interruption, QueueKind, ScriptedError

#: Exceptions of a call with senseless arguments; its client is told.
_REFUSED = (
    CosimError, can.CanError, ValueError, TypeError, LookupError, ArithmeticError, AttributeError,
)  # fmt: skip
_DISTURBANCES: dict[str, Any] = {
    kind.__name__: kind for kind in (ErrorRate, Interruption, ScriptedError)
}


@final
class BusServer:
    """Serves `channel` at `listener` to the interface ``cosim`` of other processes.

    Servers whose channels share their time share their `threads`, too: then a thread of a client
    that uses several of the channels is one participant. `attention` knows the calls that are not
    answered yet.
    """

    def __init__(
        self,
        channel: Channel,
        listener: socket.socket,
        threads: RemoteThreads | None = None,
        attention: Attention | None = None,
    ) -> None:
        self._channel = channel
        self._attention = attention
        self._ports: dict[int, RemotePort] = {}
        self._tokens = itertools.count(1)
        self._threads = threads or RemoteThreads()
        self._acceptor = Acceptor(listener, self._serve, self._attention)

    @property
    def port(self) -> int:
        """The TCP port."""
        return self._acceptor.port

    def close(self) -> None:
        """End all connections; their nodes leave the bus."""
        self._acceptor.close()

    def _serve(self, connection: socket.socket) -> None:
        calls = CallSocket(connection)
        with attended(self._attention, connection):
            found = self._begin(calls)
        if found is None:
            return
        token, port, thread = found
        try:
            if token:
                with attended(self._attention, connection):
                    calls.receive()  # until the client closes it
                    self._leave(token, port)
            else:
                with self._threads.of(thread):
                    self._answer_all(connection, calls, port)
        finally:
            if token in self._ports:
                self._leave(token, port)

    def _begin(self, calls: CallSocket) -> tuple[int, RemotePort, str] | None:
        """Answer the first call of a connection: the bus that it opens (or 0), its port, and the
        thread of the client; None: it was refused.
        """
        first = calls.receive_call()
        if first is None:
            return None
        token = 0
        try:
            if first[0] == "open":
                token = in_thread_of_its_own(lambda: self._open(*first[1:]))
            elif first[0] != "join" or len(first) != 3:
                raise ChannelOperationError(f"found {first[0][:40]!r}, expected open or join")
            port = self._ports.get(token or first[1])
            if port is None:
                raise ChannelOperationError("found a bus that is not open")
        except _REFUSED as error:
            with suppress(OSError):  # the client is gone
                calls.send(_refusal(error))
            return None
        timing = self._channel.timing
        opened = [token, timing.bitrate, timing.data_bitrate, timing.fd]
        calls.send(["ok", opened if token else None])
        return token, port, "" if token else str(first[2])

    def _leave(self, token: int, port: RemotePort) -> None:
        """Let the node of a bus leave that a client has closed."""
        del self._ports[token]
        in_thread_of_its_own(port.close)

    def _answer_all(self, connection: socket.socket, calls: CallSocket, port: RemotePort) -> None:
        """Answer the calls of a connection until its end."""
        there = True
        while there:
            if self._attention is None:
                there = _answer(calls, port)
            else:
                with self._attention.call(connection):
                    there = _answer(calls, port)

    def _open(self, name: str, options: dict[str, Any], port: dict[str, Any]) -> int:
        if name != self._channel.name:
            raise ChannelOptionError(
                f"channel {name!r}: found a server of the channel {self._channel.name!r} only"
            )
        speed = options.get("speed")
        checked = channel_options(name, **{**options, "speed": speed or None})
        given = ChannelOptions(
            timing=checked.timing, fd=checked.fd, data_bitrate=checked.data_bitrate, speed=speed,
            error_rate=checked.error_rate, seed=checked.seed,
        )  # fmt: skip
        agree(name, self._channel.options, given)
        asked = PortOptions(**{**port, "queue": QueueKind(port["queue"])})
        token = next(self._tokens)
        self._ports[token] = RemotePort(self._channel, self._channel.open(asked, PACKED))
        return token


@final
class RemoteThread:
    """A thread of a client: one participant, on however many buses it has connections."""

    def __init__(self) -> None:
        self._connections = 0
        self._lock = threading.Lock()

    def is_alive(self) -> bool:
        """True if it has a connection."""
        return self._connections > 0

    def __enter__(self) -> None:
        with self._lock:
            self._connections += 1
        act_as(self)

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._connections -= 1


@final
class RemoteThreads:
    """The threads of all clients, by their names."""

    def __init__(self) -> None:
        self._known: dict[str, RemoteThread] = {}
        self._lock = threading.Lock()

    def of(self, name: str) -> RemoteThread:
        """The thread of this name; it is made when it is new."""
        with self._lock:
            return self._known.setdefault(name, RemoteThread())


def _answer(calls: CallSocket, port: RemotePort) -> bool:
    """Answer the next call; False if there is none, or the client is gone."""
    call = calls.receive_call()
    if call is None:
        return False
    try:
        answer = ["ok", port.call(*call)]
    except _REFUSED as error:
        answer = _refusal(error)
    try:
        calls.send(answer)
    except OSError:
        return False
    return True


def _refusal(error: Exception) -> list[str]:
    return ["error", type(error).__name__, str(error)]


def in_thread_of_its_own(action: Callable[[], Any]) -> Any:
    """Do it in a thread that then ends, so that simulated time does not wait for this one."""
    found: list[Any] = []
    failed: list[Exception] = []

    def run() -> None:
        try:
            found.append(action())
        except Exception as error:
            failed.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    if failed:
        raise failed[0]
    return found[0]


@final
class RemotePort:
    """The bus object of a client, here."""

    def __init__(self, channel: Channel, port: ChannelPort) -> None:
        self._channel, self._port = channel, port
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

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Queue a message of a periodic task, waiting up to `timeout` (s) for room."""
        self._channel.send(self._port, msg, timeout)

    def close(self) -> None:
        """Leave the bus."""
        for task in self._tasks:
            task.stop()
        self._channel.close(self._port)

    def _send(self, packed: list[Any], timeout: float | None) -> None:
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
