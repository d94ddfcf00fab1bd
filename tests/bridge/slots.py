"""One node on the simulated clock: the test sets its inputs and reads its outputs."""

from __future__ import annotations

import ctypes as c

import numpy as np

from bridge.native import node as native
from bridge.native.bus import Bus, BusKind
from bridge.native.frame import Frame, Ring, RingStruct
from bridge.native.network import NetworkStruct, RouteStruct
from bridge.native.safety import LifeState
from bridge.wiring.wiring import WiredNode

#: Simulated time between two looks at what was sent, ns.
LOOK_NS = 1_000_000_000


class Slots:
    """A node alone, ACTIVE from slot 0 on. Use as a context manager; `sent`: (bus, frame)."""

    def __init__(self, system, name, folder, clock=native.SIMULATED):
        self.system, self.sent = system, []
        self.names = system.buses_of(name)
        self.rings = {bus: Ring(1024) for bus in self.names}
        self.buses = {
            bus: Bus.from_rings(self.rings[bus], Ring(1024), number, kind=BusKind.MEMORY)
            for number, bus in enumerate(self.names)
        }
        self.wired = WiredNode(system, name, self.buses, folder / "journal", clock)
        self.struct = self.wired.struct
        for drive in self.wired.commanded.structs:
            drive.within_ns = 0  # drives are not there, and not missed

    def __enter__(self):
        self.wired.__enter__()
        return self

    def __exit__(self, *_):
        self.wired.__exit__()

    def put(self, bus, frame, t):
        """A frame that arrives at `t` s; those of a bus in the order of time."""
        frame.t_ns = round(t * 1e9)
        self.rings[bus].put(frame)

    def begin(self):
        """Make the node active from slot 0 on."""
        self.struct.life.state, self.struct.life.armed = LifeState.ACTIVE, 1
        native.functions().node_enable(c.byref(self.struct), 0)

    def step(self):
        """The next slot, with what has arrived by then; its row. What it sends is not kept."""
        limit = np.array([self.struct.slot * self.struct.h_ns + self.struct.phase_ns])
        result = native.functions().node_follow(c.byref(self.struct), limit.ctypes.data, 1)
        assert result == 0
        return self.wired.journal.rows[-1]

    def run(self, begin=True):
        """All slots; the rows of the journal. `begin`: as :meth:`begin` says, else as it is."""
        if begin:
            self.begin()

        node = (c.c_void_p * 1)(c.addressof(self.struct))
        heard = [Ring(1 << 14) for _ in self.names]
        networks, alive = _listened(heard)
        routes = (RouteStruct * len(heard))(*((i, 0) for i in range(len(heard))))
        end = 1 + self.struct.slots * self.struct.h_ns + self.struct.phase_ns
        for until in range(LOOK_NS, end + LOOK_NS, LOOK_NS):
            result = native.functions().nodes_simulate(
                node, 1, networks, len(heard), routes, len(heard), until
            )
            assert result == 0
            for name, ring in zip(self.names, heard, strict=True):
                self.sent += [(name, frame) for frame in _taken(ring)]
        del alive
        return self.wired.journal.rows.copy()


def _listened(heard):
    """Networks on which frames arrive when they are sent, and what they point to."""
    networks, alive = (NetworkStruct * len(heard))(), []
    for network, ring in zip(networks, heard, strict=True):
        rings = (c.POINTER(RingStruct) * 2)(c.pointer(Ring(1).struct), c.pointer(ring.struct))
        network.rx, network.n_nodes = c.addressof(rings), 2
        alive.append(rings)
    return networks, alive


def _taken(ring):
    """All frames of a ring, the oldest first."""
    assert not ring.dropped
    frames = [Frame()]
    while ring.get(frames[-1]):
        frames.append(Frame())
    return frames[:-1]
