"""The calls of clients that a server has not answered yet."""

from __future__ import annotations

import select
import socket
import threading
from collections.abc import Container, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import final


@final
class Attention:
    """Tells whether a server has something to do for its clients, also before it has read it.

    A thread that serves a connection waits in `call` until something can be read, and counts as
    busy from before it reads until it has answered. `answered`: the number of calls so far.
    """

    def __init__(self) -> None:
        self.answered = 0
        self._lock = threading.Lock()
        self._connections: dict[socket.socket, int] = {}
        """All connections; the thread that reads or answers, or 0."""

    def watch(self, connection: socket.socket) -> None:
        """A connection from which calls will come, or a listener."""
        with self._lock:
            self._connections.setdefault(connection, 0)

    def forget(self, connection: socket.socket) -> None:
        """A connection from which nothing more comes."""
        with self._lock:
            self._connections.pop(connection, None)

    @contextmanager
    def call(self, connection: socket.socket) -> Iterator[None]:
        """Wait for something to read; the thread is busy for the duration of the context."""
        self.watch(connection)
        waiting = select.poll()
        if connection.fileno() >= 0:  # else reading fails at once
            waiting.register(connection, select.POLLIN)
            waiting.poll()
        with self._lock:
            self._connections[connection] = threading.get_ident()
        try:
            yield
        finally:
            with self._lock:
                self.answered += 1
                if connection in self._connections:
                    self._connections[connection] = 0

    def is_due(self, waiting: Container[int]) -> bool:
        """True if a call waits to be read or answered; not that of a thread among `waiting`."""
        with self._lock:
            held = dict(self._connections)
        idle = select.poll()
        for connection, thread in held.items():
            if not thread and connection.fileno() >= 0:
                idle.register(connection, select.POLLIN)
        if idle.poll(0):
            return True
        with self._lock:
            return any(thread and thread not in waiting for thread in self._connections.values())


def attended(
    attention: Attention | None, connection: socket.socket
) -> AbstractContextManager[object]:
    """The context of a call, for a server whose time is that of programs; else of nothing."""
    return nullcontext() if attention is None else attention.call(connection)
