"""Delay lines in C: the rows of cosim.links, and what the network's own delay does to them."""

from __future__ import annotations

import ctypes as c

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.native import delay as native
from bridge.native.delay import Delay, DelayLine, Sample, Waiting
from cosim.errors import PlanError
from cosim.links.grid import Grid
from cosim.links.semantics import Packets, Playout, Signal
from cosim.links.table import DrawnTable
from cosim.links.traces import Trace

MS = 1_000_000  # ns
LOOKS = 40
N = 280  # samples sent by then, at most
RULES = {
    native.SIGNAL: Signal(),
    native.LAST: Packets("last-arrival"),
    native.STAMP: Packets("newest-stamp"),
    native.FIFO: Packets("fifo"),
}
periods = st.integers(1, 7)
steps = st.sampled_from([0.005, 0.001, 0.0125, 1 / 3, 0.0007, 1e-9 * 333_333])


def line(kind, grid, delays, capacity=1024, **more):
    return DelayLine(kind, 1, grid.n_s, grid.n_r, grid.h, capacity, delays, **more)


def drive(d, grid, arrivals, looks=LOOKS, phase=0):
    """The rows held when samples come in as they arrive: (sequence, sent, arrival), ns, by arrival.

    `phase`: of the receiver's slots, ns. Values are checked: sample j carries j.
    """
    rows, coming = [], list(arrivals)
    for row in range(looks):
        now = round(row * grid.n_r * grid.h * 1e9) + phase
        while coming and coming[0][2] <= now + 1:
            j, sent, arrival = coming.pop(0)
            d.put(j, sent, arrival, [float(j)])
        rows.append(d.take(row, now))
        if rows[-1] >= 0:
            assert d.values().tolist() == [rows[-1]]
            assert d.struct.given.sequence == rows[-1]
    return rows


def sent_ns(grid, j):
    return round(j * grid.n_s * grid.h * 1e9)


def arrivals(grid, network, lost=()):
    """What the network makes of every sample: (sequence, sent, arrival), by arrival; ns."""
    found = [
        (j, sent_ns(grid, j), sent_ns(grid, j) + d) for j, d in enumerate(network) if j not in lost
    ]
    return sorted(found, key=lambda a: (a[2], a[0]))


def arrived(grid, j, network, row):
    """Whether sample j, which the network takes so many ns for, is there at a look."""
    return j * grid.n_s + grid.ticks(1e-9 * network) <= row * grid.n_r


def rows_of(rule, grid, T, looks=LOOKS):
    """What the table holds for delays T, s, by look or by sample."""
    law = Trace(np.arange(len(T)), np.array(T), lookup="index")
    return DrawnTable("x", grid, law, rule, 0).stream(looks).rows(looks).tolist()


@st.composite
def links(draw, losses=True):
    """A grid and delays, s, whole quarters of a tick; not a number: lost."""
    grid = Grid(draw(periods), draw(periods), draw(steps))
    longest = draw(st.sampled_from([3, 40, 400]))
    one = st.integers(0, longest)
    values = draw(st.lists(st.none() | one if losses else one, min_size=1, max_size=40))
    values = values if any(q is not None for q in values) else [draw(one)]
    values = (values * N)[:N]
    T = [np.nan if q is None else q / 4 * grid.h for q in values]
    return grid, T


def test_structs_are_as_c_has_them():
    for which, kind in enumerate((Sample, Waiting, Delay)):
        assert native.sizes(which) == c.sizeof(kind)
    assert native.sizes(3) == 0


@pytest.mark.parametrize("capacity", [0, 3, -4])
def test_a_capacity_that_is_no_power_of_two_is_refused(capacity):
    with pytest.raises(PlanError, match="power of two"):
        line(native.LAST, Grid(1, 1, 0.001), [0.0], capacity)


def test_nothing_to_send_is_refused():
    with pytest.raises(PlanError, match="more than 0"):
        DelayLine(native.LAST, 1, 0, 1, 0.001, 16)


# ---- without a network: the tables themselves ----


@settings(max_examples=80, deadline=None)
@given(kind=st.sampled_from([native.LAST, native.STAMP]), link=links())
def test_packets_are_the_rows_of_the_table(kind, link):
    grid, T = link
    rows = drive(line(kind, grid, T), grid, arrivals(grid, [0] * N))
    assert rows == rows_of(RULES[kind], grid, T)


@settings(max_examples=60, deadline=None)
@given(kind=st.sampled_from([native.SIGNAL, native.FIFO]), link=links(losses=False))
def test_what_cannot_lose_is_the_rows_of_the_table(kind, link):
    grid, T = link
    rows = drive(line(kind, grid, T), grid, arrivals(grid, [0] * N))
    assert rows == rows_of(RULES[kind], grid, T)


@settings(max_examples=60, deadline=None)
@given(link=links(), quarters=st.integers(0, 400))
def test_playout_is_the_rows_of_the_table(link, quarters):
    grid, T = link
    buffer = max(quarters / 4 * grid.h, np.nanmin(T))  # the table refuses what never plays
    d = line(native.PLAYOUT, grid, T, buffer=buffer)
    assert drive(d, grid, arrivals(grid, [0] * N)) == rows_of(Playout(buffer), grid, T)


@settings(max_examples=60, deadline=None)
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


# ---- with a network ----

networks = st.lists(st.integers(0, 40_000_000), min_size=1, max_size=25).map(lambda d: (d * N)[:N])
losses = st.sets(st.integers(0, 60), max_size=20)


