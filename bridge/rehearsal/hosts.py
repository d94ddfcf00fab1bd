"""Nodes of a deployment on separate hosts: network namespaces and a network between them.

Nodes that share a CAN bus are on one host; each host is called by the first of its nodes, and so
are the links between hosts: ``FROM>TO``. A CAN bus stays within its host, over loopback.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from itertools import count
from pathlib import Path
from typing import Self, final

from bridge.deployment.system import System
from bridge.relay import namespaces
from bridge.relay.network import RelayNetwork
from cosim.base.errors import ScenarioError
from cosim.base.interrupts import stop_on_signal

PORT = 7461
#: TCP, and UDP for samples. Who connects goes on to UDP when TCP stands: declarations that go two
#: ways may get lost.
BOTH = ("tcp/{}?rel=1#exit_on_failure=true", "udp/{}?rel=0")
_NUMBER = count()


def groups(system: System) -> dict[str, tuple[str, ...]]:
    """Nodes of each host, by the host's name, in the order of the deployment."""
    buses = {
        node: {b for b in system.buses_of(node) if system.deployment.buses[b].kind == "can"}
        for node in system.nodes
    }
    found: list[set[str]] = []
    for node in system.nodes:
        near = [g for g in found if any(buses[node] & buses[other] for other in g)]
        found = [g for g in found if g not in near] + [{node}.union(*near)]
    order = list(system.nodes)
    hosts = sorted((sorted(g, key=order.index) for g in found), key=lambda g: order.index(g[0]))
    return {nodes[0]: tuple(nodes) for nodes in hosts}


def settings(
    system: System, hosts: Mapping[str, Sequence[str]], addresses: Mapping[str, str], zenoh: str
) -> list[str]:
    """Changes of the deployment that let its nodes find each other: TCP, and UDP for samples.

    `zenoh`: the configuration file of all Zenoh buses, "": that of the deployment. Raises
    ScenarioError for a bus whose nodes connect to another address.
    """
    found: list[str] = []
    for name, bus in system.deployment.buses.items():
        if bus.kind != "zenoh":
            continue
        at = f"deploy.buses.{name}"
        if "connect" in bus.options:
            raise ScenarioError(
                "connects to a fixed address, which does not exist on the emulated hosts; expected "
                "nodes that listen",
                system.deployment.place("buses", name, "options", "connect"),
            )
        found += [f"{at}.zenoh={_text(zenoh)}"] if zenoh else []
        found.append(f"{at}.options.insecure=true")
        for host, nodes in hosts.items():
            for i, node in enumerate(n for n in nodes if name in system.buses_of(n)):
                found.append(listen_setting(name, node, f"{addresses[host]}:{PORT + i}"))
    return found


def listen_setting(bus: str, node: str, to: str, endpoints: Sequence[str] = BOTH) -> str:
    """The setting by which a node listens on ``ADDRESS:PORT``, on each of `endpoints`."""
    there = ", ".join(f'"{e.format(to)}"' for e in endpoints)
    return f"deploy.buses.{bus}.options.listen.{node}=[{there}]"


def _text(path: str) -> str:
    return "'" + str(Path(path).resolve()) + "'"


@final
class Hosts:
    """Hosts during a ``with`` block; more than one: connected by `network`.

    `record`: file for one row per packet. Raises NetworkError if namespaces are not available.
    """

    def __init__(self, hosts: Mapping[str, Sequence[str]], record: Path, seed: int = 0) -> None:
        self.hosts = dict(hosts)
        self._of = {node: host for host, nodes in hosts.items() for node in nodes}
        self.network = RelayNetwork(list(hosts), record, seed=seed) if len(hosts) > 1 else None
        self._only = f"{namespaces.PREFIX}{os.getpid()}-only{next(_NUMBER)}"
        self._stack = ExitStack()

    @property
    def addresses(self) -> Mapping[str, str]:
        """The addresses of the hosts; the only one has loopback."""
        if self.network is not None:
            return self.network.addresses
        return dict.fromkeys(self.hosts, "127.0.0.1")

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            with stop_on_signal(lambda: None):  # a signal comes when everything made is known
                if self.network is not None:
                    stack.enter_context(self.network)
                else:
                    namespaces.add(self._only)
                    stack.callback(namespaces.delete, self._only)
                for host in self.hosts:
                    namespaces.multicast(self._namespace(host))
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        with stop_on_signal(lambda: None):  # a signal does not leave half of it behind
            self._stack.close()

    def on_host(self, node: str) -> AbstractContextManager[None]:
        """Move the calling thread to the host of a node, with all that it starts there."""
        return namespaces.in_namespace(self._namespace(self._of[node]))

    def _namespace(self, host: str) -> str:
        return self._only if self.network is None else self.network.namespaces[host]


def missing() -> str:
    """The requirements for hosts that this machine lacks, as an error message; "": none."""
    try:
        with _tried() as name:
            namespaces.multicast(name)
            with namespaces.in_namespace(name):
                os.close(os.open("/dev/net/tun", os.O_RDWR))
    except OSError as error:
        return str(error)
    return ""


@contextmanager
def _tried() -> Iterator[str]:
    name = f"{namespaces.PREFIX}{os.getpid()}-tried{next(_NUMBER)}"
    with stop_on_signal(lambda: None):
        namespaces.add(name)
        try:
            yield name
        finally:
            namespaces.delete(name)
