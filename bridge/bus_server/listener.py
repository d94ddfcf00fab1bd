"""Sockets that accept connections, TCP or Unix, and serve each in a thread."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import final

from bridge.bus_server.attention import Attention, attended
from bridge.simulated_can.protocol import BusAddress
from cosim.base.errors import CosimError


class ServerError(CosimError, OSError):
    """An address at which no bus can be served."""


def listen(address: BusAddress) -> socket.socket:
    """A socket that accepts connections. Raises ServerError, for example for a port in use."""
    try:
        if not address.path:
            family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
            return socket.create_server((address.host, address.port), family=family)
        _remove_stale(address.path)
        found = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        found.bind(address.path)
        found.listen()
        return found
    except OSError as error:
        raise ServerError(
            f"{address.place}: {error.strerror or error}; expected an address that is free"
        ) from error


def _remove_stale(path: str) -> None:
    """Remove the socket of a server that is gone; one that answers stays."""
    if not Path(path).is_socket():
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(path)
        except ConnectionRefusedError:
            os.unlink(path)


@final
class Acceptor:
    """Serves the connections of a listening socket, a thread each, until it is closed.

    `attention` is told of all connections; `serve` reads from them within its calls.
    """

    def __init__(
        self,
        listener: socket.socket,
        serve: Callable[[socket.socket], None],
        attention: Attention | None = None,
    ) -> None:
        self._listener, self._serve = listener, serve
        self._attention = attention
        self._open: set[socket.socket] = set()
        self._thread = threading.Thread(target=self._accept, daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """The TCP port."""
        return int(self._listener.getsockname()[1])

    def close(self) -> None:
        """Accept no more, and end all connections."""
        path = self._listener.getsockname() if self._listener.family == socket.AF_UNIX else ""
        for each in (self._listener, *tuple(self._open)):
            with contextlib.suppress(OSError):  # one that the client has closed
                each.shutdown(socket.SHUT_RDWR)
            each.close()
        if path:
            Path(path).unlink(missing_ok=True)

    def _accept(self) -> None:
        while True:
            try:
                with attended(self._attention, self._listener):
                    connection, _ = self._listener.accept()
                    if self._attention is not None:
                        self._attention.watch(connection)
            except OSError:
                self._forget(self._listener)
                return  # closed
            if connection.family != socket.AF_UNIX:
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._open.add(connection)
            threading.Thread(target=self._run, args=(connection,), daemon=True).start()

    def _run(self, connection: socket.socket) -> None:
        try:
            self._serve(connection)
        finally:
            self._forget(connection)
            self._open.discard(connection)
            connection.close()

    def _forget(self, connection: socket.socket) -> None:
        if self._attention is not None:
            self._attention.forget(connection)
