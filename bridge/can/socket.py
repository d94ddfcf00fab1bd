"""A raw SocketCAN socket, set up for a tick: stamps, error frames, filters, a large queue.

Source: Linux, Documentation/networking/can.rst; linux/can/raw.h, linux/can/error.h.
"""

from __future__ import annotations

import contextlib
import errno
import socket
import struct
import sys
from collections.abc import Sequence

from bridge.native.bus import Accept
from bridge.native.frame import Flags
from cosim.base.errors import CosimError

EXTENDED, REMOTE, IDENTIFIER = 0x80000000, 0x40000000, 0x1FFFFFFF
ERRORS = 0x1FFFFFFF
CAN_MTU, CANFD_MTU = 16, 72
RECEIVE_BUFFER = 4 << 20
MOST_FILTERS = 512
_ERR_FILTER = 2
"""CAN_RAW_ERR_FILTER, which typeshed does not have."""
_SO_RCVBUFFORCE, _SIOCGIFFLAGS, _SIOCGIFMTU, _IFF_UP = 33, 0x8913, 0x8921, 1

NO_CAN = (
    "this kernel has no SocketCAN: `python -m bridge.vcan run -- COMMAND` gives a command a kernel "
    'that has it, or take the interface "udp_multicast" (between processes) or "virtual" (in one)'
)


class BusError(CosimError, OSError):
    """A bus cannot be opened; the message gives the reason and a remedy."""


def open_socket(
    channel: str,
    *,
    fd: bool = False,
    accepts: Sequence[Accept] | None = None,
    receive_buffer: int = RECEIVE_BUFFER,
) -> socket.socket:
    """A non-blocking raw socket bound to the interface `channel`.

    It gives frames of other sockets and other machines, not its own, and error frames; CAN FD
    frames if `fd`. `accepts`: which frames (at most 512 rules, done by the kernel), None: all.
    `receive_buffer`: bytes asked for; more than net.core.rmem_max needs CAP_NET_ADMIN and is
    otherwise cut to it.

    Raises BusError: no SocketCAN, no such interface, not one of CAN, down, or without CAN FD.
    """
    if sys.platform != "linux":
        raise BusError(f"{channel}: SocketCAN is Linux only; this is {sys.platform}")
    sock = _raw(channel)
    try:
        _check(sock, channel, fd)
        _options(sock, channel, fd, accepts)
        _grow(sock, receive_buffer)
        sock.bind((channel,))
        sock.setblocking(False)
    except BusError:
        sock.close()
        raise
    except OSError as error:
        sock.close()
        if error.errno == errno.ENODEV:
            raise BusError(f"{channel}: not a CAN interface; {_interface_names()}") from error
        raise BusError(f"{channel}: {error.strerror}") from error
    return sock


def _raw(channel: str) -> socket.socket:
    try:
        return socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    except OSError as error:
        unknown = (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT)
        reason = NO_CAN if error.errno in unknown else error.strerror
        raise BusError(f"{channel}: {reason}") from error


def _check(sock: socket.socket, channel: str, fd: bool) -> None:
    """True if the interface is there, up, and has frames of that size."""
    if channel not in (name for _, name in socket.if_nameindex()):
        raise BusError(f"{channel}: no such network interface; {_interface_names()}")
    virtual = channel.startswith(("vcan", "vxcan"))
    mtu = _ask(sock, channel, _SIOCGIFMTU)
    if fd and mtu < CANFD_MTU:
        how = f"ip link set {channel} down; ip link set {channel} mtu 72; ip link set {channel} up"
        if not virtual:
            how = (
                f"ip link set {channel} down; ip link set {channel} up type can "
                "bitrate 1000000 dbitrate 5000000 fd on"
            )
        raise BusError(f"{channel}: its MTU is {mtu}, CAN FD takes 72: `{how}`")
    if not _ask(sock, channel, _SIOCGIFFLAGS) & _IFF_UP:
        how = "" if virtual else " type can bitrate 1000000"
        raise BusError(f"{channel}: the interface is down: `ip link set {channel} up{how}`")


def _ask(sock: socket.socket, channel: str, request: int) -> int:
    """The answer of an interface to an ioctl for flags or MTU."""
    import fcntl

    answer = fcntl.ioctl(sock, request, struct.pack("16s24x", channel.encode()))
    size = "H" if request == _SIOCGIFFLAGS else "i"
    return int(struct.unpack_from(size, answer, 16)[0])


def _interface_names() -> str:
    names = ", ".join(name for _, name in socket.if_nameindex() if "can" in name)
    if names:
        return f"there are {names}"
    return (
        "there is none of CAN; a virtual one: `ip link add dev vcan0 type vcan; "
        "ip link set vcan0 mtu 72 up`"
    )


def _options(sock: socket.socket, channel: str, fd: bool, accepts: Sequence[Accept] | None) -> None:
    if sys.platform == "linux":
        sock.setsockopt(socket.SOL_CAN_RAW, _ERR_FILTER, ERRORS)
        if fd:
            sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        if accepts is None:
            return
        if len(accepts) > MOST_FILTERS:
            raise BusError(f"{channel}: {len(accepts)} filters; the kernel takes {MOST_FILTERS}")
        rules = b"".join(_rule(accept) for accept in accepts)
        sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, rules)


def _rule(accept: Accept) -> bytes:
    """`struct can_filter`. Size of the identifier and remote frames are part of what is compared.

    The kernel does not tell CAN FD from classic frames here: `bus_receive` does.
    """
    identifier = accept.id & IDENTIFIER | _kernel(accept.flags)
    return struct.pack("=II", identifier, accept.mask & IDENTIFIER | _kernel(accept.flag_mask))


def _kernel(flags: int) -> int:
    """Flags of a frame as bits of an identifier in linux/can.h."""
    extended, remote = flags & Flags.EXTENDED, flags & Flags.REMOTE
    return (EXTENDED if extended else 0) | (REMOTE if remote else 0)


def _grow(sock: socket.socket, size: int) -> None:
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size)
    with contextlib.suppress(PermissionError):
        sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, size)
