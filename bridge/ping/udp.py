"""A path over UDP: one socket, with the kernel's time of each arrival where it gives one."""

from __future__ import annotations

import select
import socket
import struct
from collections.abc import Sequence
from typing import Any, cast, final

from bridge.ping.exchanges import Arrival
from cosim.base.clock import monotonic_ns, now_and_date
from cosim.base.errors import RunError

#: Port of a responder unless another one is given.
PORT = 29531
#: SO_TIMESTAMPNS of Linux: a control message with the date of arrival, struct timespec.
_STAMP = 35
_TIMESPEC = struct.Struct("@qq")
_BATCH = 64
_LARGEST = 65535


def parse_address(text: str, port: int = PORT) -> tuple[str, int]:
    """HOST, HOST:PORT or [IPv6]:PORT. Raises RunError."""
    host, colon, number = text.rpartition(":")
    if not colon or (":" in host and not host.endswith("]")):
        host, number = text, str(port)  # no port, or IPv6 without brackets
    if not number.isdigit() or not 0 <= int(number) <= 65535:
        raise RunError(f"{text!r}: port {number!r}; expected HOST or HOST:PORT")
    return host.strip("[]"), int(number)


@final
class UdpPath:
    """A socket, bound (`listen`) or connected to a responder. Raises RunError if it cannot be.

    An empty host stands for all addresses of this one, of IPv4 and IPv6.
    """

    def __init__(self, address: tuple[str, int], *, listen: bool = False, tos: int = 0) -> None:
        self._socket = _opened(address, listen, tos)
        self._connected = not listen
        self.kernel_stamps = _stamped(self._socket)

    @property
    def port(self) -> int:
        """Our port."""
        return int(self._socket.getsockname()[1])

    def send(self, data: bytes, to: object = None) -> None:
        """Send a datagram. Raises RunError if the system refuses it."""
        try:
            if self._connected:
                self._socket.send(data)
            else:
                self._socket.sendto(data, cast("tuple[Any, ...]", to))
        except OSError as error:
            raise RunError(f"UDP: {error.strerror or error} when a datagram was sent") from None

    def receive(self, until_ns: int) -> Sequence[Arrival]:
        """Up to 64 datagrams that are there, or the first to come before `until_ns`."""
        found = self._waiting()
        if found:
            return found
        left = until_ns - monotonic_ns()
        if left > 0:
            select.select([self._socket], [], [], left * 1e-9)
        return self._waiting()

    def _waiting(self) -> list[Arrival]:
        found: list[Arrival] = []
        while len(found) < _BATCH:
            try:
                data, control, _, sender = self._socket.recvmsg(_LARGEST, 64)
            except BlockingIOError:
                break
            except ConnectionRefusedError:
                continue  # an ICMP message: nobody listens there; counts as a loss
            except OSError:
                break
            now, date = now_and_date()
            waited = _age(control, date)
            found.append(Arrival(data, now - waited, waited, sender))
        return found

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def _opened(address: tuple[str, int], listen: bool, tos: int) -> socket.socket:
    if listen and not address[0]:
        both = _both(address[1])
        if both is not None:
            return both
    flags = socket.AI_PASSIVE if listen else 0
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(
            address[0] or None, address[1], type=socket.SOCK_DGRAM, flags=flags
        )[0]
        made = socket.socket(family, kind, protocol)
    except OSError as error:
        raise RunError(f"udp {address[0]}:{address[1]}: {error.strerror or error}") from None
    try:
        if tos:
            made.setsockopt(socket.IPPROTO_IP, socket.IP_TOS, tos)
        made.setblocking(False)
        (made.bind if listen else made.connect)(place)
    except OSError as error:
        made.close()
        raise RunError(f"udp {address[0]}:{address[1]}: {error.strerror or error}") from None
    return made


def _both(port: int) -> socket.socket | None:
    """A socket bound to all addresses of IPv4 and IPv6; None on a system without IPv6, or where
    the port is taken.
    """
    if not socket.has_dualstack_ipv6():
        return None
    try:
        made = socket.socket(socket.AF_INET6, socket.SOCK_DGRAM)
    except OSError:
        return None
    try:
        made.setblocking(False)
        made.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
        made.bind(("::", port))
    except OSError:
        made.close()
        return None
    return made


def _stamped(made: socket.socket) -> bool:
    """Ask the kernel for stamps; whether it has them."""
    try:
        made.setsockopt(socket.SOL_SOCKET, _STAMP, 1)
    except OSError:
        return False
    return True


def _age(control: Sequence[tuple[int, int, bytes]], date_ns: int) -> int:
    """Time since the kernel took the datagram, ns; 0 without its stamp or if the date was set."""
    for level, kind, data in control:
        if level == socket.SOL_SOCKET and kind == _STAMP and len(data) >= _TIMESPEC.size:
            seconds, ns = _TIMESPEC.unpack_from(data)
            age = date_ns - (seconds * 1_000_000_000 + ns)
            return age if 0 <= age < 1_000_000_000 else 0
    return 0
