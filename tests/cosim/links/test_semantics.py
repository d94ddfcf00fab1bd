"""The six rules against an oracle that goes tick by tick in exact arithmetic."""

from __future__ import annotations

from fractions import Fraction
from hashlib import sha256
from math import ceil, floor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import ScenarioError
from cosim.base.random_numbers import generator
from cosim.links.laws import Constant, Law, Uniform
from cosim.links.semantics import (
    Grid,
    PacketSemantics,
    PlayoutSemantics,
    QueueSemantics,
    Rule,
    SignalSemantics,
)
from cosim.links.table import DrawnTable
from cosim.links.traces import DelayTrace
from tests.cosim.links.numpy_rows import Queue
from tests.cosim.links.queues import QUEUES

PACKETS = (
    PacketSemantics("last-arrival"),
    PacketSemantics("newest-stamp"),
    PacketSemantics("fifo"),
)


def oracle_packets(rule, n_s, n_r, h, T, looks):
    """One list entry a look. T[j]: s, None where packet j is lost; all numbers exact."""
    on_the_way, rows, held, arrived, before = [], [], -1, set(), 0
    for k in range(n_r * (looks - 1) + 1):
        if k % n_s == 0 and T[k // n_s] is not None:
            arrival = k + ceil(T[k // n_s] / h)
            if rule == PacketSemantics("fifo"):
                arrival = before = max(before, arrival)
            on_the_way.append((arrival, k // n_s))
        for _, j in sorted(p for p in on_the_way if p[0] == k):
            arrived.add(j)
            if rule == PacketSemantics("newest-stamp"):
                held = max(held, j)
            elif isinstance(rule, PacketSemantics):
                held = j
        if k % n_r == 0:
            if isinstance(rule, PlayoutSemantics):
                play = floor(Fraction(k - ceil(exact(rule.buffer) / h), n_s))
                held = play if play in arrived else held
            rows.append(held)
    return rows


def oracle_queue(rule, n_s, n_r, h, T, looks):
    """A reference like `oracle_packets`: samples of a tick enter a ``deque`` as they were sent."""
    coming, rows, queue = [], [], Queue(rule)
    for k in range(n_r * (looks - 1) + 1):
        if k % n_s == 0 and T[k // n_s] is not None:
            coming.append((k + ceil(T[k // n_s] / h), k // n_s))
        for _, j in sorted(p for p in coming if p[0] == k):
            queue.put(j)
        if k % n_r == 0:
            rows.append(queue.get())
    return rows


def oracle_signal(n_s, n_r, h, T, looks):
    """The nearest to t - T of what has been sent, a tie to the older; T[r]: s, at each look."""
    rows = []
    for r in range(looks):
        wanted = (n_r * r * h - T[r]) / (n_s * h)  # in samples
        newest = n_r * r // n_s
        near = {min(floor(wanted), newest), min(floor(wanted) + 1, newest)}
        rows.append(max(-1, min(near, key=lambda j: (abs(j - wanted), j))))
    return rows


def exact(x):
    return Fraction(repr(float(x)))


def given_delays(quarters, h):
    """A trace of delays counted in quarters of a tick, None: lost."""
    T = [None if q is None else exact(float(Fraction(q, 4) * exact(h))) for q in quarters]
    delay = np.array([np.nan if x is None else float(x) for x in T])
    return T, DelayTrace(np.arange(len(T)), delay, lookup="index")


periods = st.integers(1, 7)
steps = st.sampled_from([0.005, 0.001, 0.0125, 0.3, 1.0])


@st.composite
def quarters(draw, losses):
    """Enough delays for 60 looks at the widest ratio of periods; short or long ones dominate."""
    longest = draw(st.sampled_from([3, 40, 400]))
    one = st.integers(0, longest)
    values = draw(st.lists(st.none() | one if losses else one, min_size=1, max_size=60))
    values = values if any(q is not None for q in values) else [draw(one)]
    return (values * 430)[:430]


def checked(rule: Rule, n_s: int, n_r: int, h: float, law: Law, looks: int) -> list[int]:
    """The rows; asserts what is declared about them."""
    table = DrawnTable("x", Grid(n_s, n_r, h), law, rule, 0)
    rows = table.stream(looks).rows(looks)
    assert rows.dtype == np.int32
    tick = n_r * np.arange(looks)
    held = rows >= 0
    assert (tick - n_s * rows)[held].min(initial=10**9) >= table.minimum_delay_ticks
    new = held & (np.diff(rows, prepend=-1) != 0)
    assert (tick // n_s - rows)[new].max(initial=0) < table.history
    return rows.tolist()


@given(rule=st.sampled_from(PACKETS), n_s=periods, n_r=periods, h=steps, data=st.data())
def test_packets_are_what_the_oracle_says(rule, n_s, n_r, h, data):
    T, law = given_delays(data.draw(quarters(losses=rule != PacketSemantics("fifo"))), h)
    rows = checked(rule, n_s, n_r, h, law, 60)
    assert rows == oracle_packets(rule, n_s, n_r, exact(h), T, 60)


@given(rule=st.sampled_from(QUEUES), n_s=periods, n_r=periods, h=steps, data=st.data())
def test_queues_are_what_the_oracle_says(rule, n_s, n_r, h, data):
    T, law = given_delays(data.draw(quarters(losses=True)), h)
    rows = checked(rule, n_s, n_r, h, law, 60)
    assert rows == oracle_queue(rule, n_s, n_r, exact(h), T, 60)


@given(n_s=periods, n_r=periods, data=st.data(), depth=st.sampled_from([1, 3, 1000]))
def test_a_queue_that_keeps_no_more_than_the_last_is_last_arrival(n_s, n_r, data, depth):
    """One place, or all taken: the sample that arrived last; the oldest makes room."""
    _, law = given_delays(data.draw(quarters(losses=True)), 0.005)
    last = checked(PACKETS[0], n_s, n_r, 0.005, law, 60)
    assert checked(QueueSemantics(1), n_s, n_r, 0.005, law, 60) == last
    assert checked(QueueSemantics(depth, take="all"), n_s, n_r, 0.005, law, 60) == last


@pytest.mark.parametrize("depth", [0, -3, 100_001])
def test_a_queue_without_a_place_or_with_too_many_is_refused(depth):
    with pytest.raises(ScenarioError, match=f"depth = {depth}; expected 1 to 100000 samples"):
        QueueSemantics(depth)


@given(n_s=periods, n_r=periods, h=steps, buffer=st.integers(0, 400), data=st.data())
def test_playout_is_what_the_oracle_says(n_s, n_r, h, buffer, data):
    T, law = given_delays(data.draw(quarters(losses=True)), h)
    rule = PlayoutSemantics(float(Fraction(buffer, 4) * exact(h)))
    expected = oracle_packets(rule, n_s, n_r, exact(h), T, 60)
    try:
        rows = checked(rule, n_s, n_r, h, law, 60)
    except ScenarioError as error:  # refused, because there is nothing it could ever play
        assert "delivers no sample" in str(error)
        rows = [-1] * 60
    assert rows == expected


@given(n_s=periods, n_r=periods, h=steps, data=st.data())
def test_signal_is_what_the_oracle_says(n_s, n_r, h, data):
    T, law = given_delays(data.draw(quarters(losses=False)), h)
    assert checked(SignalSemantics(), n_s, n_r, h, law, 60) == oracle_signal(
        n_s, n_r, exact(h), T, 60
    )


laws = st.one_of(
    st.builds(Constant, st.floats(0, 0.4)),
    st.builds(
        lambda low, width, hold: Uniform(low, low + width, hold),
        st.floats(0, 0.2),
        st.floats(0, 0.3),
        st.none() | st.sampled_from([0.03, 0.001, 0.0123457, 1 / 3, 50.0]),
    ),
    st.builds(
        lambda q: given_delays(q, 0.005)[1],
        st.lists(st.integers(0, 99), min_size=999, max_size=999),
    ),
)
rules = st.sampled_from([*PACKETS, SignalSemantics(), PlayoutSemantics(0.2), *QUEUES])


@given(law=laws, rule=rules, n_s=periods, n_r=periods, cuts=st.lists(st.integers(0, 140)))
def test_chunks_of_any_size_give_the_same_rows(law, rule, n_s, n_r, cuts):
    cuts = sorted(cuts)
    try:
        table = DrawnTable("x", Grid(n_s, n_r, 0.005), law, rule, 3)
    except ScenarioError:  # a playout that never plays
        return
    whole = table.stream(140).rows(140)
    stream = table.stream(140)
    parts = [stream.rows(b - a) for a, b in zip([0, *cuts], [*cuts, 140], strict=True)]
    assert np.array_equal(np.concatenate(parts), whole)


@pytest.mark.parametrize("n_s, n_r", [(1, 1), (5, 1), (1, 5), (4, 6), (6, 4), (3, 7)])
@pytest.mark.parametrize("T", [0.0, 0.002, 0.005, 0.0125, 0.02, 0.3, 0.3001])
@pytest.mark.parametrize(
    "rule", [*PACKETS, SignalSemantics(), PlayoutSemantics(0.3001), PlayoutSemantics(0.302)]
)
def test_the_least_delay_is_attained(rule, T, n_s, n_r):
    """What is declared is the least delay itself, not only a bound."""
    table = DrawnTable("x", Grid(n_s, n_r, 0.005), Constant(T), rule, 0)
    rows = table.stream().rows(300)
    ages = (n_r * np.arange(300) - n_s * rows)[rows >= 0]
    assert ages.min() == table.minimum_delay_ticks


@pytest.mark.parametrize("n_s, n_r", [(1, 1), (5, 1), (4, 6), (3, 7)])
def test_the_history_of_a_constant_signal_is_used_up(n_s, n_r):
    table = DrawnTable("x", Grid(n_s, n_r, 0.005), Constant(0.32), SignalSemantics(), 0)
    rows = table.stream().rows(300)
    back = (n_r * np.arange(300) // n_s - rows)[rows >= 0]
    assert back.max() + 1 == table.history


@pytest.mark.parametrize("h", [0.005, 0.001, 0.0001, 0.003, 0.0007])
@pytest.mark.parametrize("rule", [*PACKETS, SignalSemantics()])
def test_whole_ticks_stay_whole(rule, h):
    """0.3 s / 5 ms is 60 ticks, and so is every other whole number of ticks."""
    grid = Grid(1, 1, h)
    for ticks in (1, 3, 7, 60, 99, 100, 101, 1023, 4999):
        table = DrawnTable("x", grid, Constant(float(ticks * exact(h))), rule, 0)
        assert table.minimum_delay_ticks == ticks
        rows = table.stream().rows(ticks + 3)
        assert rows.tolist() == [-1] * ticks + [0, 1, 2]


@pytest.mark.parametrize("rule", [*PACKETS[1:], SignalSemantics(), PlayoutSemantics(0.2512)])
def test_a_finer_base_step_changes_nothing(rule):
    """5 ms periods on a base step of 5 ms or of 1 ms are the same link, but for last-arrival."""
    law = Uniform(0.05, 0.4, 0.03)
    coarse = DrawnTable("x", Grid(1, 1, 0.005), law, rule, 2)
    fine = DrawnTable("x", Grid(5, 5, 0.001), law, rule, 2)
    assert coarse.stream().rows(5000).tolist() == fine.stream().rows(5000).tolist()
    assert (coarse.history, 5 * coarse.minimum_delay_ticks) == (
        fine.history,
        fine.minimum_delay_ticks,
    )


def test_a_finer_base_step_tells_arrivals_apart():
    """Sent at 0 and 5 ms, there at 9 and 8 ms: both are seen at 10 ms, and the first came last."""
    law = DelayTrace(np.arange(3), np.array([0.009, 0.003, 1.0]), lookup="index")
    last = PacketSemantics("last-arrival")
    coarse = DrawnTable("x", Grid(1, 1, 0.005), law, last, 0)
    fine = DrawnTable("x", Grid(5, 5, 0.001), law, last, 0)
    assert coarse.stream().rows(3).tolist() == [-1, -1, 1]
    assert fine.stream().rows(3).tolist() == [-1, -1, 0]


def test_no_delay_is_a_wire():
    for rule in (*PACKETS, SignalSemantics(), PlayoutSemantics(0.0)):
        table = DrawnTable("x", Grid(1, 1, 0.005), Constant(0.0), rule, 0)
        assert (table.minimum_delay_ticks, table.history) == (0, 1)
        assert table.stream().rows(5).tolist() == [0, 1, 2, 3, 4]


def test_a_constant_half_tick_does_not_dither():
    table = DrawnTable("x", Grid(1, 1, 0.005), Constant(0.0325), SignalSemantics(), 0)
    assert np.diff(table.stream().rows(100)[10:]).tolist() == [1] * 89


def test_a_buffer_that_covers_the_delays_makes_them_constant():
    law = Uniform(0.3, 1.2, 0.03)
    table = DrawnTable("x", Grid(1, 1, 0.005), law, PlayoutSemantics(1.2), 1)
    rows = table.stream().rows(5000)
    assert rows.tolist() == [max(-1, r - 240) for r in range(5000)]


def test_fifo_and_newest_stamp_never_go_back():
    law = Uniform(0.0, 0.5, 0.01)
    for order in ("fifo", "newest-stamp"):
        rows = (
            DrawnTable("x", Grid(2, 3, 0.005), law, PacketSemantics(order), 1).stream().rows(5000)
        )
        assert np.diff(rows).min() >= 0


def test_lost_packets_are_refused_where_they_have_no_meaning():
    law = DelayTrace(np.array([0.0, 1.0]), np.array([0.1, np.nan]), repeat=True)
    grid = Grid(1, 1, 0.005)
    with pytest.raises(ScenarioError, match=r"packets are lost.*signal"):
        DrawnTable("x", grid, law, SignalSemantics(), 0)
    with pytest.raises(ScenarioError, match=r"packets are lost.*fifo.*reliable"):
        DrawnTable("x", grid, law, PacketSemantics("fifo"), 0)
    for rule in (
        PacketSemantics("last-arrival"),
        PacketSemantics("newest-stamp"),
        PlayoutSemantics(0.1),
    ):
        rows = DrawnTable("x", grid, law, rule, 0).stream().rows(400)
        assert rows.tolist() == [-1] * 20 + list(range(200)) + [199] * 180


@given(seed=st.integers(0, 2**100) | st.sampled_from([0, 2**32 - 1, 2**32, 2**64]), name=st.text())
def test_a_generator_is_seeded_by_the_number_and_the_sum_of_the_name(seed: int, name: str):
    words = np.frombuffer(sha256(name.encode()).digest(), dtype="<u4")
    expected = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *words.tolist()])))
    assert generator(seed, name).random(3).tolist() == expected.random(3).tolist()
