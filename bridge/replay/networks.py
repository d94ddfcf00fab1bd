"""The networks between the nodes of a twin: each CAN bus of a deployment as a simulated bus.

A simulated bus (:mod:`cosim.bus`) arbitrates and has exact frame times. Bit rates and transmit
queues are those of the deployment. On a Zenoh bus a message arrives when it is sent. On a CAN bus
with only one node nothing is simulated: nobody receives what it sends.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Mapping, Sequence
from typing import Any, final

import numpy as np

from bridge.deployment.spec import BusSpec
from bridge.deployment.system import System
from bridge.native.bus import Bus, BusStruct
from bridge.native.frame import RingStruct
from bridge.native.network import NetworkStruct, RouteStruct
from cosim.bus.frames import EVENT, FRAME, BusEvent
from cosim.bus.settings import BusNodeSettings
from cosim.bus.shared import library
from cosim.bus.simulation import SimulatedBus
from cosim.bus.structs import BusOutputStruct

#: Events and frames that the bus gives at a time.
ROOM = 256
#: What the nodes have to know of a bus.
RECORDED = (BusEvent.RECEIVED, BusEvent.DROPPED)


@final
class Networks:
    """`structs` and `routes` for ``nodes_simulate``, with all that they point to.

    `buses`: of each node its :class:`Bus` objects, in the order of ``System.buses_of``; their rings
    receive what arrives.
    """

    def __init__(self, system: System, buses: Mapping[str, Sequence[Bus]]) -> None:
        self.width = max((len(ends) for ends in buses.values()), default=0)
        self.routes = (RouteStruct * max(1, len(buses) * self.width))()
        for route in self.routes:
            route.network = -1
        self._alive: list[Any] = []
        structs: list[NetworkStruct] = []
        for name, spec in system.deployment.buses.items():
            there = [
                (i, node, system.buses_of(node).index(name))
                for i, node in enumerate(buses)
                if name in system.buses_of(node)
            ]
            if len(there) < 2:
                continue
            for number, (i, _, b) in enumerate(there):
                self.routes[i * self.width + b] = RouteStruct(len(structs), number)
            ends = [buses[node][b] for _, node, b in there]
            structs.append(self._network(spec, [node for _, node, _ in there], ends))
        self.structs = (NetworkStruct * max(1, len(structs)))(*structs)
        self.count = len(structs)

    def _network(self, spec: BusSpec, names: Sequence[str], ends: Sequence[Bus]) -> NetworkStruct:
        rings = (c.POINTER(RingStruct) * len(ends))(*(end.struct.rx for end in ends))
        refused = (c.c_void_p * len(ends))(
            *(c.addressof(end.struct) + BusStruct.send_failed.offset for end in ends)
        )
        self._alive += [rings, refused]
        network = NetworkStruct(
            rx=c.addressof(rings), refused=c.addressof(refused), n_nodes=len(ends)
        )
        if spec.kind == "can":
            self._simulate(network, spec, names)
        return network

    def _simulate(self, network: NetworkStruct, spec: BusSpec, names: Sequence[str]) -> None:
        """Give a network its simulated bus."""
        bus = SimulatedBus(
            spec.timing,
            [
                BusNodeSettings(
                    name,
                    spec.queue_kind,
                    queue_length=spec.queue_length,
                    inbox=spec.queue_length,
                )
                for name in names
            ],
            record=RECORDED,
        )
        events, frames = np.empty(ROOM, EVENT), np.empty(ROOM, FRAME)
        output = BusOutputStruct(events.ctypes.data, frames.ctypes.data, ROOM, ROOM)
        network.bus, network.output, network.room = bus.address, c.addressof(output), ROOM
        for field in ("request", "advance", "next"):
            setattr(network, field, c.cast(getattr(library(), f"bus_{field}"), c.c_void_p).value)
        self._alive += [bus, events, frames, output]
