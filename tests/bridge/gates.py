"""One running gateway on memory rings; the test acts as all other nodes on its buses."""

from __future__ import annotations

import contextlib
import ctypes as c
import os
import sys
import threading
import time

from bridge.native import node as native
from bridge.native.bus import Bus
from bridge.native.frame import Frame, Ring
from bridge.native.message import Header
from bridge.native.safety import LifeState, Status
from bridge.node.control import Control
from bridge.wiring.wiring import WiredNode
from cosim.base.clock import monotonic_ns
from tests.bridge.bench import until

SAMPLE = LifeState.ACTIVE | Status.SIMULATED


class Gate:
    """`name` of a system, live, and started; with slots of minutes it does nothing but forward.

    `sockets`: descriptors of buses that are no rings; `start`: by itself, not by NMT.
    """

    def __init__(self, system, name, folder, *, real=False, sockets=(), start=True):
        self.system, self.result, self._start = system, None, start
        names = system.buses_of(name)
        self.rings = {bus: (Ring(4096), Ring(4096)) for bus in names}
        linux = sys.platform == "linux"  # elsewhere it looks now and then
        self.bells = [os.eventfd(0, os.EFD_NONBLOCK) for _ in names if linux]
        for (rx, _), bell in zip(self.rings.values(), self.bells, strict=False):
            rx.struct.bell = bell
        buses = {
            bus: Bus.from_socket(sockets[bus], n)
            if bus in sockets
            else Bus.from_rings(*self.rings[bus], n)
            for n, bus in enumerate(names)
        }
        self.wired = WiredNode(system, name, buses, folder / "journal", native.WALL, real=real)
        self.struct, self.control = self.wired.struct, Control(self.wired.struct)

    def __enter__(self):
        self.wired.__enter__()
        self._thread = threading.Thread(target=self._live, daemon=True)
        self._thread.start()
        if self.wired.real:
            self.control.arm()
            until(lambda: self.struct.life.armed)
        if self._start:
            self.start_ns = monotonic_ns() + 200_000_000
            self.control.start(self.start_ns)
            self.begun()
        return self

    def begun(self):
        """Wait until it is."""
        until(lambda: self.struct.begun and self.struct.slot > 0)

    def __exit__(self, *_):
        self.struct.quit = 1
        for rx, _ in self.rings.values():
            rx.put(Frame.of(0x7FF))  # it wakes and sees that it is to end
        self._thread.join()
        self.wired.__exit__()
        for bell in self.bells:
            os.close(bell)

    def _live(self):
        self.result = native.functions().node_live(c.byref(self.struct))

    # ---- what it is told ----

    def next(self, message):
        """The number of the sample that is sent next: no test has said it before."""
        carried = self.system.messages[message]
        return (monotonic_ns() - self.start_ns - carried.offset_ns) // carried.period_ns + 1

    def put(self, bus, frame):
        frame.t_ns = monotonic_ns()
        self.rings[bus][0].put(frame)

    def say(self, message, counter, values, status=SAMPLE, late=0.0):
        """A message, `late` s after it was sent."""
        carried = self.system.messages[message]
        sent = counter * carried.period_ns + carried.offset_ns
        frame = carried.encoding.frame(values, Header(counter, status, sent // 1000))
        while counter and monotonic_ns() - self.start_ns < sent + late * 1e9:
            time.sleep(0.001)
        self.put(carried.bus, frame)
        return frame

    # ---- what it says ----

    def frames(self, encoding, bus, seconds=0.0):
        """(values, header) of every frame of a message that is there, or comes meanwhile."""
        found, end, frame = [], time.monotonic() + seconds, Frame()
        while True:
            while self.rings[bus][1].get(frame):
                if frame.id == encoding.message.id:
                    _, values, header = encoding.decode(frame.payload)
                    found.append(([*values], header))
            if time.monotonic() >= end:
                return found
            time.sleep(0.002)

    def heard(self, message, n=1):
        """The samples of a message until `n` are there."""
        carried, found = self.system.messages[message], []
        with contextlib.suppress(AssertionError):
            until(
                lambda: found.extend(self.frames(carried.encoding, carried.bus)) or len(found) >= n
            )
        return found

    def forwarded(self, encoding, bus):
        """The samples of a message until there is one, and in the 0.1 s after it."""
        found = []
        until(lambda: found.extend(self.frames(encoding, bus)) or found)
        return found + self.frames(encoding, bus, 0.1)
