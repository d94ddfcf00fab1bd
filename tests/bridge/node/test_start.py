"""The conditions for which a node waits before its first slot, each at its limit."""

from __future__ import annotations

import ctypes as c
from itertools import product
from math import inf, nextafter

import pytest

from bridge.native import node as native
from bridge.native.safety import LifeState, Why
from cosim.base.clock import monotonic_ns
from tests.bridge.bench import Bench, until
from tests.bridge.deployments import named
from tests.bridge.gates import Gate
from tests.bridge.slots import Slots

APART = 'deploy.nodes.master_control.apart={of="master.q",other="slave.q",within="5 rad"}'


def test_a_peer_is_there_while_it_is_heard_and_well(tmp_path):
    """It may be silent for exactly its time-out."""
    with Slots(named("can", "run.stop=1"), "master_control", tmp_path) as node:
        peer = node.struct.peers[0]
        peer.heartbeat.timeout_ns, peer.heartbeat.last_ns = 200, 1000
        for required, state, silence in product((0, 1), (-1, *LifeState), (0, 200, 201)):
            peer.required, peer.state = required, state
            well = silence <= 200 and state in (LifeState.INACTIVE, LifeState.ACTIVE)
            absent = native.functions().node_absent(c.byref(node.struct), 0, 1000 + silence)
            assert bool(absent) == (bool(required) and not well), (required, state, silence)


def test_a_message_is_heard_by_any_of_its_frames(tmp_path):
    with Slots(named("can", "run.stop=1"), "master_control", tmp_path) as node:
        reception = node.struct.receptions[0]
        for case in product((0, 1), (-1, 0, 9), (-1, 0, 9), (0, 1)):
            reception.awaited, reception.previewed_ns, reception.newest, reception.of_fault = case
            awaited, previewed, newest, of_fault = case
            heard = previewed >= 0 or newest >= 0 or of_fault
            unheard = native.functions().node_unheard(c.byref(node.struct), 0)
            assert bool(unheard) == bool(awaited and not heard), case


@pytest.fixture(name="apart")
def apart_(tmp_path):
    """A node that compares two positions of two joints each, as they are heard."""
    bench = Bench(tmp_path, APART)
    with bench:
        bench.heard()
        yield bench, bench.struct.aparts[0]


def differences(apart):
    """The difference of each joint, computed from the numbers that the node has decoded."""
    pairs = [(apart.a.contents.values, apart.first_a), (apart.b.contents.values, apart.first_b)]
    a, b = ((c.c_double * apart.count).from_address(at + 8 * first) for at, first in pairs)
    return [x - y for x, y in zip(a, b, strict=True)]


@pytest.mark.parametrize("elsewhere", [[1.0, -1.5], [-1.0, -3.0], [-3.0, 0.25]])
def test_arms_may_be_as_far_apart_as_the_limit_and_no_further(apart, elsewhere):
    bench, limit = apart
    bench.elsewhere = elsewhere
    expected = [q - other for q, other in zip(bench.q, elsewhere, strict=True)]
    until(lambda: differences(limit) == pytest.approx(expected, abs=1e-3))
    greatest = max(map(abs, differences(limit)))
    limit.within = nextafter(greatest, 0)
    bench.control.start(monotonic_ns() + 50_000_000)
    until(lambda: bench.struct.refusals)
    assert Why(bench.struct.refused) == Why.APART
    limit.within = greatest
    bench.begin(0.2)
    assert bench.struct.life.state == LifeState.ACTIVE


def test_a_comparison_behind_the_table_is_none(apart):
    bench, limit = apart
    limit.within, bench.struct.n_aparts = -inf, 0
    bench.begin(0.2)
    assert bench.struct.life.state == LifeState.ACTIVE


def test_a_peer_behind_the_table_is_none(tmp_path):
    with Bench(tmp_path) as bench:
        bench.heard()
        last = bench.struct.peers[bench.struct.n_peers - 1]
        bench.struct.n_peers -= 1
        last.required, last.state = 1, LifeState.FAULT
        bench.control.start(monotonic_ns() + 200_000_000)
        until(lambda: bench.struct.begun or bench.struct.refusals)
        assert bench.struct.life.state == LifeState.ACTIVE


def test_a_message_behind_the_table_is_not_awaited(tmp_path):
    with Bench(tmp_path) as bench:
        bench.heard()
        last = bench.struct.receptions[bench.struct.n_receptions - 1]
        bench.struct.n_receptions -= 1
        last.awaited, last.previewed_ns, last.newest, last.of_fault = 1, -1, -1, 0
        bench.control.start(monotonic_ns() + 200_000_000)
        until(lambda: bench.struct.begun or bench.struct.refusals)
        assert bench.struct.life.state == LifeState.ACTIVE


@pytest.mark.parametrize(("timeout", "begins"), [(0, False), (1, True), (100_000_000, True)])
def test_a_drive_without_a_watchdog_is_not_started(tmp_path, timeout, begins):
    """``master`` of can.toml, which needs nobody else here."""
    with Gate(named("can", "run.stop=60"), "master", tmp_path, start=False) as node:
        s = node.struct
        s.n_peers = 0
        for reception in s.receptions[: s.n_receptions]:
            reception.awaited = 0
        node.wired.drives[0].struct.watchdog.timeout_ns = timeout
        node.control.start(monotonic_ns() + 100_000_000)
        until(lambda: s.begun or s.refusals)
        assert bool(s.begun) is begins
        assert Why(s.refused) == (0 if begins else Why.WATCHDOG)


def test_a_drive_behind_the_table_of_inlets_needs_no_watchdog(tmp_path):
    with Gate(named("can", "run.stop=60"), "master", tmp_path, start=False) as node:
        s = node.struct
        s.n_peers = 0
        for reception in s.receptions[: s.n_receptions]:
            reception.awaited = 0
        (place,) = (k for k, inlet in enumerate(s.inlets[: s.n_inlets]) if inlet.drive)
        node.wired.drives[0].struct.watchdog.timeout_ns = 0
        s.n_inlets = place
        node.control.start(monotonic_ns() + 100_000_000)
        until(lambda: s.begun or s.refusals)
        assert s.begun
