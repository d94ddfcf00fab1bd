"""Raw sockets of AF_CAN that programs in bus time have opened (``bridge/c/preload/can.c``).

Each is a connection that carries packets, and a node of the bus once the program has bound it.
Files of ``timerfd_create`` are such connections, too.
"""

from __future__ import annotations

import contextlib
import socket
import struct
from collections import deque
from pathlib import Path
from typing import final

import can
from can.interfaces.socketcan.socketcan import build_can_frame, dissect_can_frame

from bridge.simulated_can.channel import Channel, ChannelPort
from bridge.simulated_can.options import ChannelOperationError, PortOptions

#: Options of SOL_CAN_RAW (linux/can/raw.h).
_FILTER, _ERROR_FILTER, _OWN_MESSAGES, _FD_FRAMES, _JOIN_FILTERS = 1, 2, 4, 5, 6
_EXTENDED, _REMOTE, _ERROR = 0x8000_0000, 0x4000_0000, 0x2000_0000
_BRS, _ESI = 1, 2
_FD_BYTES = 72
_MOST_QUEUED = 1000
_NEVER = 2**63 - 1
#: Frames that wait in the queue of a node, as the `txqueuelen` of an interface.
_SENDING = PortOptions(tx_queue_size=10, receive_own_messages=True)


@final
class CanSocket:
    """One socket: its options, its node, and what it has received and not read yet.

    `due_ns`: the time at which it expires as a timer, ns of the bus; None: it does not.
    """

    def __init__(self, connection: socket.socket, channel: Channel) -> None:
        self.connection, self._channel = connection, channel
        self._port: ChannelPort | None = None
        self._waiting: deque[bytes] = deque()
        self._options: dict[int, int] = {}
        self._filters: list[tuple[int, int]] = [(0, 0)]
        self.due_ns: int | None = None
        self._period_ns = 0
        self.is_open = True
        self.lost = 0

    def serve(self) -> bool:
        """Do what the program has asked for; True if that was something."""
        found = False
        while self.is_open and (self._port is None or self._channel.has_room(self._port)):
            try:
                packet = self.connection.recv(4096)
            except BlockingIOError:
                return found
            except OSError:
                packet = b""
            found = True
            if not packet:
                self.close()
            elif packet[:1] == b"B":
                self._port = self._port or self._channel.open(_SENDING)
            elif packet[:1] == b"O":
                self._set(int.from_bytes(packet[1:5], "little"), packet[5:])
            elif packet[:1] == b"T":
                due, self._period_ns = struct.unpack("<qq", packet[1:17])
                self.due_ns = None if due == _NEVER else due
            elif self._port is not None:
                self._send(self._port, packet[1:])
        return found

    def deliver(self, now_ns: int, epoch_ns: int) -> bool:
        """Pass on what the node has received, with its date, and that a timer has expired; True if
        that was something. `now_ns`: time of the bus; `epoch_ns`: the date at time 0, ns.
        """
        if self.due_ns is not None and self.due_ns <= now_ns:
            count = 1 + ((now_ns - self.due_ns) // self._period_ns if self._period_ns else 0)
            self._waiting.append(struct.pack("<q", count))
            self.due_ns = self.due_ns + count * self._period_ns if self._period_ns else None
        if self._port is not None:
            while (message := self._channel.received(self._port, self._wants)) is not None:
                if message.is_fd and not self._options.get(_FD_FRAMES):
                    continue
                flags = 0 if message.is_rx else socket.MSG_DONTROUTE | socket.MSG_CONFIRM
                if len(self._waiting) < _MOST_QUEUED:
                    head = struct.pack("<qi", epoch_ns + now_ns, flags)
                    self._waiting.append(head + bytes(build_can_frame(message)))
                else:
                    self.lost += 1
        found = False
        while self._waiting and self.is_open:
            try:
                self.connection.send(self._waiting[0])
            except BlockingIOError:
                break
            except OSError:
                self.close()
                break
            self._waiting.popleft()
            found = True
        return found

    def close(self) -> None:
        """Leave the bus; what the node has queued is still sent."""
        if self.is_open:
            self.is_open = False
            self.connection.close()
            if self._port is not None:
                self._channel.close(self._port)

    def _set(self, name: int, value: bytes) -> None:
        if name == _FILTER:
            whole = value[: len(value) // 8 * 8]
            self._filters = [(i, m) for i, m in struct.iter_unpack("<II", whole)]
        elif len(value) >= 4:
            self._options[name] = int.from_bytes(value[:4], "little")

    def _send(self, port: ChannelPort, frame: bytes) -> None:
        identifier, length, flags, data = dissect_can_frame(frame)
        is_fd = len(frame) == _FD_BYTES
        extended = bool(identifier & _EXTENDED)
        remote = bool(identifier & _REMOTE) and not is_fd
        message = can.Message(
            arbitration_id=identifier & (0x1FFF_FFFF if extended else 0x7FF),
            is_extended_id=extended,
            is_remote_frame=remote,
            is_fd=is_fd,
            bitrate_switch=is_fd and bool(flags & _BRS),
            error_state_indicator=is_fd and bool(flags & _ESI),
            dlc=length,
            data=None if remote else data[:length],
        )
        try:
            self._channel.send(port, message, None)
        except ChannelOperationError:
            self.lost += 1  # bus-off, or no frame of this bus

    def _wants(self, message: can.Message) -> bool:
        """True if a message passes the filters, as in linux/net/can/af_can.c."""
        if not message.is_rx and not self._options.get(_OWN_MESSAGES):
            return False
        if message.is_error_frame:
            return bool(message.arbitration_id & self._options.get(_ERROR_FILTER, 0))
        name = message.arbitration_id
        name |= _EXTENDED if message.is_extended_id else 0
        name |= _REMOTE if message.is_remote_frame else 0
        passed = (
            ((name & mask) == (wanted & ~_ERROR & mask)) != bool(wanted & _ERROR)
            for wanted, mask in self._filters
        )
        joined = self._options.get(_JOIN_FILTERS) and self._filters
        return all(passed) if joined else any(passed)


@final
class CanSockets:
    """Accepts the sockets of programs at the Unix socket `path`, for `channel`."""

    def __init__(self, path: Path, channel: Channel) -> None:
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.bind(str(path))
        self._listener.listen(128)
        self._listener.setblocking(False)
        self._channel = channel
        self._sockets: list[CanSocket] = []

    def next_ns(self) -> int | None:
        """The next time at which a timer expires, ns of the bus; None: none will."""
        return min((s.due_ns for s in self._sockets if s.due_ns is not None), default=None)

    def serve(self, now_ns: int, epoch_ns: int) -> bool:
        """Do what programs have asked for, and pass on what has arrived; True if that was
        something. `now_ns`: time of the bus; `epoch_ns`: the date at time 0, ns.
        """
        found = False
        with contextlib.suppress(BlockingIOError):
            while True:
                connection, _ = self._listener.accept()
                connection.setblocking(False)
                self._sockets.append(CanSocket(connection, self._channel))
                found = True
        for each in self._sockets:
            found |= each.serve()
        for each in self._sockets:
            found |= each.deliver(now_ns, epoch_ns)
        self._sockets = [each for each in self._sockets if each.is_open]
        return found

    def close(self) -> None:
        """End all connections."""
        for each in self._sockets:
            each.close()
        self._listener.close()
