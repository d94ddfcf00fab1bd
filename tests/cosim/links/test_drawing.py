"""Rows drawn in C equal those of NumPy: for any law, rule, seed and border between chunks."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cosim.base.errors import RunError, ScenarioError
from cosim.base.random_numbers import entropy
from cosim.links import drawing
from cosim.links.distributions import Normal
from cosim.links.drawing import TableDrawing
from cosim.links.laws import Constant, Uniform
from cosim.links.losses import GilbertElliott, Independent, Lossy
from cosim.links.semantics import Grid, PacketSemantics, PlayoutSemantics, SignalSemantics
from cosim.links.table import DrawnTable
from cosim.links.traces import DelayTrace
from tests.cosim.links.numpy_rows import rows_of
from tests.cosim.links.queues import QUEUES

RULES = (
    SignalSemantics(),
    PacketSemantics("last-arrival"),
    PacketSemantics("newest-stamp"),
    PacketSemantics("fifo"),
    PlayoutSemantics(0.0),
    PlayoutSemantics(0.031),
    PlayoutSemantics(0.2),
    *QUEUES,
)
seeds = st.integers(0, 99) | st.integers(2**31, 2**33) | st.integers(0, 2**200)
holds = st.none() | st.sampled_from([0.03, 0.005, 0.0007, 1 / 3, 0.0123457]) | st.floats(1e-3, 9)
plain = st.builds(Constant, st.floats(0, 0.4)) | st.builds(
    lambda low, width, hold: Uniform(low, low + width, hold),
    st.floats(0, 0.2), st.just(0.0) | st.floats(0, 0.3), holds,
)  # fmt: skip
losses = st.sampled_from([*map(Independent, (0.0, 0.1, 0.9)), GilbertElliott(0.1, 0.3)])
other = st.sampled_from([
    Normal(0.1, 0.05, 0.02, 0.3, 0.03),
    DelayTrace(np.array([0.0, 0.1, 0.3]), np.array([0.2, np.nan, 0.0]), repeat=True),
])  # fmt: skip
laws = plain | other | st.builds(Lossy, plain | other, losses)
periods = st.integers(1, 7)
kinds = st.tuples(laws, st.sampled_from(RULES), periods, periods, st.sampled_from([0.005, 0.001]))


@st.composite
def alike(draw):
    """Up to six tables, some with one law, rule and grid."""
    chosen = draw(st.lists(kinds, min_size=1, max_size=3))
    made = []
    for name in "abcdef"[: draw(st.integers(1, 6))]:
        law, rule, n_s, n_r, h = draw(st.sampled_from(chosen))
        try:
            made.append(DrawnTable(name, Grid(n_s, n_r, h), law, rule, draw(seeds)))
        except ScenarioError:  # the rule rejects losses, or plays nothing
            made.append(DrawnTable(name, Grid(n_s, n_r, h), Constant(0.0), RULES[0], 0))
    return made


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    tables=alike(),
    cuts=st.lists(st.integers(0, 300), max_size=5),
    room=st.sampled_from([1, 99]),
)
def test_rows_are_numpys(tables, cuts, room, monkeypatch):
    monkeypatch.setattr(drawing, "ROOM", room)
    cuts = [0, *sorted(cuts), 300]
    drawn = TableDrawing(tables)
    expected = [rows_of(table) for table in tables]
    for first, last in pairwise(cuts):
        counts = np.array([(last - first) * (1 + i % 2) for i in range(len(tables))])
        firsts = np.cumsum(counts) - counts
        rows = np.full(counts.sum() + 1, -9, np.int32)
        drawn.fill(rows, firsts, counts)
        assert rows[-1] == -9
        for first_row, n, stream in zip(firsts, counts, expected, strict=True):
            assert rows[first_row:][:n].tolist() == stream.take(int(n)).tolist()


@pytest.mark.parametrize("rule", RULES, ids=str)
@pytest.mark.parametrize("n_s, n_r", [(1, 1), (5, 1), (1, 5), (3, 2)])
@pytest.mark.parametrize("law", [Uniform(0.0, 0.3, 0.03), Normal(0.1, 0.05, 0.0, 0.2)], ids=str)
def test_working_in_blocks_does_not_show(rule, n_s, n_r, law, monkeypatch):
    """Rows across several blocks of C and of NumPy."""
    monkeypatch.setattr(drawing, "BLOCK", 3000)
    table = DrawnTable("x", Grid(n_s, n_r, 0.005), law, rule, 7)
    assert np.array_equal(table.stream(7_000).rows(7_000), rows_of(table).take(7_000))


@pytest.mark.parametrize("rule", [RULES[1], QUEUES[0]], ids=["last-arrival", "queue"])
def test_more_rows_than_16_bits_count_are_numpys(rule):
    table = DrawnTable("x", Grid(3, 2, 0.005), Normal(0.1, 0.05, 0.0, 0.2), rule, 7)
    n = 2 * drawing.BLOCK + 2**15
    assert np.array_equal(table.stream(n).rows(n), rows_of(table).take(n))


@given(seed=seeds, name=st.text(max_size=5))
def test_generators_are_seeded_as_numpy_does(seed, name):
    law = Lossy(Uniform(0, 1), Independent(0.5))
    table = DrawnTable(name, Grid(1, 1, 1.0), law, RULES[1], seed)
    state = TableDrawing([table])._state
    words = np.frombuffer(entropy(seed, name), "<u4").astype(np.uint32)
    sequence = np.random.SeedSequence(words)
    for key, own in (("delay", sequence), ("loss", sequence.spawn(1)[0])):
        found = np.random.PCG64(own).state["state"]
        for field, value in (("state", found["state"]), ("increment", found["inc"])):
            assert state[key][field][0].tolist() == [value >> 64, value % 2**64]


@pytest.mark.parametrize("rule", [RULES[1], QUEUES[0]], ids=["last-arrival", "queue"])
def test_a_delay_that_its_law_rules_out_stops_the_run(rule):
    class Wrong:
        def __init__(self, delay):
            self.delay = delay

        def __getattr__(self, name):
            return getattr(Normal(0.1, 0.05, 0.0, 0.2), name)

        def stream(self, period, rng):
            return self

        def take(self, n):
            return np.full(n, self.delay)

    for wrong in (-0.1, 9.0):
        table = DrawnTable("a->b", Grid(1, 1, 0.005), Wrong(wrong), rule, 0)
        with pytest.raises(RunError, match="link a->b: a delay that its law rules out"):
            table.stream().rows(2000)
        other = DrawnTable("other", Grid(1, 1, 0.005), Wrong(0.1), rule, 0)
        with pytest.raises(RunError, match="link a->b: a delay that its law rules out"):
            TableDrawing((other, table)).take(2000)


@pytest.mark.parametrize("rule", RULES[1:4], ids=str)
def test_a_delay_of_so_many_ticks_that_the_tolerance_is_lost_is_not_a_tick_longer(rule):
    """2^25 ticks less 1e-9 are 2^25 in double precision."""
    table = DrawnTable("x", Grid(2**20, 2**20, 2.0**-10), Constant(2.0**15), rule, 0)
    assert table.stream().rows(40).tolist() == [-1] * 32 + list(range(8))


def test_no_memory_is_asked_for_that_packets_do_not_need():
    """A law may allow for a delay of years."""
    table = DrawnTable("x", Grid(1, 1, 1e-3), Normal(1.0, 0.1, 0.0, 2e6), RULES[2], 0)
    drawn = TableDrawing([table])
    rows = np.empty(5000, np.int32)
    drawn.fill(rows, np.zeros(1, int), np.array([5000]))
    assert rows.tolist() == rows_of(table).take(5000).tolist()
    assert drawn._state["capacity"][0] < 20_000
