"""Sockets of Zenoh that would hold up a session or its successor, and their release.

Zenoh (1.10) closes a TCP connection with a linger time of 10 s, in the only thread that receives:
after an interruption, with data that nobody acknowledges, no session of the process receives for
so long, once for each connection. Its UDP listener waits forever for the reader of a datagram of a
connection that it has given up. A session that does not close for such a reason keeps its
addresses, so no other session can listen there. Only Linux lists the descriptors of a process; on
other systems none is found.
"""

from __future__ import annotations

import os
import socket
import struct
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import final

_OPEN = Path("/proc/self/fd")
_FAMILIES = (socket.AF_INET, socket.AF_INET6)
#: ``struct linger``: on or off, s.
_LINGER = struct.Struct("ii")
#: Kind of socket by protocol of an endpoint.
_KINDS = {
    "tcp": socket.SOCK_STREAM,
    "tls": socket.SOCK_STREAM,
    "ws": socket.SOCK_STREAM,
    "udp": socket.SOCK_DGRAM,
    "quic": socket.SOCK_DGRAM,
}
#: Kind, host and port.
_Address = tuple[int, str, int]


def release(endpoints: Iterable[str]) -> int:
    """Close this process's sockets that listen on these ``PROTOCOL/HOST:PORT``.

    A descriptor is redirected to ``/dev/null``; its owner may still close it. Returns their number.
    """
    wanted = {_address(e) for e in endpoints if e.partition("/")[0] in _KINDS}
    if not wanted:
        return 0

    def listens(end: socket.socket) -> bool:
        stream = end.type == socket.SOCK_STREAM
        if stream and not end.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
            return False
        return (end.type, *end.getsockname()[:2]) in wanted

    found = [fd for fd in _descriptors() if _of_socket(fd, listens)]
    for fd in found:
        nothing = os.open(os.devnull, os.O_RDWR | os.O_CLOEXEC)
        os.dup2(nothing, fd, inheritable=False)
        os.close(nothing)
    return len(found)


@final
class Linger:
    """Lets connections of this process over TCP close without waiting: :meth:`clear`."""

    def __init__(self) -> None:
        self._known: set[str] = set()

    def clear(self) -> int:
        """Clear the linger time of connections that are new. Returns how many had one."""
        found = {fd: name for fd in _descriptors() if (name := _name(fd)).startswith("socket:")}
        new = [fd for fd, name in found.items() if name not in self._known]
        self._known = set(found.values())
        return sum(_of_socket(fd, _clear) for fd in new)


def _clear(end: socket.socket) -> bool:
    if end.type != socket.SOCK_STREAM:
        return False
    lingers, _ = _LINGER.unpack(end.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.size))
    end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.pack(0, 0))
    return bool(lingers)


def _descriptors() -> list[int]:
    return [int(fd) for fd in os.listdir(_OPEN)] if _OPEN.is_dir() else []


def _name(fd: int) -> str:
    try:
        return str((_OPEN / str(fd)).readlink())
    except OSError:  # closed meanwhile
        return ""


def _address(endpoint: str) -> _Address:
    protocol, _, rest = endpoint.partition("/")
    host, _, port = rest.partition("?")[0].partition("#")[0].rpartition(":")
    bare = host.strip("[]")
    return _KINDS[protocol], bare if ":" in bare else socket.gethostbyname(bare), int(port)


def _of_socket(fd: int, ask: Callable[[socket.socket], bool]) -> bool:
    """The answer about a copy of the descriptor, if it is a socket of IP."""
    try:
        copy = os.dup(fd)
    except OSError:  # closed meanwhile
        return False
    try:
        end = socket.socket(fileno=copy)
    except OSError:  # not a socket: `copy` is still open
        os.close(copy)
        return False
    with end:
        try:
            return end.family in _FAMILIES and ask(end)
        except OSError:  # reset meanwhile
            return False
