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
from contextlib import closing, suppress
from typing import Any, final
from uuid import uuid4

from bridge.bus_server.attention import Attention, attended
from bridge.bus_server.listener import Acceptor
from bridge.bus_server.remote_port import RemotePort
from bridge.bus_server.remote_thread import REFUSED, RemoteThreads, ThreadCalls, refusal
from bridge.simulated_can.channel import Channel
from bridge.simulated_can.options import (
    ChannelOperationError,
    ChannelOptionError,
    ChannelOptions,
    PortOptions,
    agree,
    channel_options,
)
from bridge.simulated_can.protocol import PACKED, CallSocket
from cosim.bus.settings import QueueKind


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
        self._name = uuid4().hex
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
        token, thread = found
        try:
            if token:
                while token in self._ports:
                    with attended(self._attention, connection):
                        self._hear(token, calls)
            else:
                self._answer_all(connection, calls, thread)
        finally:
            if token in self._ports:
                self._leave(token, None)

    def _begin(self, calls: CallSocket) -> tuple[int, str] | None:
        """Answer the first call of a connection: the bus that it opens (or 0), and the thread of
        the client; None: it was refused.
        """
        first = calls.receive_call()
        if first is None:
            return None
        token = 0
        try:
            if first[0] == "open":
                token = in_thread_of_its_own(lambda: self._open(*first[1:]))
            elif first[0] != "join" or len(first) != 2:
                raise ChannelOperationError(f"found {first[0][:40]!r}, expected open or join")
        except REFUSED as error:
            with suppress(OSError):  # the client is gone
                calls.send(refusal(error))
            return None
        timing = self._channel.timing
        opened = [self._name, token, timing.bitrate, timing.data_bitrate, timing.fd]
        with suppress(OSError):  # its end is found next
            calls.send(["ok", opened if token else None])
        return token, "" if token else str(first[1])

    def _hear(self, token: int, calls: CallSocket) -> None:
        """Take a call of the connection that opened a bus: its end, or ``["settle", messages]``.

        The latter is answered when so many messages to the bus have been taken.
        """
        call = calls.receive_call()
        if call is None or call[0] != "settle" or not isinstance(call[-1], int):
            self._leave(token, call)
            return
        self._ports[token].reach(call[-1])
        with suppress(OSError):  # its end is found next
            calls.send(["ok", None])

    def _leave(self, token: int, said: list[Any] | None) -> None:
        """Let the node of a bus leave that a client has closed; None: the client is gone."""
        sent = said[-1] if said and isinstance(said[-1], int) else None
        port = self._ports[token]
        port.reach(sent)
        del self._ports[token]
        in_thread_of_its_own(port.close)

    def _answer_all(self, connection: socket.socket, calls: CallSocket, thread: str) -> None:
        """Answer the calls of a thread until its end."""
        answers = ThreadCalls(calls, self._ports)
        there = True
        with self._threads.of(thread), closing(answers):
            while there:
                if self._attention is None:
                    there = answers.answer()
                else:
                    with self._attention.call(connection):
                        there = answers.answer()

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
        opened = self._channel.open(asked, PACKED)
        self._ports[token] = RemotePort(self._channel, opened, posts=self._attention is None)
        return token


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
