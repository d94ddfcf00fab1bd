"""The router: packets from the hosts' TUN interfaces, held back or lost, to where they go."""

from __future__ import annotations

import fcntl
import heapq
import os
import select
import struct
from collections.abc import Callable, Mapping
from typing import Any, final

from bridge.native.journal import Journal
from bridge.relay.impairment import Impairment, RelayLinkSpec
from bridge.relay.namespaces import NetworkError, in_namespace, ip
from cosim.base.errors import ScenarioError

_TUN, _NO_PI, _SETIFF = 0x0001, 0x1000, 0x400454CA
PACKET: Any = [
    ("t_ns", "<i8"), ("left_ns", "<i8"), ("delay_ns", "<i8"), ("link", "<i4"), ("length", "<i2"),
    ("protocol", "<i2"),
]  # fmt: skip
"""A row of the record: CLOCK_MONOTONIC when it came and left, the delay drawn; -1: lost.

`length`: bytes; `protocol`: of IP, see :data:`TCP` and :data:`UDP`.
"""
TCP, UDP = 6, 17
INTERFACE = "net0"
_LOOK = 0.2


def open_tun(namespace: str, address: str) -> int:
    """A TUN interface in a namespace, up, with an address like ``10.77.0.1/24``; its descriptor.

    Raises NetworkError.
    """
    try:
        with in_namespace(namespace):
            descriptor = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
            request = struct.pack("16sH22x", INTERFACE.encode(), _TUN | _NO_PI)
            fcntl.ioctl(descriptor, _SETIFF, request)
    except OSError as error:
        raise NetworkError(f"no TUN interface in {namespace}: {error}") from error
    ip("-n", namespace, "address", "add", address, "dev", INTERFACE)
    ip("-n", namespace, "link", "set", INTERFACE, "up")
    return descriptor


@final
class Router:
    """Hosts by name with their addresses, and the links between them, ``FROM>TO``."""

    def __init__(
        self,
        tuns: Mapping[str, int],
        addresses: Mapping[str, str],
        seed: int,
        record: Journal,
        start_ns: int,
    ) -> None:
        self._tuns = dict(tuns)
        self._hosts = {descriptor: host for host, descriptor in tuns.items()}
        self._of = {_packed(a): host for host, a in addresses.items()}
        pairs = [(a, b) for a in tuns for b in tuns if a != b]
        self.links = {
            f"{a}>{b}": Impairment(f"{a}>{b}", RelayLinkSpec(), seed, start_ns) for a, b in pairs
        }
        self._numbers = {name: i for i, name in enumerate(self.links)}
        self._record = record
        self._waiting: list[tuple[int, int, int, int, bytes]] = []
        self._count = 0
        self.full = 0
        """Packets a host did not take: its queue was full."""

    def set(self, link: str, spec: RelayLinkSpec) -> None:
        """Change a link, or all (``*``). Raises ScenarioError for one that is not there."""
        wanted = list(self.links) if link == "*" else [link]
        for name in wanted:
            if name not in self.links:
                raise ScenarioError(f"no link {name!r}; there are: {', '.join(self.links)}")
            self.links[name].set(spec)

    def run(self, now: Callable[[], int], control: int, command: Callable[[], bool]) -> None:
        """Run until `command` ends it, which is called when data can be read on `control`."""
        while True:
            wait = _LOOK
            if self._waiting:
                wait = min(max(0.0, (self._waiting[0][0] - now()) * 1e-9), _LOOK)
            readable, _, _ = select.select([*self._hosts, control], (), (), wait)
            for descriptor in readable:
                if descriptor == control:
                    if not command():
                        return
                else:
                    self._forward_packet(descriptor, now)
            self._release(now)

    def _forward_packet(self, descriptor: int, now: Callable[[], int]) -> None:
        """All packets a host has sent; each came when it is read, not before."""
        while True:
            try:
                packet = os.read(descriptor, 65536)
            except BlockingIOError:
                return
            target = self._of.get(packet[16:20]) if packet[0] >> 4 == 4 else None
            source = self._hosts[descriptor]
            if target is None or target == source:
                continue  # neither IPv4 nor to one of us
            t_ns, name = now(), f"{source}>{target}"
            delay, leaves = self.links[name].schedule_packet(t_ns, len(packet))
            row = self._recorded(t_ns, delay, name, packet)
            if leaves >= 0:
                self._count += 1
                entry = (leaves, self._count, row, self._tuns[target], packet)
                heapq.heappush(self._waiting, entry)

    def _recorded(self, t_ns: int, delay: int, name: str, packet: bytes) -> int:
        """The number of a packet's row; -1: the record is full."""
        row = len(self._record)
        number, length = self._numbers[name], min(len(packet), 32767)
        there = self._record.append(t_ns, -1, delay, number, length, packet[9])
        return row if there else -1

    def _release(self, now: Callable[[], int]) -> None:
        while self._waiting and self._waiting[0][0] <= (t := now()):
            _, _, row, tun, packet = heapq.heappop(self._waiting)
            try:
                os.write(tun, packet)
                if row >= 0:
                    self._record.rows["left_ns"][row] = t
            except OSError:
                self.full += 1


def _packed(address: str) -> bytes:
    return bytes(int(x) for x in address.partition("/")[0].split("."))
