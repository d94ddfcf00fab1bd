"""One node on a simulated clock, which receives what a test sends and when."""

from __future__ import annotations

import ctypes as c
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from bridge.native import node as native
from bridge.native.bus import Bus, BusKind
from bridge.native.frame import Ring
from bridge.native.message import Header
from bridge.native.safety import LifeState, Status
from bridge.wiring.wiring import WiredNode

SAMPLE = LifeState.ACTIVE | Status.SIMULATED


class Alone:
    """`node` of a system; `end` (s): when it has done its slots."""

    def __init__(self, wired: WiredNode, rings: dict[str, Ring]) -> None:
        self.wired, self._rings = wired, rings
        self._coming: list[tuple[int, str, object]] = []

    def say(
        self, message: str, number: int, values: Sequence[float], late: float = 0.0,
        counter: int | None = None, status: int = SAMPLE,
    ) -> None:  # fmt: skip
        """Sample `number` of a message arrives `late` s after it was to be sent."""
        carried = self.wired.system.messages[message]
        sent = number * carried.period_ns + carried.offset_ns
        header = Header(number if counter is None else counter, status, sent // 1000)
        frame = carried.encoding.frame(values, header)
        frame.t_ns = sent + round(late * 1e9)
        self._coming.append((frame.t_ns, carried.bus, frame))

    def run(self, end: float) -> np.ndarray:
        """Its slots up to `end` s; the journal."""
        for _, bus, frame in sorted(self._coming, key=lambda f: f[0]):
            self._rings[bus].put(frame)
        self._coming.clear()
        s = self.wired.struct
        slots = range(s.slot, round(end * 1e9) // s.h_ns)
        limits = (c.c_int64 * len(slots))(*(i * s.h_ns + s.phase_ns for i in slots))
        assert native.functions().node_follow(c.byref(s), limits, len(slots)) == 0
        return self.wired.journal.rows

    def counts(self, message: str):
        """The receiver of a message."""
        return self.wired.receivers[message]


@contextmanager
def alone(system, name, folder) -> Iterator[Alone]:
    """A node, enabled, without anybody else."""
    rings = {bus: Ring(4096) for bus in system.buses_of(name)}
    buses = {
        bus: Bus.from_rings(rings[bus], Ring(64), n, kind=BusKind.MEMORY)
        for n, bus in enumerate(rings)
    }
    with WiredNode(system, name, buses, folder / "alone.journal", native.SIMULATED) as wired:
        wired.struct.life.state, wired.struct.life.armed = LifeState.ACTIVE, 1
        wired.struct.n_peers = 0
        native.functions().node_enable(c.byref(wired.struct), 0)
        yield Alone(wired, rings)


def torque(rows: Any, node: Any) -> Any:
    """The torques that act on the joints of `master`, (rows, 2), N.m."""
    slot = next(s for s in node.wired.plan.plan.slots().values() if s.name == "master.tau")
    return rows["signals"][:, slot.start : slot.start + 2]
