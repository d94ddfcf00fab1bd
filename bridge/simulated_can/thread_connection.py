"""The connections of this process to servers of buses: one a bus, and one a thread and server."""

from __future__ import annotations

import os
import socket
import sys
import threading
from contextlib import suppress
from itertools import count
from threading import get_ident
from typing import Any, NamedTuple, final
from weakref import WeakSet

from bridge.simulated_can.protocol import BusAddress, CallSocket, connect


@final
class BusConnection:
    """The connection that keeps a bus open; simulated time does not wait for it."""

    def __init__(self, calls: CallSocket) -> None:
        self._calls, self._lock = calls, threading.Lock()

    def settle(self, messages: int) -> None:
        """Wait until the server has taken so many messages to the bus, or is gone."""
        with self._lock, suppress(OSError):
            self._calls.send(["settle", messages])
            self._calls.receive()

    def leave(self, messages: int) -> None:
        """Leave the bus behind so many messages."""
        with self._lock:
            with suppress(OSError):  # the server was first
                self._calls.send(["leave", messages])
            self._calls.close()


class Posts(NamedTuple):
    """The messages to a bus that its server may not have taken yet."""

    number: int
    """That of the last one."""
    carrier: int
    """The number of the connection that carried it."""
    bus: BusConnection


@final
class ThreadConnection:
    """The connection of one thread to one server, for all buses there that the thread uses.

    A server takes the calls of a connection in their order, also those that it does not answer.
    What the threads of this process have posted on other connections is taken before a call is
    sent, so calls of threads that wait for each other keep their order, too.
    """

    def __init__(self, server: str, calls: CallSocket) -> None:
        self.server, self.calls = server, calls
        self.buses: set[int] = set()
        self.known = False
        """The server has answered a call: the time of its buses waits for this thread."""
        self._number = next(_numbers)

    def ask(self, method: str, bus: int, after: int, *arguments: object) -> Any:
        """The answer to a call behind so many messages of its bus; None if the server is gone."""
        if _posted:
            self._settle_others(bus)
        self.known = True
        try:
            self.calls.send((method, bus, after, *arguments))
            answer = self.calls.receive()
        except OSError:
            return None
        if _posted:
            self._forget((self.server, bus), after)
        return answer

    def post(self, bus: int, after: int, packed: list[Any], opened: BusConnection) -> None:
        """Send a message without an answer. Raises OSError if the server is gone."""
        if _posted:
            self._settle_others(bus)
        self.calls.send(("post", bus, after, packed))
        _posted[self.server, bus] = Posts(after + 1, self._number, opened)

    def _settle_others(self, bus: int) -> None:
        """Wait until servers have taken what other connections carried to other buses.

        The calls of one bus are numbered, which is enough.
        """
        own = (self.server, bus)
        for place, posts in tuple(_posted.items()):
            if posts.carrier != self._number and place != own:
                settle(*place)

    def _forget(self, called: tuple[str, int], after: int) -> None:
        """A server has taken so many messages to a bus, and all that this connection carried."""
        with _lock:
            for place, posts in tuple(_posted.items()):
                if posts.carrier == self._number or (place == called and posts.number <= after):
                    del _posted[place]


def settle(server: str, bus: int) -> None:
    """Wait until a server has taken what was posted to a bus."""
    posts = _posted.get((server, bus))
    if posts is None:
        return
    posts.bus.settle(posts.number)
    with _lock:
        if _posted.get((server, bus)) is posts:
            del _posted[server, bus]


class _Here(threading.local):
    """The connections of this thread, by the name of the server."""

    def __init__(self) -> None:
        self.open: dict[str, ThreadConnection] = {}


def connection_to(address: BusAddress, server: str, bus: int) -> ThreadConnection:
    """The connection of this thread for a bus of a server. Raises ChannelOptionError."""
    found = _here.open.get(server)
    if found is not None and bus in found.buses:
        return found
    with _lock:
        if found is not None and found.buses:
            found.buses.add(bus)
            return found
    calls = CallSocket(connect(address))
    with suppress(OSError):  # the call that follows finds it, too
        calls.send(["join", f"{_process} {get_ident()}"])
        calls.receive()
    found = _here.open[server] = ThreadConnection(server, calls)
    with _lock:
        found.buses.add(bus)
        _connections.add(found)  # until its thread ends
    return found


def end_connections(server: str, bus: int) -> None:
    """End the connections that no other bus of this process uses."""
    with _lock:
        for connection in tuple(_connections):
            if connection.server == server and bus in connection.buses:
                connection.buses.discard(bus)
                if not connection.buses:
                    connection.calls.close()


def _renew() -> None:
    """Forget connections; those of a parent process are not for its child."""
    global _lock, _here, _process, _connections, _posted
    _lock, _here, _connections, _posted = threading.Lock(), _Here(), WeakSet(), {}
    _process = f"{socket.gethostname()} {os.getpid()} {id(object())}"


_lock: threading.Lock
_here: _Here
_connections: WeakSet[ThreadConnection]
_posted: dict[tuple[str, int], Posts]
"""By server and bus."""
_process: str
_numbers = count()
_renew()
if sys.platform != "win32":
    os.register_at_fork(after_in_child=_renew)
