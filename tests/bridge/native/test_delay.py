"""Delay lines in C: the rows of cosim.links, and what the network's own delay does to them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.native import delay as native
from bridge.native.delay import DelayLine
from cosim.base.errors import PlanError
from cosim.links.semantics import (
    Grid,
    PacketSemantics,
    PlayoutSemantics,
    QueueSemantics,
    SignalSemantics,
)
from tests.bridge.lines import LOOKS, MS, RULES, N, arrivals, arrived, drive, line, links, rows_of
from tests.cosim.links.queues import QUEUES


@pytest.mark.parametrize("capacity", [0, 3, -4])
def test_a_capacity_that_is_no_power_of_two_is_refused(capacity):
    with pytest.raises(PlanError, match="power of two"):
        line(native.LAST, Grid(1, 1, 0.001), [0.0], capacity)


def test_nothing_to_send_is_refused():
    with pytest.raises(PlanError, match="more than 0"):
        DelayLine(native.LAST, 1, 0, 1, 0.001, 16)


# ---- without a network: the tables themselves ----


@given(kind=st.sampled_from([native.LAST, native.STAMP]), link=links())
def test_packets_are_the_rows_of_the_table(kind, link):
    grid, T = link
    rows = drive(line(kind, grid, T), grid, arrivals(grid, [0] * N))
    assert rows == rows_of(RULES[kind], grid, T)


@given(kind=st.sampled_from([native.SIGNAL, native.FIFO]), link=links(losses=False))
def test_what_cannot_lose_is_the_rows_of_the_table(kind, link):
    grid, T = link
    rows = drive(line(kind, grid, T), grid, arrivals(grid, [0] * N))
    assert rows == rows_of(RULES[kind], grid, T)


@given(link=links(), quarters=st.integers(0, 400))
def test_playout_is_the_rows_of_the_table(link, quarters):
    grid, T = link
    buffer = max(quarters / 4 * grid.h, np.nanmin(T))  # the table refuses what never plays
    d = line(native.PLAYOUT, grid, T, buffer=buffer)
    assert drive(d, grid, arrivals(grid, [0] * N)) == rows_of(PlayoutSemantics(buffer), grid, T)


@given(rule=st.sampled_from(QUEUES), link=links())
def test_a_queue_is_the_rows_of_the_table(rule, link):
    grid, T = link
    d = line(native.QUEUE, grid, T, buffer=rule)
    rows = drive(d, grid, arrivals(grid, [0] * N))
    assert rows == rows_of(rule, grid, T)
    assert d.struct.forgotten == 0


def test_a_look_takes_of_a_queue_once_and_one_that_is_left_out_takes_nothing():
    d = line(native.QUEUE, Grid(1, 1, 0.001), [0.0], buffer=QueueSemantics(3))
    for j in range(5):
        d.put(j, j * MS, j * MS, [float(j)])
    assert [d.take(r) for r in (4, 4, 9, 10, 11)] == [2, 2, 3, 4, 4]
    assert d.struct.dropped == 2
    d.reset()
    assert d.take(0) == -1
    d.put(0, 0, 0, [0.0])
    assert [d.take(r) for r in (0, 1, 2)] == [-1, 0, 0]


def test_a_sample_that_is_kept_no_more_when_its_turn_comes_is_counted():
    d = line(native.QUEUE, Grid(1, 1, 0.001), [0.0], capacity=4, buffer=QueueSemantics(8))
    for j in range(4):
        d.put(j, j * MS, j * MS, [float(j)])
    assert d.take(3) == 0
    for j in range(4, 7):  # in the places of 0 to 2
        d.put(j, j * MS, j * MS, [float(j)])
    assert [d.take(r) for r in range(6, 11)] == [3, 4, 5, 6, 6]
    assert d.struct.forgotten == 2


@given(
    kind=st.sampled_from([native.LAST, native.STAMP, native.SIGNAL]),
    link=links(losses=False),
    sender=st.integers(0, 10**7),
    later=st.integers(0, 10**7),
)
def test_slots_that_are_later_by_what_the_network_takes_change_nothing(kind, link, sender, later):
    """The receiver's slots lie `later` behind the sender's, and so long the network takes."""
    grid, T = link
    coming = [(j, s + sender, a + sender) for j, s, a in arrivals(grid, [later] * N)]
    d = line(kind, grid, T, phase_ns=later)
    assert drive(d, grid, coming, phase=sender + later) == rows_of(RULES[kind], grid, T)


# ---- without a network: samples that come as late as they may ----


@given(
    kind=st.sampled_from([*RULES, native.PLAYOUT, native.QUEUE]),
    link=links(losses=False),
    phase=st.integers(-(10**7), 10**7),
)
def test_a_sample_is_not_needed_before_the_lead(kind, link, phase):
    """What is put when it is as old as the lead is held as if it had come at once."""
    grid, T = link
    h_ns = round(grid.h * 1e9)
    buffer = {native.PLAYOUT: max(T), native.QUEUE: QueueSemantics(3)}.get(kind, 0.0)
    at_once, late = (line(kind, grid, T, buffer=buffer, phase_ns=phase) for _ in range(2))
    put = {at_once: 0, late: 0}
    for row in range(LOOKS):
        for d, lead in ((at_once, 0), (late, late.lead_ns)):
            while put[d] * grid.n_s * h_ns + lead <= row * grid.n_r * h_ns + phase:
                sent = put[d] * grid.n_s * h_ns
                d.put(put[d], sent, sent, [float(put[d])])
                put[d] += 1
        assert late.take(row) == at_once.take(row)


def test_the_lead_is_the_least_delay_in_whole_ticks():
    grid = Grid(5, 1, 0.001)
    delays = [0.0402, 0.03, np.inf, np.nan]
    leads = {kind: line(kind, grid, delays).lead_ns for kind in RULES}
    assert leads.pop(native.SIGNAL) == 28 * MS  # it holds the nearest: half a period later
    assert set(leads.values()) == {30 * MS}
    assert line(native.NONE, grid, delays).lead_ns == 0
    assert line(native.PLAYOUT, grid, [0.001], buffer=0.0201).lead_ns == 21 * MS
    assert line(native.LAST, grid, [0.0]).lead_ns == line(native.LAST, grid, []).lead_ns == 0
    assert line(native.LAST, grid, delays, phase_ns=MS // 2).lead_ns == 30 * MS + MS // 2
    assert line(native.LAST, grid, [np.inf]).lead_ns == 10**9 * MS


def test_a_lead_of_so_many_ticks_that_the_tolerance_is_lost_is_exact():
    """2e8 ticks and a little are a tick more."""
    grid = Grid(1, 1, 0.001)
    assert line(native.LAST, grid, [2e5]).lead_ns == 200_000_000 * MS
    assert line(native.LAST, grid, [2e5 + 1e-4]).lead_ns == 200_000_001 * MS
    assert line(native.PLAYOUT, grid, [0.0], buffer=2e5).lead_ns == 200_000_000 * MS
    assert line(native.SIGNAL, Grid(2, 1, 0.001), [2e5]).lead_ns == 200_000_000 * MS


# ---- with a network ----

networks = st.lists(st.integers(0, 40_000_000), min_size=1, max_size=25).map(lambda d: (d * N)[:N])
losses = st.sets(st.integers(0, 60), max_size=20)


@given(
    kind=st.sampled_from([native.LAST, native.STAMP]), link=links(), network=networks, lost=losses
)
def test_the_network_comes_on_top(kind, link, network, lost):
    """Delays T and a network that takes d, reorders and loses: the table of T + d."""
    grid, T = link
    rows = drive(line(kind, grid, T), grid, arrivals(grid, network, lost))
    total = [
        np.nan if j in lost else t + 1e-9 * d
        for j, (t, d) in enumerate(zip(T, network, strict=True))
    ]
    assert rows == rows_of(RULES[kind], grid, total)


@given(rule=st.sampled_from(QUEUES), link=links(), network=networks, lost=losses)
def test_a_queue_is_behind_the_network(rule, link, network, lost):
    grid, T = link
    d = line(native.QUEUE, grid, T, buffer=rule)
    total = [
        np.nan if j in lost else t + 1e-9 * d
        for j, (t, d) in enumerate(zip(T, network, strict=True))
    ]
    assert drive(d, grid, arrivals(grid, network, lost)) == rows_of(rule, grid, total)


@given(link=links(), network=networks, lost=losses, quarters=st.integers(0, 400))
def test_playout_covers_the_network(link, network, lost, quarters):
    """What the network takes is not added: the buffer is the delay, if it is long enough."""
    grid, T = link
    total = [
        np.nan if j in lost else t + 1e-9 * d
        for j, (t, d) in enumerate(zip(T, network, strict=True))
    ]
    buffer = max(quarters / 4 * grid.h, np.nanmin(total))
    rows = drive(line(native.PLAYOUT, grid, T, buffer=buffer), grid, arrivals(grid, network, lost))
    assert rows == rows_of(PlayoutSemantics(buffer), grid, total)


@given(link=links(losses=False), network=networks, lost=losses)
def test_fifo_keeps_the_order_and_the_delay(link, network, lost):
    grid, T = link
    rows = drive(line(native.FIFO, grid, T), grid, arrivals(grid, network, lost))
    assert rows == sorted(rows)
    for row, j in enumerate(rows):
        if j >= 0:
            age = (row * grid.n_r - j * grid.n_s) * grid.h
            assert j not in lost
            assert age >= T[j] + 1e-9 * network[j] - 1e-8 * grid.h


@given(link=links(losses=False), late=st.integers(0, 40_000_000))
def test_fifo_over_a_constant_network_is_the_table(link, late):
    grid, T = link
    rows = drive(line(native.FIFO, grid, T), grid, arrivals(grid, [late] * N))
    assert rows == rows_of(PacketSemantics("fifo"), grid, [t + 1e-9 * late for t in T])


@given(link=links(losses=False), network=networks, lost=losses)
def test_a_signal_is_as_late_as_its_law_and_the_network(link, network, lost):
    grid, T = link
    coming = arrivals(grid, network, lost)
    rows = drive(line(native.SIGNAL, grid, T), grid, coming)
    for row, j in enumerate(rows):
        now = row * grid.n_r * grid.h
        there = [i for i, _, _ in coming if arrived(grid, i, network[i], row)]
        if not there:
            assert j == -1
            continue
        delay = T[row] + 1e-9 * network[max(there)]
        wanted = (now - delay) / (grid.n_s * grid.h)  # samples
        if j >= 0:
            assert j in there
            assert j <= wanted + 0.5 + 1e-6
        between = [i for i in there if j < i <= wanted + 0.5 - 1e-6]
        assert not between  # nothing nearer, from below, was there


@given(link=links(losses=False), late=st.integers(0, 40_000_000))
def test_a_constant_network_delays_a_signal_by_just_that(link, late):
    grid, T = link
    coming = arrivals(grid, [late] * N)
    rows = drive(line(native.SIGNAL, grid, T), grid, coming)
    expected = rows_of(SignalSemantics(), grid, [t + 1e-9 * late for t in T])
    for row, (j, nearest) in enumerate(zip(rows, expected, strict=True)):
        there = max((i for i, _, _ in coming if arrived(grid, i, late, row)), default=-1)
        assert j == min(nearest, there)


def test_a_receiver_that_stood_still_holds_what_it_would_have_held():
    """All looks of a second at once, after everything has come: the same rows."""
    grid, rng = Grid(5, 5, 0.001), np.random.default_rng(3)
    T, network = rng.uniform(0, 0.02, 400), rng.integers(0, 10**7, 400).tolist()
    for kind in (*RULES, native.PLAYOUT, native.QUEUE):
        buffer = QueueSemantics(4) if kind == native.QUEUE else 0.12
        on_time, late = (line(kind, grid, T, buffer=buffer) for _ in range(2))
        for j, s, a in (coming := arrivals(grid, network)):
            late.put(j, s, a, [float(j)])
        assert [late.take(r) for r in range(200)] == drive(on_time, grid, coming, 200)


def test_a_signal_over_a_network_that_reorders():
    """Sample 3 takes 7 ms, all others 1 ms; all are put at once: nothing is held in advance."""
    d = line(native.SIGNAL, Grid(1, 1, 0.001), [0.001])
    for j in range(12):
        d.put(j, j * MS, j * MS + (7 if j == 3 else 1) * MS, [float(j)])
    # at 5 ms the sample of 3 ms is wanted: not there yet; at 10 ms the newest is still sample 9
    assert [d.take(r) for r in range(12)] == [-1, -1, 0, 1, 2, 2, 4, 5, 6, 7, 8, 9]
    assert (d.struct.visible, d.struct.network_ns) == (10, MS)


def test_what_was_overtaken_does_not_hold_up_a_fifo():
    """Sample 1 takes 20 ms and is ignored; sample 3, sent after it, is not as late."""
    d = line(native.FIFO, Grid(1, 1, 0.001), [0.0])
    for j, took in ((0, 1), (2, 1), (1, 20), (3, 1)):
        d.put(j, j * MS, (j + took) * MS, [float(j)])
    assert [d.take(r) for r in range(6)] == [-1, 0, 0, 2, 3, 3]
    assert d.struct.ignored == 1
