"""Slots on the wall clock that are late, and the first one of a life that joins a run."""

from __future__ import annotations

import ctypes as c
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import pytest

from bridge.native import node as native
from bridge.native.bus import Bus
from bridge.native.frame import Frame, Ring
from bridge.native.message import Header
from bridge.native.safety import LifeState, Why
from bridge.node.control import Control
from bridge.wiring.wiring import WiredNode
from cosim.base.clock import monotonic_ns, sleep
from cosim.native import shared
from tests.bridge.deployments import document, system_of

Run = c.CFUNCTYPE(c.c_int32, c.c_void_p, c.c_int64)
SLOW, LATE = 5, 4  # the slot that takes long, and for how many slots it does


class Live:
    """A controller without peers on the wall clock. `each` is called in each slot, behind the step
    of its components; `heard`: SYNCs heard by each slot.
    """

    def __init__(self, folder, each, stop="0.1", found=None):
        found = (found or document("can")) | {"silence": 0.0}
        found["nodes"]["master_control"] |= {"requires": [], "stale": {}, "phase": "0.7 ms"}
        self.system = system_of(found, folder, f"run.stop={stop}")
        names = self.system.buses_of("master_control")
        self.rings = {name: Ring(64) for name in names}
        self.sent = {name: Ring(512) for name in names}
        buses = {b: Bus.from_rings(self.rings[b], self.sent[b], n) for n, b in enumerate(names)}
        self.wired = WiredNode(
            self.system, "master_control", buses, folder / "journal", native.WALL
        )
        self.struct, self.each, self.heard = self.wired.struct, each, []

    def run(self, engine, ticks):
        result = Run(shared.address(shared.library().engine_run))(engine, ticks)
        self.heard.append(self.struct.syncs_received)
        self.each(self)
        return result

    def live(self, ahead=0.1, joined=None):
        """All slots, from t = 0 in so many s; the rows of the journal. `joined` takes the place of
        what is called where a life begins in the middle of a run.
        """
        with self.wired:
            run = Run(self.run)

            def begin(slot):
                result = (joined or self.wired._join)(slot)
                self.struct.run = c.cast(run, c.c_void_p)
                return result

            begins = native.Joined(begin)
            self.struct.run, self.struct.joined = (c.cast(f, c.c_void_p) for f in (run, begins))
            with ThreadPoolExecutor(1) as pool:
                ended = pool.submit(native.functions().node_live, c.byref(self.struct))
                self.told = monotonic_ns()
                Control(self.struct).start(self.told + round(ahead * 1e9))
                self.result = ended.result()
            return self.wired.journal.rows.copy()


def slow(say=lambda node, deadline: None):
    """Slot `SLOW` ends when the `LATE` slots behind it are over; before, `say` may give a frame."""

    def each(node):
        s = node.struct
        if s.slot == SLOW:
            deadline = s.start_ns + s.phase_ns + (SLOW + 1) * s.h_ns
            say(node, deadline)
            while monotonic_ns() < deadline + LATE * s.h_ns:
                sleep(0.001)

    return each


@pytest.mark.parametrize(("after", "slot"), [(0, SLOW + 1), (1, SLOW + 2)])
def test_a_late_slot_hears_what_it_would_have_heard_in_time(tmp_path, after, slot):
    """A frame that came at its deadline, and one that came 1 ns later, while it was waited for."""

    def say(node, deadline):
        frame = node.system.services["left"].sync.frame([1], Header())
        frame.t_ns = deadline + after
        node.rings["left"].put(frame)

    node = Live(tmp_path, slow(say))
    node.live()
    assert node.result == native.FINISHED
    assert node.heard == [0] * slot + [1] * (node.struct.slots - slot)


def test_times_of_a_slot_lie_between_its_deadline_and_its_end(tmp_path):
    """Times in the journal, and the stamp of a sent message, are in order."""
    node = Live(tmp_path, lambda _: None)
    rows, s = node.live(), node.struct
    order = [rows[name] for name in ("deadline_ns", "woke_ns", "received_ns", "done_ns")]
    assert all((a <= b).all() for a, b in pairwise(order))
    assert (rows["deadline_ns"] == rows["slot"] * s.h_ns + s.phase_ns).all()
    assert (order[3] < monotonic_ns() - s.start_ns).all()
    assert (rows["send_ns"] > 0).all() and (rows["send_ns"] < order[3] - order[2]).all()
    frame, number = Frame(), 0
    codec = node.system.messages["LINK_2"].encoding
    while node.sent["left"].get(frame):
        header = codec.decode(frame.payload)[2] if frame.id == codec.message.id else None
        if header is None or header.status & 7 == LifeState.INACTIVE:
            continue  # another message, or a preview
        k = header.counter
        assert k == number
        if k < len(rows):  # behind it comes the last one of all
            assert order[2][k] < frame.t_ns - s.start_ns < order[3][k]
        number += 1
    assert number == len(rows) + 1 == 21


@pytest.mark.parametrize("overrun", [0, 12_000_000, 20_000_000_000])
def test_a_slot_that_is_a_slot_late_is_counted_and_one_that_is_too_late_is_a_fault(
    tmp_path, overrun
):
    node = Live(tmp_path, slow())
    node.struct.overrun_ns = overrun
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


@pytest.mark.parametrize(("align", "lead"), [(1, 0.0), (40, 0.3), (8, 2.0)])
@pytest.mark.parametrize("phase", [0, 900_000_000])
def test_a_life_that_joins_begins_two_steps_of_its_slots_behind_its_lead(
    tmp_path, align, lead, phase
):
    """Whenever it looks at the clock: `align` is what its slots are a multiple of."""
    found = []

    def joined(slot):
        found.append((slot, monotonic_ns()))
        return 1

    node = Live(tmp_path, lambda _: None, "60")
    s = node.struct
    s.first, s.lead_ns, s.phase_ns = align, round(lead * 1e9), phase
    assert len(node.live(-9.0, joined)) == 0
    assert node.result == native.NOT_JOINED
    ((slot, until),) = found
    earliest, latest = (
        ((t - (node.told - 9_000_000_000) - phase + s.lead_ns) // s.h_ns // align + 2) * align
        for t in (node.told, until)
    )
    assert slot % align == 0 and earliest <= slot <= latest


def test_a_life_that_joins_is_as_if_it_had_heard_all_until_its_first_slot(tmp_path):
    first = []

    def each(node):
        s = node.struct
        if not first:
            first.append((s.slot, s.epoch.due_ns, monotonic_ns(), s.host_due_ns))
            inlets = node.wired.inlet_bindings.inlets[: s.n_inlets]
            first.extend(inlet.heard_ns for inlet in inlets)
            first.append(s.sync_watchdog.last_ns)
            first.extend(p.heartbeat.last_ns - s.h_ns for p in node.wired.peers.values())
        s.quit = 1

    node = Live(tmp_path, each, "12")
    node.struct.lead_ns = 50_000_000
    node.live(-9.0)
    (slot, due, now, host), *others = first
    assert slot == node.struct.first > 1800 and len(others) > 4
    assert set(others) == {slot * node.struct.h_ns} == {host}
    assert node.told + 500_000_000 < due < now + 500_000_000


def test_a_life_that_comes_behind_the_last_slot_ends_at_once(tmp_path):
    found = []
    node = Live(tmp_path, lambda _: None)
    node.struct.lead_ns = 0
    assert len(node.live(-0.099, lambda slot: found.append(slot) or 0)) == 0
    assert node.result == native.FINISHED and found == []
