"""One running node on memory rings; the test acts as all other nodes on its buses."""

from __future__ import annotations

import ctypes as c
import threading
import time

import numpy as np

from bridge.deployment.system import load_system
from bridge.native import node as native
from bridge.native.bus import Bus
from bridge.native.frame import Frame, Ring
from bridge.native.message import Header
from bridge.native.safety import LifeState, Status
from bridge.node.control import Control
from bridge.node.missing_inputs import missing_before_start
from bridge.wiring.wiring import WiredNode
from cosim.base.clock import monotonic_ns
from tests.bridge.deployments import TELEOPERATION

PATIENCE = 20.0  # s
#: A machine that stands still now and then is no reason to stop.
CALM = (
    'deploy.nodes.master_control.overrun="20 s"',
    'deploy.nodes.master_control.within="2 s"',
    'deploy.nodes.master_control.stale={"master_control.q"={stop="2 s"}}',
    "deploy.silence=0",  # the slave is not there
)


def until(true, seconds=PATIENCE):
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "not in time"
        time.sleep(0.002)


class Bench:
    """``master_control`` of configs/deploy/can.toml, live.

    `q`: of the master (2,), rad; `elsewhere`: of the slave, None where it is with the master.
    """

    def __init__(self, folder, *settings, real=False, boots=1, there=True, simulated=None):
        self.system = load_system(TELEOPERATION, "can", [*CALM, *settings])
        self.q = [-np.pi / 3, -np.pi / 2]  # where the scenario starts
        self.elsewhere = None
        self.there, self.simulated = there, (not real if simulated is None else simulated)
        self.boots = {1: 1, 4: 1}
        self.sent, self.result = [], None
        names = self.system.buses_of("master_control")
        self.rings = {name: (Ring(4096), Ring(4096)) for name in names}
        buses = {name: Bus.from_rings(*self.rings[name], n) for n, name in enumerate(names)}
        self.wired = WiredNode(
            self.system, "master_control", buses, folder / "journal", native.WALL,
            boots=boots, real=real,
        )  # fmt: skip
        self.struct = self.wired.struct
        self.control = Control(self.struct)
        self._over = threading.Event()

    def __enter__(self):
        self.wired.__enter__()
        self._threads = [threading.Thread(target=self._live), threading.Thread(target=self._play)]
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_):
        self.struct.quit = 1
        self._threads[0].join()
        self._over.set()
        self._threads[1].join()
        self.wired.__exit__()

    def _live(self):
        self.result = native.functions().node_live(c.byref(self.struct))

    def _play(self):
        while not self._over.is_set():
            if self.there:
                self._peers()
            self._take()
            time.sleep(0.003)
        self._take()

    def _peers(self):
        now, start = monotonic_ns(), self.struct.start_ns
        running = start and now >= start
        life = LifeState.ACTIVE if running else LifeState.INACTIVE
        status = life | (Status.SIMULATED if self.simulated else 0)
        slave = self.elsewhere or self.q
        for message, bus, q in (("STATE_1", "left", self.q), ("STATE_3", "right", slave)):
            period = self.system.messages[message].period_ns
            k = max(0, now - start) // period if running else 0
            header = Header(counter=k, status=status, t_us=k * period // 1000)
            codec = self.system.messages[message].encoding
            if message in self.system.received_by("master_control"):
                self.put(bus, codec.frame([*q, 0.0, 0.0], header, now))
        self.beat(1, life)

    def beat(self, number, life=LifeState.ACTIVE):
        beat = self.system.services["left"].heartbeats[number]
        status = Status.SIMULATED if self.simulated else 0
        values = [life, 0, self.boots[number], 0]
        self.put("left", beat.frame(values, Header(status=status), monotonic_ns()))

    def put(self, bus, frame):
        self.rings[bus][0].put(frame)

    def _take(self):
        frame = Frame()
        for bus, (_, tx) in self.rings.items():
            while tx.get(frame):
                copy = Frame()
                c.pointer(copy)[0] = frame
                self.sent.append((bus, copy))

    # ---- what it said ----

    def said(self, encoding, bus="left"):
        """(values, header) of every frame of a message, in order."""
        found = [f for b, f in self.sent if b == bus and f.id == encoding.message.id]
        decoded = [encoding.decode(f.payload) for f in found]
        return [(values, header) for _, values, header in decoded]

    @property
    def torques(self):
        """The torques of every LINK_2, (2,) each."""
        encoding = self.system.messages["LINK_2"].encoding
        return [values[:2] for values, _ in self.said(encoding)]

    @property
    def beats(self):
        return self.said(self.system.services["left"].heartbeats[2])

    def estops(self, bus="left"):
        return len(self.said(self.system.services[bus].estop, bus))

    # ---- what it is told ----

    def heard(self):
        """Wait until the node has heard all that it needs for a START."""
        until(lambda: not missing_before_start(self.wired))

    def begin(self, lead=0.4):
        """START, once the peers were heard; returns when it runs."""
        self.heard()
        self.control.start(monotonic_ns() + round(lead * 1e9))
        until(lambda: self.struct.begun and self.struct.slot > 2)

    def end(self):
        until(lambda: self.result is not None)
        time.sleep(0.02)
        return self.result
