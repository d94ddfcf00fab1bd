"""Slots on the wall clock that are late because the one before them took too long."""

from __future__ import annotations

import ctypes as c
from concurrent.futures import ThreadPoolExecutor

import pytest

from bridge.native import node as native
from bridge.native.bus import Bus
from bridge.native.frame import Ring
from bridge.native.message import Header
from bridge.native.safety import Why
from bridge.node.control import Control
from bridge.wiring.wiring import WiredNode
from cosim.base.clock import monotonic_ns, sleep
from cosim.native import shared
from tests.bridge.deployments import document, system_of

Run = c.CFUNCTYPE(c.c_int32, c.c_void_p, c.c_int64)
SLOW, LATE = 5, 4  # the slot that takes long, and for how many slots it does


class Slow:
    """A controller without peers. Slot `SLOW` ends when the `LATE` slots behind it are over; before,
    `say` may give a frame. `heard`: SYNCs heard by each slot.
    """

    def __init__(self, folder, overrun, say=lambda deadline: None):
        found = document("can") | {"silence": 0.0}
        found["nodes"]["master_control"] |= {"requires": [], "stale": {}, "phase": "0.7 ms"}
        self.system = system_of(found, folder, "run.stop=0.1")
        names = self.system.buses_of("master_control")
        self.rings = {name: Ring(64) for name in names}
        buses = {b: Bus.from_rings(self.rings[b], Ring(512), n) for n, b in enumerate(names)}
        self.wired = WiredNode(
            self.system, "master_control", buses, folder / "journal", native.WALL
        )
        self.struct, self.say, self.heard = self.wired.struct, say, []
        self.struct.overrun_ns = overrun

    def run(self, engine, ticks):
        s = self.struct
        result = Run(shared.address(shared.library().engine_run))(engine, ticks)
        self.heard.append(s.syncs_received)
        if s.slot == SLOW:
            deadline = s.start_ns + s.phase_ns + (SLOW + 1) * s.h_ns
            self.say(deadline)
            while monotonic_ns() < deadline + LATE * s.h_ns:
                sleep(0.001)
        return result

    def live(self):
        """All slots; the rows of the journal."""
        with self.wired:
            run = Run(self.run)
            self.struct.run = c.cast(run, c.c_void_p)
            with ThreadPoolExecutor(1) as pool:
                ended = pool.submit(native.functions().node_live, c.byref(self.struct))
                Control(self.struct).start(monotonic_ns() + 100_000_000)
                self.result = ended.result()
            return self.wired.journal.rows.copy()


@pytest.mark.parametrize(("after", "slot"), [(0, SLOW + 1), (1, SLOW + 2)])
def test_a_late_slot_hears_what_it_would_have_heard_in_time(tmp_path, after, slot):
    """A frame that came at its deadline, and one that came 1 ns later, while it was waited for."""

    def say(deadline):
        frame = node.system.services["left"].sync.frame([1], Header())
        frame.t_ns = deadline + after
        node.rings["left"].put(frame)

    node = Slow(tmp_path, 0, say)
    node.live()
    assert node.result == native.FINISHED
    assert node.heard == [0] * slot + [1] * (node.struct.slots - slot)


@pytest.mark.parametrize("overrun", [0, 12_000_000, 20_000_000_000])
def test_a_slot_that_is_a_slot_late_is_counted_and_one_that_is_too_late_is_a_fault(
    tmp_path, overrun
):
    node = Slow(tmp_path, overrun)
    rows, s = node.live(), node.struct
    late = rows["woke_ns"] - rows["deadline_ns"]
    if overrun != 12_000_000:
        assert node.result == native.FINISHED and len(rows) == s.slots
        assert (late[SLOW + 1 : SLOW + 1 + LATE] >= s.h_ns).all()
    marked = rows["flags"] & native.BURST != 0
    assert marked.tolist() == (late >= s.h_ns).tolist()
    assert (s.missed, s.late.count) == (marked.sum(), len(rows))
    assert (s.late.minimum, s.late.maximum) == (late.min(), late.max())
    wrong = rows["now"] & Why.OVERRUN != 0
    assert wrong.tolist() == [0 < overrun < x for x in late.tolist()]
    assert wrong.any() == (overrun == 12_000_000)
