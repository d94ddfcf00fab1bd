"""The protocol of a program and the process that has a simulated bus: calls and answers.

A call is a list ``[method, argument, ...]``, an answer ``["ok", value]`` or ``["error", class,
text]``; each is msgpack with its length in front (4 bytes, big endian), over TCP or a Unix socket.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Hashable
from typing import Any, NamedTuple, final

import can
import msgpack  # type: ignore[import-untyped]

from bridge.simulated_can.options import ChannelOptionError

SERVED_BUS = "COSIM_BUS"
"""The environment variable of programs that `cosim bus` starts: NAME@ADDRESS of their bus."""
_MOST = 1 << 24
"""Bytes of a call; more is no call."""


class BusAddress(NamedTuple):
    """The address of a simulated bus: the channel's name, and a host with a port or a path."""

    channel: str
    host: str
    port: int
    path: str

    @property
    def place(self) -> str:
        """The address as it is written behind the ``@``."""
        return self.path or f"{self.host}:{self.port}"


def parse_address(text: str) -> BusAddress:
    """``NAME@HOST:PORT`` or ``NAME@/path/of/a/socket``. Raises ChannelOptionError."""
    name, _, place = text.rpartition("@")
    if name and "/" in place:
        return BusAddress(name, "", 0, place)
    host, colon, port = place.rpartition(":")
    if not (name and host and colon and port.isdigit() and int(port) < 65536):
        raise ChannelOptionError(
            f"channel {text!r}: found no address, expected NAME@HOST:PORT or NAME@/path/of/a/socket"
        )
    return BusAddress(name, host.strip("[]"), int(port), "")


def address_of(channel: Hashable) -> Hashable:
    """NAME@ADDRESS for the name of the bus that has started this program, else `channel`."""
    served = os.environ.get(SERVED_BUS, "")
    return served if channel == served.rpartition("@")[0] else channel


def is_remote(channel: Hashable) -> bool:
    """True if a channel is served by another process."""
    return isinstance(channel, str) and "@" in channel


def connect(address: BusAddress) -> socket.socket:
    """A connection to the process that has the bus. Raises ChannelOptionError."""
    try:
        if not address.path:
            found = socket.create_connection((address.host, address.port), timeout=10)
            found.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        else:
            found = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            found.connect(address.path)
    except OSError as error:
        raise ChannelOptionError(
            f"channel {address.channel!r}: no server answers at {address.place} ({error}); "
            "expected a simulated bus there, which `cosim bus` serves"
        ) from error
    found.settimeout(None)
    return found


@final
class CallSocket:
    """A connected socket that sends and receives whole values."""

    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection
        self._got = bytearray()

    def __del__(self) -> None:
        """A thread's connection ends with the thread."""
        self._socket.close()

    def send(self, value: object) -> None:
        """Send a value. Raises OSError when the connection is gone."""
        content = msgpack.packb(value)
        self._socket.sendall(len(content).to_bytes(4, "big") + content)

    def receive(self) -> Any:
        """The next value; None at the end of the connection, or where there is no such value."""
        if not self._gather(4):
            return None
        end = 4 + int.from_bytes(self._got[:4], "big")
        if end > _MOST or not self._gather(end):
            return None
        try:
            value = msgpack.unpackb(self._got[4:end])
        except (ValueError, RecursionError, msgpack.UnpackException):
            return None
        del self._got[:end]
        return value

    def receive_call(self) -> list[Any] | None:
        """The next call; None at the end of the connection, or where there is no call."""
        value = self.receive()
        if isinstance(value, list) and value and isinstance(value[0], str):
            return value
        return None

    def close(self) -> None:
        """End the connection; a thread that waits for a value gets None."""
        with contextlib.suppress(OSError):  # the other side was first
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def _gather(self, size: int) -> bool:
        """Receive until `size` bytes are there; False at the end of the connection."""
        while len(self._got) < size:
            try:
                part = self._socket.recv(65536)
            except OSError:
                return False
            if not part:
                return False
            self._got += part
        return True


def pack_message(message: can.Message) -> list[Any]:
    """A message as msgpack can carry it."""
    flags = (
        bool(message.is_extended_id)
        | bool(message.is_remote_frame) << 1
        | bool(message.is_error_frame) << 2
        | bool(message.is_fd) << 3
        | bool(message.bitrate_switch) << 4
        | bool(message.error_state_indicator) << 5
        | bool(message.is_rx) << 6
    )
    data = bytes(message.data or b"")
    return [message.arbitration_id, int(flags), message.dlc, data, message.timestamp]


def unpack_message(packed: list[Any], channel: str) -> can.Message:
    """The message of :func:`pack_message`, as received on `channel`."""
    identifier, flags, dlc, data, timestamp = packed
    remote = bool(flags & 2)
    return can.Message(
        timestamp=timestamp,
        arbitration_id=identifier,
        is_extended_id=bool(flags & 1),
        is_remote_frame=remote,
        is_error_frame=bool(flags & 4),
        is_fd=bool(flags & 8),
        bitrate_switch=bool(flags & 16),
        error_state_indicator=bool(flags & 32),
        is_rx=bool(flags & 64),
        dlc=dlc,
        data=None if remote else data,
        channel=channel,
    )
