"""Simulated CAN buses that a rehearsal serves to its nodes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from bridge.bus_server.lag import BusLag
from bridge.bus_server.several_buses import served_buses
from bridge.deployment.system import System
from bridge.node.buses import SIMULATED
from bridge.simulated_can.protocol import is_remote


@contextmanager
def served(system: System, lags: list[BusLag]) -> Iterator[tuple[str, ...]]:
    """Serve the buses of the interface ``cosim`` whose channel is no address yet.

    Where a bus does not keep to the wall clock, `lags` is appended to. Gives settings of the
    deployment, ``deploy.buses.NAME.channel=...``, with their addresses.
    Raises ServerError where this host lets no port be opened.
    """
    d = system.deployment
    here = {
        name: bus.timing
        for name, bus in d.buses.items()
        if bus.kind == "can" and bus.interface == SIMULATED and not is_remote(bus.channel)
    }
    with served_buses(here, simulated=d.clock == "simulated", lags=lags) as channels:
        yield tuple(f'deploy.buses.{name}.channel="{at}"' for name, at in channels.items())
