"""A node that begins when the run has gone on for a while: its tables are where the run is."""

from __future__ import annotations

import ctypes as c
import threading

import numpy as np
import pytest

from bridge.native import node as native
from bridge.native.safety import LifeState
from bridge.wiring.wiring import WiredNode
from cosim.base.clock import monotonic_ns
from cosim.base.errors import RunError
from cosim.fmi import FmuComponent
from tests.bridge.bench import PATIENCE, Bench, until
from tests.bridge.deployments import TELEOPERATION, one_node, system_of

XI = ("master_control.xi_in", "slave_control.xi_in")
FIRST = 1000  # slots before this life


@pytest.fixture
def life(tmp_path):
    """(plan, signals) of a node with everything in it, from slot FIRST on."""
    system = system_of(
        one_node(["master", "master_control", "slave", "slave_control"]),
        tmp_path,
        "run.stop=4",
        scenario=TELEOPERATION,
    )
    with WiredNode(system, "all", {}, tmp_path / "journal", native.SIMULATED) as wired:
        s = wired.struct
        s.slot = s.first = FIRST
        wired.begin(FIRST)
        s.life.state, s.life.armed = LifeState.ACTIVE, 1
        native.functions().node_enable(c.byref(s), s.slot * s.h_ns)
        limits = np.arange(FIRST, wired.plan.slots, dtype=np.int64) * s.h_ns
        assert native.functions().node_follow(c.byref(s), limits.ctypes.data, len(limits)) == 0
        assert wired.engine.tick == wired.plan.slots
        yield wired.plan.plan, wired.journal.rows["signals"].copy()


def test_links_inside_it_go_on_in_their_tables(life):
    plan, signals = life
    for link in plan.links:
        sent, received = (
            signals[:, s.start : s.start + s.size] for s in (link.source, link.target)
        )
        grid = link.table.grid
        hits = np.arange(FIRST, FIRST + len(signals)) // grid.n_r
        held = link.table.stream(int(hits[-1]) + 1).rows(int(hits[-1]) + 1)[hits]
        own = held * grid.n_s - FIRST  # in slots of this life
        assert (own >= 0).any() and (own < 0).any()
        assert np.array_equal(received[own >= 0], sent[own[own >= 0]])
        assert (received[own < 0] == received[0]).all()


def test_its_components_are_initialised_with_the_time_of_the_run(life):
    plan, signals = life
    fmus = [s.component for s in plan.components if isinstance(s.component, FmuComponent)]
    assert len(fmus) == 4
    assert all(fmu.begin == FIRST * plan.h for fmu in fmus)
    assert np.isfinite(signals).all()


def test_a_life_that_cannot_be_started_anew_says_why(tmp_path, monkeypatch):
    def fails(tick):
        raise RunError("no memory")

    system = system_of(
        one_node(["master", "master_control", "slave", "slave_control"]),
        tmp_path,
        "run.stop=4",
        scenario=TELEOPERATION,
    )
    with WiredNode(system, "all", {}, tmp_path / "journal", native.SIMULATED) as wired:
        monkeypatch.setattr(wired.engine, "initialize", fails)
        assert native.Joined(wired.struct.joined)(FIRST) == 1  # as C calls it
        assert wired.failed == "no memory"


def test_a_node_that_cannot_join_a_run_ends_before_its_first_slot(tmp_path, monkeypatch):
    def fails(slot):
        raise RunError("no memory")

    with Bench(tmp_path) as bench:
        monkeypatch.setattr(bench.wired, "begin", fails)
        bench.heard()
        bench.control.start(monotonic_ns() - 500_000_000)
        until(lambda: bench.result is not None)
    assert bench.result == native.NOT_JOINED
    assert not bench.struct.begun


def test_a_life_that_joins_begins_with_a_slot_for_which_it_is_ready_in_time(tmp_path):
    """What it takes to get ready, `lead_ns`, comes on top of the time at which it joins."""
    since = 500_000_000
    with Bench(tmp_path) as bench:
        s = bench.struct
        s.lead_ns = 5_000_000_000
        bench.heard()
        bench.control.start(monotonic_ns() - since)
        until(lambda: s.begun)
    assert s.first % bench.wired.plan.plan.components[0].period == 0
    assert s.first * s.h_ns + s.phase_ns >= since + s.lead_ns + s.h_ns


def test_a_life_that_is_stopped_while_it_joins_ramps_down_in_its_first_slots(tmp_path, monkeypatch):
    goes_on = threading.Event()
    with Bench(tmp_path) as bench:
        begin = bench.wired.begin

        def slowly(slot):
            assert goes_on.wait(PATIENCE)
            begin(slot)

        monkeypatch.setattr(bench.wired, "begin", slowly)
        bench.heard()
        bench.control.start(monotonic_ns() - 500_000_000)  # so late that it joins a later slot
        until(lambda: bench.struct.life.state == LifeState.ACTIVE)
        bench.control.stop()
        assert not bench.struct.begun and bench.struct.told
        goes_on.set()
        until(lambda: bench.result is not None)
    assert bench.struct.life.state == LifeState.INACTIVE
    assert bench.struct.slot >= bench.struct.first + bench.struct.life.ramp_ticks
