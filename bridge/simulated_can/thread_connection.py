"""The connections of this process to servers of buses: one for each thread and server."""

from __future__ import annotations

import os
import socket
import sys
import threading
from contextlib import suppress
from threading import get_ident
from typing import Any, final
from weakref import WeakSet

from bridge.simulated_can.protocol import BusAddress, CallSocket, connect


@final
class ThreadConnection:
    """The connection of one thread to one server, for all buses there that the thread uses.

    So the server takes the calls of a thread in their order, also those that it does not answer.
    """

    def __init__(self, server: str, calls: CallSocket) -> None:
        self.server, self.calls = server, calls
        self.buses: set[int] = set()
        self._bus = 0

    def ask(self, *call: object) -> Any:
        """The answer to a call; None if the server is gone."""
        refused = _here.settle(self) if _here.posted is not None else None
        if refused:
            return refused
        try:
            self.calls.send(call)
            return self.calls.receive()
        except OSError:
            return None

    def post(self, bus: int, after: int, packed: list[Any]) -> Any:
        """Send a message without an answer; returns the error of an earlier one at another server.

        Raises OSError if the server is gone.
        """
        if _here.posted is not self:
            refused = _here.settle(self)
            if refused:
                return refused
            _here.posted = self
        self._bus = bus
        self.calls.send(["post", bus, after, packed])
        return None

    def settle(self) -> Any:
        """Wait until the server has taken the messages that were posted."""
        return self.ask("settle", self._bus, 0)


class _Here(threading.local):
    """The connections of this thread, by the name of the server."""

    def __init__(self) -> None:
        self.open: dict[str, ThreadConnection] = {}
        self.posted: ThreadConnection | None = None
        """The one with messages that the server may not have taken yet."""

    def settle(self, calling: ThreadConnection) -> Any:
        """Wait until the server has taken them if the next call goes to another.

        Returns the error of one of them, or None.
        """
        posted, self.posted = self.posted, None
        if posted is None or posted is calling:
            return None
        found = posted.settle()
        return found if found is not None and found[0] == "error" else None


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
    global _lock, _here, _process, _connections
    _lock, _here, _connections = threading.Lock(), _Here(), WeakSet()
    _process = f"{socket.gethostname()} {os.getpid()} {id(object())}"


_lock: threading.Lock
_here: _Here
_connections: WeakSet[ThreadConnection]
_process: str
_renew()
if sys.platform != "win32":
    os.register_at_fork(after_in_child=_renew)
