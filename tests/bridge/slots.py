"""One node on the simulated clock: what it hears when is put in, what it sends and does is read."""

from __future__ import annotations

import ctypes as c

import numpy as np

from bridge.native import node as native
from bridge.native.bus import Bus, BusKind
from bridge.native.frame import Frame, Ring
from bridge.native.safety import LifeState
from bridge.wiring.wiring import WiredNode

SEEN = c.CFUNCTYPE(c.c_int64, c.POINTER(Frame), c.c_double, c.c_double)


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
        """From slot 0 on."""
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

        def seen(frame, *_):
            copy = Frame()
            c.pointer(copy)[0] = frame[0]
            self.sent.append((self.names[copy.bus], copy))
            return 0

        node = (c.c_void_p * 1)(c.addressof(self.struct))
        rates, routes = np.ones(2 * len(self.names)), np.arange(len(self.names), dtype=np.int32)
        busy = np.zeros(len(self.names), dtype=np.int64)
        result = native.functions().nodes_simulate(
            *(node, 1, c.cast(SEEN(seen), c.c_void_p), rates.ctypes.data, busy.ctypes.data),
            *(routes.ctypes.data, len(self.names), 1 << 62),
        )
        assert result == 0
        return self.wired.journal.rows.copy()
