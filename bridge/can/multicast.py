"""python-can's ``udp_multicast``, kept on this machine.

As python-can opens it, packets leave by whatever interface the routes name, the group is announced
there, and a sender receives its own frames. Here (`local`, the default) group, packets and
announcements stay on the loopback interface: the group is joined on it and sent to by it, with TTL
0, and packets of other interfaces are not taken (IP_MULTICAST_ALL = 0). Own frames are known by
the port they come from, and what the kernel had to drop is counted. Packets are python-can's: its
own bus, on this machine, sees them.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import sys
from typing import Any, final

import can
from can.interfaces.udp_multicast.utils import pack_message, unpack_message

from bridge.can.socket import RECEIVE_BUFFER, BusError
from cosim.base import clock

GROUP, PORT = "239.74.163.2", 43113
"""Where python-can's own bus is with IPv4."""
LARGEST = 4096
#: How long a packet to oneself may take, s: on loopback it takes microseconds.
PATIENCE = 1.0
_ALL, _RCVBUFFORCE, _RXQ_OVFL = 49, 33, 40


def open_group(
    channel: str | None = None,
    port: int = PORT,
    *,
    local: bool = True,
    fd: bool = True,
    hop_limit: int | None = None,
    **options: Any,
) -> MulticastBus:
    """A bus on an IPv4 group: on the loopback interface (`local`), or where the routes lead.

    Options have python-can's names. Raises BusError where the group cannot be joined.
    """
    address = (channel or GROUP, int(port))
    interface = _interface(local)
    receiver = _receiver(address, interface, local)
    try:
        sender = _sender(interface, (0 if local else 1) if hop_limit is None else hop_limit, local)
    except OSError as error:
        receiver.close()
        raise BusError(f"udp_multicast {address[0]}: {error.strerror}") from error
    return MulticastBus(address, receiver, sender, fd, options)


def probe() -> None:
    """Send a packet to a group on the loopback interface, and get it. Raises OSError, BusError."""
    with contextlib.closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    sender, receiver = (open_group(port=port) for _ in range(2))
    try:
        sender.send(can.Message(arbitration_id=1, data=b"cosim", is_extended_id=False))
        if receiver.recv(PATIENCE) is None:
            raise OSError("a multicast packet does not come back over loopback")
    except can.CanError as error:
        raise OSError(f"no multicast over loopback ({error})") from error
    finally:
        sender.shutdown()
        receiver.shutdown()


@final
class MulticastBus(can.BusABC):
    """A bus that `open_group` opens. `lost`: packets dropped because the queue was full."""

    def __init__(
        self,
        address: tuple[str, int],
        receiver: socket.socket,
        sender: socket.socket,
        fd: bool,
        options: dict[str, Any],
    ) -> None:
        self.lost = 0
        self._to, self._fd = address, fd
        self._in, self._out = receiver, sender
        self._own = sender.getsockname()[1]
        self._can_protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
        self.channel_info = f"udp_multicast {address[0]}:{address[1]}"
        super().__init__(address[0], **options)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        self._in.settimeout(timeout)
        try:
            data, control, _, sender = self._in.recvmsg(LARGEST, socket.CMSG_SPACE(4))
        except (BlockingIOError, TimeoutError):
            return None, False
        except OSError as error:
            raise can.CanOperationError(f"{self.channel_info}: {error.strerror}") from error
        for level, kind, value in control:
            if level == socket.SOL_SOCKET and kind == _RXQ_OVFL:
                self.lost = int.from_bytes(value, sys.byteorder)
        if sender[1] == self._own:
            return None, False
        return self._message(data), False

    def _message(self, data: bytes) -> can.Message | None:
        try:
            message: can.Message = unpack_message(
                data, replace={"timestamp": clock.wall_time()}, check=True
            )
        except Exception as error:  # msgpack and the checks of a message raise all sorts
            raise can.CanOperationError(f"{self.channel_info}: not a frame: {error}") from error
        return message if self._fd or not message.is_fd else None

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame to the group, waiting up to `timeout` s.

        Raises can.CanOperationError if the kernel refuses it, or for CAN FD on a classic bus.
        """
        if msg.is_fd and not self._fd:
            raise can.CanOperationError(f"{self.channel_info}: a CAN FD frame on a classic bus")
        try:
            self._out.settimeout(timeout)
            self._out.sendto(pack_message(msg), self._to)
        except OSError as error:
            raise can.CanOperationError(str(error), error.errno) from error

    def fileno(self) -> int:
        """The file descriptor of the socket that frames arrive at."""
        return self._in.fileno()

    def shutdown(self) -> None:
        """Leave the group."""
        super().shutdown()
        self._in.close()
        self._out.close()


def _interface(local: bool) -> bytes:
    """`struct ip_mreqn` without the group: address and index; zeros: the routing table decides."""
    if not local:
        return struct.pack("=4si", bytes(4), 0)
    index = next((i for i, name in socket.if_nameindex() if name in ("lo", "lo0")), 0)
    if not index:
        raise BusError("udp_multicast: no loopback interface (lo); expected one, or local = false")
    return struct.pack("=4si", socket.inet_aton("127.0.0.1"), index)


def _receiver(address: tuple[str, int], interface: bytes, local: bool) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        group = socket.inet_aton(address[0])
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        if sys.platform == "linux":
            sock.setsockopt(socket.SOL_SOCKET, _RXQ_OVFL, 1)
            sock.setsockopt(socket.IPPROTO_IP, _ALL, 0)
            with contextlib.suppress(PermissionError):
                sock.setsockopt(socket.SOL_SOCKET, _RCVBUFFORCE, RECEIVE_BUFFER)
        sock.bind(address)
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group + interface)
    except OSError as error:
        sock.close()
        raise BusError(_why(address, local, error)) from error
    return sock


def _sender(interface: bytes, hops: int, local: bool) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, bytes(4) + interface)
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, hops)
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)
    sock.bind(("127.0.0.1" if local else "", 0))
    return sock


def _why(address: tuple[str, int], local: bool, error: OSError) -> str:
    group = address[0]
    found = f"udp_multicast {group}:{address[1]}: {error.strerror or error}"
    if ":" in group:
        return f'{found}; expected an IPv4 group such as "{GROUP}": IPv6 groups leave this machine'
    if local:
        return f"{found}; expected a group in 224.0.0.0/4, and lo to be up"
    return f"{found}; expected a group in 224.0.0.0/4, and a route for it"