@settings(max_examples=60, deadline=None)
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


@settings(max_examples=80, deadline=None)
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
    assert rows == rows_of(Playout(buffer), grid, total)


@settings(max_examples=50, deadline=None)
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


@settings(max_examples=40, deadline=None)
@given(link=links(losses=False), late=st.integers(0, 40_000_000))
def test_fifo_over_a_constant_network_is_the_table(link, late):
    grid, T = link
    rows = drive(line(native.FIFO, grid, T), grid, arrivals(grid, [late] * N))
    assert rows == rows_of(Packets("fifo"), grid, [t + 1e-9 * late for t in T])


@settings(max_examples=50, deadline=None)
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


@settings(max_examples=40, deadline=None)
@given(link=links(losses=False), late=st.integers(0, 40_000_000))
def test_a_constant_network_delays_a_signal_by_just_that(link, late):
    grid, T = link
    coming = arrivals(grid, [late] * N)
    rows = drive(line(native.SIGNAL, grid, T), grid, coming)
    expected = rows_of(Signal(), grid, [t + 1e-9 * late for t in T])
    for row, (j, nearest) in enumerate(zip(rows, expected, strict=True)):
        there = max((i for i, _, _ in coming if arrived(grid, i, late, row)), default=-1)
        assert j == min(nearest, there)


def test_a_receiver_that_stood_still_holds_what_it_would_have_held():
    """All looks of a second at once, after everything has come: the same rows."""
    grid, rng = Grid(5, 5, 0.001), np.random.default_rng(3)
    T, network = rng.uniform(0, 0.02, 400), rng.integers(0, 10**7, 400).tolist()
    for kind in (native.LAST, native.STAMP, native.FIFO, native.SIGNAL, native.PLAYOUT):
        on_time, late = (line(kind, grid, T, buffer=0.12) for _ in range(2))
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


# ---- the newest; bounds ----


def test_none_is_the_newest_that_came_whatever_the_time():
    d = line(native.NONE, Grid(1, 1, 0.001), [])
    assert d.take(0) == -1
    d.put(3, 3_000_000, 3_400_000, [3.0])
    d.put(2, 2_000_000, 3_500_000, [2.0])
    assert (d.take(1), d.values().tolist()) == (3, [3.0])


@settings(max_examples=60, deadline=None)
@given(
    kind=st.integers(0, 5),
    puts=st.lists(
        st.tuples(st.integers(-2, 400), st.integers(0, 10**9), st.integers(-(10**9), 10**9)),
        max_size=120,
    ),
    every=st.integers(1, 9),
)
def test_whatever_comes_the_line_stays_within_its_memory(kind, puts, every):
    """Arbitrary numbers and times, 8 samples kept: bounded, and values belong to their sample."""
    d = line(kind, Grid(1, 1, 0.001), [0.0, 0.004, 0.02], 8, buffer=0.01)
    for n, (j, sent, took) in enumerate(puts):
        d.put(j, sent, sent + took, [float(j)])
        if n % every == 0:
            held = d.take(n * 10)
            assert held == -1 or d.values().tolist() == [held]
        assert 0 <= d.struct.n_queue <= 8
    s = d.struct
    assert s.newest <= max((j for j, _, _ in puts), default=-1)
    assert s.ignored >= sum(j < 0 for j, _, _ in puts)


def test_what_is_held_stays_when_its_place_is_used_again():
    """Held for ever after the law lost the rest, though the ring went round many times."""
    d = line(native.LAST, Grid(1, 1, 0.001), [0.0] + [np.nan] * 99, 4)
    for j in range(90):
        d.put(j, j * 10**6, j * 10**6, [float(j)])
        assert (d.take(j), d.values().tolist()) == (0, [0.0])
    assert d.struct.lost == 89


def test_a_line_that_keeps_too_little_says_so():
    d = line(native.STAMP, Grid(1, 1, 0.001), [0.05], 8)
    rows = drive(d, Grid(1, 1, 0.001), arrivals(Grid(1, 1, 0.001), [0] * 200))
    assert rows == [-1] * LOOKS  # 50 are on their way, 8 are kept
    assert d.struct.forgotten > 0


def test_put_twice_counts_once():
    d = line(native.LAST, Grid(1, 1, 0.001), [0.0])
    d.put(0, 0, 0, [1.0])
    d.put(0, 0, 500_000, [2.0])
    assert (d.take(5), d.values().tolist(), d.struct.ignored) == (0, [1.0], 1)


def test_delays_begin_again():
    grid = Grid(1, 1, 0.001)
    rows = drive(line(native.LAST, grid, [0.007]), grid, arrivals(grid, [0] * 100))
    assert rows == [-1] * 7 + list(range(33))


# ---- replay ----


def test_a_replay_holds_what_it_is_told():
    d = line(native.SIGNAL, Grid(1, 1, 0.001), [0.1])
    assert not d.hold(2)
    for j in range(4):
        d.put(j, j * 10**6, j * 10**6, [float(j)])
    assert d.hold(2) and d.values().tolist() == [2.0]
    assert d.hold(-1) and d.struct.held == -1


def test_reset_forgets():
    grid = Grid(2, 1, 0.001)
    d = line(native.STAMP, grid, [0.003])
    first = drive(d, grid, arrivals(grid, [0] * 50))
    d.reset()
    assert drive(d, grid, arrivals(grid, [0] * 50)) == first
