"""The protocol of a program and the process that has a simulated bus: calls and answers.

A call is a list ``[method, argument, ...]``, an answer ``["ok", value]`` or ``["error", class,
text]``; each is msgpack with its length in front (4 bytes, big endian), over TCP or a Unix socket.
"""

from __future__ import annotations

import os
import socket
import struct
import sys
from collections.abc import Hashable
from contextlib import suppress
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
BUS_TABLE = "COSIM_BUS_TABLE"
"""The environment variable of programs in bus time: the file of the threads that wait."""
_MOST = 1 << 24
"""Bytes of a call; more is no call."""
_READ = 4096
"""Bytes that are read at once."""
_LOOKS = 40
"""Times that a connection looks for an answer before it sleeps, about 1 us each."""
_LONGEST_PAUSE = 256
"""Receptions for which it does not look after it has looked in vain, at most."""
_NEVER = 1 << 62
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
        self._vain, self._pause = 1, 0 if _can_look() else _NEVER

    def __del__(self) -> None:
        """A thread's connection ends with the thread."""
        self._socket.close()

    def send(self, value: object) -> None:
        """Send a value. Raises OSError when the connection is gone."""
        content = self._packed(value)
        self._socket.sendall(_LENGTH.pack(len(content)) + content)

    def receive(self) -> Any:
        """The next value; None at the end of the connection, or where there is no such value."""
        try:
            got = self._got or self._more(b"")
            while len(got) < 4:
                got = self._more(got)
            end = 4 + _LENGTH.unpack_from(got)[0]
            while len(got) < end <= _MOST:
                got = self._more(got)
            self._got = got[end:]
            return msgpack.unpackb(got[4:end]) if end <= _MOST else None
        except (OSError, ValueError, RecursionError, msgpack.UnpackException):
            return None

    def receive_call(self) -> list[Any] | None:
        """The next call; None at the end of the connection, or where there is no call."""
        value = self.receive()
        if isinstance(value, list) and value and isinstance(value[0], str):
            return value
        return None

    def close(self) -> None:
        """End the connection; a thread that waits for a value gets None."""
        with suppress(OSError):  # the other side was first
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def _more(self, got: bytes) -> bytes:
        """The bytes so far, and the next ones. Raises OSError at the end of the connection."""
        part = self._look(_READ)
        if not part:
            raise ConnectionResetError
        return got + part if got else part

    def _look(self, most: int) -> bytes:
        """The next bytes, for which it looks before it sleeps, as another processor may send them.

        A processor that sleeps takes longer to wake than most answers take to come. Looks that were
        in vain are not repeated for a while, four times as long each time.
        """
        receive = self._socket.recv
        if self._pause:
            self._pause -= 1
            return receive(most)
        for _ in range(_LOOKS):
            try:
                found = receive(most, socket.MSG_DONTWAIT)
            except BlockingIOError:
                continue
            self._vain = max(self._vain // 2, 1)
            return found
        self._vain = self._pause = min(4 * self._vain, _LONGEST_PAUSE)
        return receive(most)


def _can_look() -> bool:
    """True if this thread may look for an answer while another processor makes it.

    Not in bus time, which stands still while a program looks.
    """
    if sys.platform != "linux" or BUS_TABLE in os.environ:
        return False
    return len(os.sched_getaffinity(0)) > 1


def pack_message(message: can.Message) -> list[Any]:
    """A message as msgpack can carry it."""
    data = bytes(message.data or b"")
    return [message.arbitration_id, flags_of(message), message.dlc, data, message.timestamp]


def is_plain(packed: list[Any]) -> bool:
    """True for a classic data frame, which each bus can carry; a quick test of most messages."""
    identifier, flags, _, data, _ = packed
    if flags & (REMOTE | ERROR | FD) or len(data) > 8:
        return False
    return 0 <= int(identifier) < (1 << 29 if flags & EXTENDED else 1 << 11)


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
