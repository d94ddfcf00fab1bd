"""A simulated bus for programs of any language that speak socketcand's raw mode.

The protocol is that of linux-can/socketcand, ASCII over TCP: the server says ``< hi >``;
``< open NAME >`` and ``< rawmode >`` are answered with ``< ok >``. Then ``< send 123 2 1 f1 >``
sends (hexadecimal; identifiers of eight digits have 29 bits), and ``< frame 123 23.424242 1A22 >``
is received, times in s. An error frame is ``< error ID TIME >``. There is neither CAN FD nor
remote frames in this protocol: such frames are not passed on.
"""

from __future__ import annotations

import re
import socket
import threading
from typing import final

import can

from bridge.bus_server.listener import Acceptor
from bridge.bus_server.server import in_thread_of_its_own
from bridge.simulated_can.channel import Channel, ChannelPort
from bridge.simulated_can.options import ChannelOperationError, PortOptions

_COMMAND = re.compile(rb"<([^<>]*)>")
_LONGEST = 4096
"""Bytes without the end of a command; more is no command."""


@final
class SocketcandServer:
    """Serves `channel` at `listener`."""

    def __init__(self, channel: Channel, listener: socket.socket) -> None:
        self._channel = channel
        self._acceptor = Acceptor(listener, lambda c: _Client(channel, c).run())

    @property
    def port(self) -> int:
        """The TCP port."""
        return self._acceptor.port

    def close(self) -> None:
        """End all connections; their nodes leave the bus."""
        self._acceptor.close()


@final
class _Client:
    """One connection."""

    def __init__(self, channel: Channel, connection: socket.socket) -> None:
        self._channel, self._socket = channel, connection
        self._name = ""
        self._port: ChannelPort | None = None
        self._lock = threading.Lock()

    def run(self) -> None:
        """Obey until the end of the connection."""
        left = b""
        try:
            self._say("hi")
            while len(left) < _LONGEST:
                part = self._socket.recv(4096)
                if not part:
                    return
                left += part
                end = 0
                for found in _COMMAND.finditer(left):
                    end = found.end()
                    self._obey(found[1].decode("ascii", "replace").split())
                left = left[end:]
        except OSError:
            return  # the client is gone
        finally:
            port = self._port
            if port is not None:
                in_thread_of_its_own(lambda: self._channel.close(port))

    def _say(self, text: str) -> None:
        with self._lock:
            self._socket.sendall(f"< {text} >".encode("ascii", "replace"))

    def _obey(self, words: list[str]) -> None:
        command, *arguments = words or [""]
        if command == "open" and arguments:
            if arguments[0] != self._channel.name:
                self._say(f"error could not open bus {arguments[0]}")
                return
            self._name = arguments[0]
            self._say("ok")
        elif command == "echo":
            self._say("echo")
        elif command == "rawmode" and self._name and self._port is None:
            self._enter()
        elif command == "send" and self._port is not None:
            self._send(self._port, arguments)
        else:
            expected = "send, echo" if self._port else "rawmode" if self._name else "open"
            self._say(f"error found '{' '.join(words)[:40]}', expected {expected}")

    def _enter(self) -> None:
        options = PortOptions(rx_queue_size=10_000)
        self._port = port = in_thread_of_its_own(lambda: self._channel.open(options))
        self._say("ok")
        threading.Thread(target=self._forward, args=(port,), daemon=True).start()

    def _send(self, port: ChannelPort, words: list[str]) -> None:
        try:
            name, length, *data = words
            content = bytes(int(word, 16) for word in data)
            if int(length, 16) != len(content):
                raise ValueError(f"{len(content)} bytes for a length of {length}")
            message = can.Message(
                arbitration_id=int(name, 16), is_extended_id=len(name) > 3, data=content, check=True
            )
            self._channel.send(port, message, None)
        except (ChannelOperationError, ValueError) as error:
            self._say(f"error {error}".replace("<", "(").replace(">", ")"))

    def _forward(self, port: ChannelPort) -> None:
        """Pass on what the bus brings, until the port is closed."""
        while True:
            try:
                message = self._channel.receive(port, _carried, None)
                if message is not None:
                    self._say(_text(message))
            except (ChannelOperationError, OSError):
                return  # the client is gone


def _carried(message: can.Message) -> bool:
    return not message.is_fd and not message.is_remote_frame


def _text(message: can.Message) -> str:
    if message.is_error_frame:
        return f"error {message.arbitration_id:03X} {message.timestamp:.6f}"
    width = 8 if message.is_extended_id else 3
    data = bytes(message.data).hex().upper()
    return f"frame {message.arbitration_id:0{width}X} {message.timestamp:.6f} {data}"
