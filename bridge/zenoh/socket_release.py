"""Release of the address of a UDP listener that does not close.

Zenoh's UDP listener (1.10) waits forever for the reader of a datagram of a connection that it has
given up. Its session then does not close, and its socket keeps the address, so no other session can
listen there. The socket's descriptor is redirected to ``/dev/null``; its owner may still close it.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Iterable
from pathlib import Path

_OPEN = Path("/proc/self/fd")


def release(endpoints: Iterable[str]) -> int:
    """Close this process's sockets bound to these ``udp/HOST:PORT``. Returns their number.

    Only Linux lists the descriptors of a process; on other systems none is found.
    """
    wanted = {_address(e) for e in endpoints if e.startswith("udp/")}
    if not wanted or not _OPEN.is_dir():
        return 0
    return sum(_given_up(int(fd), wanted) for fd in os.listdir(_OPEN))


def _address(endpoint: str) -> tuple[str, int]:
    host, _, port = endpoint.removeprefix("udp/").partition("?")[0].rpartition(":")
    return socket.gethostbyname(host) if ":" not in host else host.strip("[]"), int(port)


def _given_up(fd: int, wanted: set[tuple[str, int]]) -> bool:
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
        found = end.type == socket.SOCK_DGRAM and end.family in (socket.AF_INET, socket.AF_INET6)
        if not found or end.getsockname()[:2] not in wanted:
            return False
    nothing = os.open(os.devnull, os.O_RDWR | os.O_CLOEXEC)
    os.dup2(nothing, fd, inheritable=False)
    os.close(nothing)
    return True
