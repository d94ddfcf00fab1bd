"""Checks of this host before a rehearsal: loopback interface, and multicast on it.

Asked before anything starts. Without them, nodes would wait for each other until their patience
ends, and none could say why.
"""

from __future__ import annotations

import socket
from collections.abc import Callable, Sequence
from contextlib import closing

from bridge.can.multicast import probe as multicast
from bridge.can.socket import BusError
from bridge.deployment.spec import BusSpec
from bridge.deployment.system import System
from cosim.base.errors import ScenarioError

#: How long a packet to oneself may take, s: on loopback it takes microseconds.
PATIENCE = 1.0


def check(system: System, nodes: Sequence[str] = ()) -> None:
    """Refuse a rehearsal of `nodes` (default: all) for which this host lacks a network.

    Raises ScenarioError that names what is missing and the bus that needs it.
    """
    here = {bus for node in nodes or tuple(system.nodes) for bus in system.buses_of(node)}
    for name, spec in system.deployment.buses.items():
        needs = _needs(spec) if name in here else None
        if needs is not None:
            try:
                needs()
            except (OSError, BusError) as error:
                raise ScenarioError(
                    f"this host does not support it: {error}; expected the network interface lo up "
                    "(ip link set lo up)",
                    system.deployment.place("buses", name),
                ) from error


def _needs(bus: BusSpec) -> Callable[[], None] | None:
    if bus.kind == "zenoh":
        return loopback
    return multicast if bus.interface == "udp_multicast" and bus.local else None


def loopback() -> None:
    """Connect to this host over 127.0.0.1. Raises OSError."""
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        try:
            socket.create_connection(server.getsockname(), PATIENCE).close()
        except OSError as error:
            raise OSError(f"no connection to 127.0.0.1 ({error.strerror or error})") from error
