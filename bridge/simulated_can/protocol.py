"""The protocol of a program and the process that has a simulated bus: calls and answers.

A call is a list ``[method, argument, ...]``, an answer ``["ok", value]`` or ``["error", class,
text]``; each is msgpack with its length in front (4 bytes, big endian), over TCP or a Unix socket.
"""

from __future__ import annotations

import contextlib
import os
import socket
import struct
from collections.abc import Hashable
from typing import Any, NamedTuple, final

import can
import msgpack  # type: ignore[import-untyped]

from bridge.simulated_can.frames import (
    BRS,
    ERROR,
    ESI,
    EXTENDED,
    FD,
    REMOTE,
    RX,
    MessageForm,
    flags_of,
    frame_to_send,
    received_flags,
)
from bridge.simulated_can.options import ChannelOptionError
from cosim.bus.frames import BusFrame
from cosim.bus.timing import BusTiming

SERVED_BUS = "COSIM_BUS"
"""The environment variable of programs that `cosim bus` starts: NAME@ADDRESS of their bus."""
_MOST = 1 << 24
"""Bytes of a call; more is no call."""
_READ = 4096
"""Bytes that are read at once, at least."""
_LENGTH = struct.Struct(">I")


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
        self._packed = msgpack.Packer().pack
        self._got = b""

    def __del__(self) -> None:
        """A thread's connection ends with the thread."""
        self._socket.close()

    def send(self, value: object) -> None:
        """Send a value. Raises OSError when the connection is gone."""
        content = self._packed(value)
        self._socket.sendall(_LENGTH.pack(len(content)) + content)

    def receive(self) -> Any:
        """The next value; None at the end of the connection, or where there is no such value."""
        if len(self._got) < 4 and not self._gather(4):
            return None
        end = 4 + _LENGTH.unpack_from(self._got)[0]
        if len(self._got) < end and not (end <= _MOST and self._gather(end)):
            return None
        content, self._got = self._got[4:end], self._got[end:]
        try:
            return msgpack.unpackb(content)
        except (ValueError, RecursionError, msgpack.UnpackException):
            return None

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
                part = self._socket.recv(max(_READ, size))
            except OSError:
                return False
            if not part:
                return False
            self._got += part
        return True


def pack_message(message: can.Message) -> list[Any]:
    """A message as msgpack can carry it."""
    data = bytes(message.data or b"")
    return [message.arbitration_id, flags_of(message), message.dlc, data, message.timestamp]


def pack_frame(frame: BusFrame, own: bool, stamp: float, _: Hashable) -> list[Any]:
    """The same for a frame that a bus has received at `stamp` (s); `own`: it is the sender."""
    flags = received_flags(frame.flags, own)
    return [frame.identifier, flags, frame.length, frame.data, stamp]


PACKED = MessageForm(pack_frame, pack_message)
"""Messages as msgpack can carry them."""


def unpack_frame(packed: list[Any], channel: Hashable, timing: BusTiming) -> BusFrame:
    """The frame to send of :func:`pack_message`. Raises ChannelOperationError, ValueError,
    TypeError.
    """
    identifier, flags, dlc, data, _ = packed
    if not isinstance(data, bytes):
        raise TypeError(f"found data of {type(data).__name__}, expected bytes")
    return frame_to_send((identifier, flags, dlc, data), channel, timing)


def unpack_message(packed: list[Any], channel: str) -> can.Message:
    """The message of :func:`pack_message`, as received on `channel`."""
    identifier, flags, dlc, data, timestamp = packed
    remote = flags & REMOTE > 0
    return can.Message(
        timestamp,
        identifier,
        flags & EXTENDED > 0,
        remote,
        flags & ERROR > 0,
        channel,
        dlc,
        None if remote else data,
        flags & FD > 0,
        flags & RX > 0,
        flags & BRS > 0,
        flags & ESI > 0,
    )
