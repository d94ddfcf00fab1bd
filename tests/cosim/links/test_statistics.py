"""Ages, held and back-in-time shares; and the published ones of the five semantics."""

from __future__ import annotations

import tracemalloc
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import astuple

from cosim.links.laws import Uniform
from cosim.links.semantics import Grid, PacketSemantics, PlayoutSemantics, SignalSemantics
from cosim.links.table import Ages, DrawnTable, statistics

PAPER = Uniform(0.3, 1.2, 0.03)  # 5 ms samples
GRID = Grid(1, 1, 0.005)


def measured(rule, law=PAPER, rows=4_000_000):
    """Statistics over 20 000 s (or fewer rows of 5 ms)."""
    return statistics(DrawnTable("x", GRID, law, rule, 0).stream(rows).rows(rows), GRID)


@pytest.mark.parametrize(
    "rule, mean, p5, p95, backwards, held",
    [
        (SignalSemantics(), 0.750, 0.345, 1.155, 8.0, 0.0),
        (PacketSemantics("last-arrival"), 0.712, 0.340, 1.155, 6.5, 36.0),
        (PacketSemantics("newest-stamp"), 0.474, 0.335, 0.650, 0.0, 78.0),
        (PacketSemantics("fifo"), 1.031, 0.860, 1.170, 0.0, 78.0),
        (PlayoutSemantics(1.2), 1.200, 1.200, 1.200, 0.0, 0.0),
    ],
)
def test_the_five_semantics_have_the_ages_they_should(rule, mean, p5, p95, backwards, held):
    """U[0.3, 1.2] s redrawn every 30 ms, 5 ms samples, 20 000 s.

    Tolerances: 3 ms in the mean (it spreads by 0.5 ms over seeds), one sample in percentiles,
    half a percent of the rows (they are given to that).
    """
    s = measured(rule)
    assert s.age_mean == pytest.approx(mean, abs=0.003)
    assert s.age_p5 == pytest.approx(p5, abs=0.0051)
    assert s.age_p95 == pytest.approx(p95, abs=0.0051)
    assert s.backwards_percent == pytest.approx(backwards, abs=0.5)
    assert s.held_percent == pytest.approx(held, abs=0.5)


def test_independent_draws_make_the_newest_stamp_younger():
    s = measured(PacketSemantics("newest-stamp"), Uniform(0.3, 1.2), rows=1_000_000)
    assert s.age_mean == pytest.approx(0.382, abs=0.003)


def test_a_buffer_of_one_second_is_late_as_often_as_the_law_is():
    """P(T > 1.0) = 0.2/0.9 = 22 %, and then it holds."""
    s = measured(PlayoutSemantics(1.0))
    assert s.held_percent == pytest.approx(100 * 0.2 / 0.9, abs=0.5)
    assert s.backwards_percent == 0.0


def test_waiting_counts_the_rows_before_the_first_sample():
    whole = measured(PlayoutSemantics(1.2), rows=2400)
    assert whole.waiting_percent == pytest.approx(10.0)
    assert whole.age_maximum == pytest.approx(1.2)


rows = st.lists(st.integers(-1, 12), min_size=1, max_size=80)


@given(values=rows, n_s=st.integers(1, 4), n_r=st.integers(1, 4), cut=st.integers(0, 80))
def test_statistics_are_the_plain_ones(values, n_s, n_r, cut):
    """Against the definitions, row by row; counting in two chunks changes nothing."""
    sent = np.array(values)
    tick = n_r * np.arange(sent.size)
    sent = np.minimum(sent, tick // n_s)
    ages = (tick - n_s * sent)[sent >= 0] * 0.005
    counted = Ages((Grid(n_s, n_r, 0.005),), (80 * n_r,))
    for part in (sent[:cut], sent[cut:]):
        counted.add(part.astype(np.int32), np.array([part.size]))
    (s,) = counted.results()
    received = sent[sent >= 0]
    assert s.rows == sent.size
    assert s.waiting_percent == pytest.approx(100 * np.mean(sent < 0))
    if not received.size:
        assert np.isnan(s.age_mean) and np.isnan(s.age_p95)
        return
    assert s.age_mean == pytest.approx(ages.mean())
    for percent, value in [(5, s.age_p5), (50, s.age_p50), (95, s.age_p95), (99, s.age_p99)]:
        assert value == pytest.approx(np.percentile(ages, percent, method="inverted_cdf"))
    assert s.age_maximum == pytest.approx(ages.max())
    unused = set(range(received.max() + 1)) - set(received.tolist())
    assert s.unused_percent == pytest.approx(100 * len(unused) / (received.max() + 1))
    steps = np.diff(received)
    if steps.size:
        assert s.held_percent == pytest.approx(100 * np.mean(steps == 0))
        assert s.backwards_percent == pytest.approx(100 * np.mean(steps < 0))


@st.composite
def tables(draw):
    """Rows of up to four tables, their grids, and how far back they hold what is new."""
    made = []
    for _ in range(draw(st.integers(1, 4))):
        grid = Grid(draw(st.integers(1, 4)), draw(st.integers(1, 4)), 0.005)
        back = np.array(draw(st.lists(st.integers(0, 12), min_size=1, max_size=60)))
        newest = grid.n_r * np.arange(back.size) // grid.n_s
        made.append((np.maximum(newest - back, -1).astype(np.int32), grid, int(back.max()) + 1))
    return made


@given(made=tables(), cuts=st.lists(st.integers(0, 60), max_size=3))
def test_tables_are_counted_together_as_each_by_itself(made, cuts):
    """Also if it is only remembered what a row may newly hold, and in chunks of any size."""
    counted = Ages([grid for _, grid, _ in made], [history for *_, history in made])
    for first, last in pairwise((0, *sorted(cuts), 60)):
        parts = [rows[first:last] for rows, *_ in made]
        counted.add(np.concatenate(parts), np.array([part.size for part in parts]))
    for found, (rows, grid, _) in zip(counted.results(), made, strict=True):
        assert astuple(found) == pytest.approx(astuple(statistics(rows, grid)), nan_ok=True, rel=0)


def test_what_is_remembered_does_not_grow_with_the_run():
    ages, rng, most = Ages((GRID, GRID), (30, 30)), np.random.default_rng(0), 0
    tracemalloc.start()
    for start in range(0, 200_000, 1000):
        back = rng.integers(0, 30, (2, 1000))
        rows = np.maximum(np.arange(start, start + 1000) - back, -1).astype(np.int32)
        ages.add(rows.ravel(), np.array([1000, 1000]))
        most = max(most, tracemalloc.get_traced_memory()[0])
        if start == 10_000:
            early = most
    tracemalloc.stop()
    assert most < early + 10_000


def test_a_table_of_the_future_is_refused():
    with pytest.raises(ValueError, match="not sent yet"):
        statistics([0, 0, 2], Grid(2, 1, 0.005))
    assert statistics([0, 0, 1], Grid(2, 1, 0.005)).age_maximum == 0.005


def test_unused_is_exact_far_beyond_what_is_remembered():
    """Every third sample is used: two thirds are not, over millions of them."""
    grid = Grid(1, 3, 0.005)
    s = statistics(3 * np.arange(1_000_000), grid)
    assert s.unused_percent == pytest.approx(100 * 2 / 3, abs=1e-3)
