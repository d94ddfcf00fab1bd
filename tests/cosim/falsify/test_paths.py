"""Paths of channels: their pieces, their law, and how they are kept within bounds."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from math import inf

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.falsify.bounds import MovingChannel
from cosim.falsify.paths import Candidate, DelayPath, Piece, as_law
from cosim.links.semantics import Grid, PacketSemantics, SignalSemantics
from cosim.links.table import DrawnTable

H, TICKS = 0.001, 600
CHANNEL = MovingChannel("c", (0,), (0,), 5, H, 0.02, 0.2, 0.1)


@st.composite
def delay_paths(draw, lost=False):
    edges = [0, *draw(st.lists(st.integers(1, TICKS - 1), max_size=9, unique=True).map(sorted))]
    value = st.sampled_from([0.0, 0.02, 0.0375, 0.1, 0.2, 0.4, *([float("nan")] * 2 * lost)])
    return DelayPath.of(edges, [draw(value) for _ in edges])


def dense(path):
    return path.at(np.arange(TICKS))


def test_equal_neighbours_are_one_piece():
    path = DelayPath.of([0, 3, 5, 5, 9], [0.1, 0.1, 0.7, 0.2, np.nan])
    assert path.edges.tolist() == [0, 5, 9]
    assert path.pieces(0.1, 20) == [
        Piece(5, 9, 0.2),
        Piece(9, 20, pytest.approx(np.nan, nan_ok=True)),
    ]


@given(path=delay_paths(lost=True))
def test_pieces_make_the_path_again(path):
    again = DelayPath.changed(0.1, path.pieces(0.1, TICKS))
    assert np.array_equal(dense(again), dense(path), equal_nan=True)


@given(path=delay_paths(lost=True), periods=st.sampled_from([(5, 5), (1, 5), (5, 2), (3, 7)]))
def test_a_path_and_the_law_that_is_written_down_give_the_same_rows(path, periods):
    """The law of a search and the law "segments" of the scenario it writes."""
    loses = bool(np.isnan(path.values).any())
    rule = PacketSemantics("last-arrival") if loses else SignalSemantics()
    grid, h = Grid(*periods, H), Fraction(1, 1000)
    share = 1.0 if loses else 0.0
    bounds = MovingChannel("c", (0,), (0,), 1, H, 0.0, 0.4, 0.1, lost=TICKS, share=share)
    written = as_law(path, 0.1, h, TICKS)
    tables = [DrawnTable("x", grid, law, rule, 0) for law in (bounds.law(path), written)]
    n = TICKS // periods[1]
    rows = [table.stream().rows(n).tolist() for table in tables]
    assert rows[0] == rows[1]


@given(path=delay_paths(lost=True), lost=st.integers(0, 6), share=st.sampled_from([0.02, 0.3, 1.0]))
def test_losses_are_no_longer_and_no_more_than_they_may_be(path, lost, share):
    bounds = MovingChannel(
        "c", (0,), (0,), 5, H, 0.02, 0.2, 0.1, lost=lost, share=share if lost else 0.0
    )  # fmt: skip
    found = np.isnan(dense(bounds.kept(path, TICKS)))
    edges = np.flatnonzero(np.diff(np.concatenate(([0], found, [0]))))
    assert (edges[1::2] - edges[::2]).max(initial=0) <= lost * 5
    assert found.sum() <= share * TICKS
    if lost == 6 and share == 1.0:
        asked = np.isnan(dense(path))
        assert found.any() == asked.any()


@given(path=delay_paths(), rate=st.sampled_from([0.5, 2.0, inf]), reorder=st.booleans())
def test_a_path_keeps_to_its_bounds_and_rates(path, rate, reorder):
    bounds = MovingChannel("c", (0,), (0,), 5, H, 0.02, 0.2, 0.1, rate=rate, reorder=reorder)
    kept = bounds.kept(path, TICKS)
    values = dense(kept)
    assert values.min() >= 0.02 and values.max() <= 0.2
    change = np.diff(values[::5]) / (5 * H)
    assert change.max(initial=0) <= rate + 1e-3
    assert change.min(initial=0) >= -(rate if reorder else min(rate, 1.0)) - 1e-3
    if rate == inf and reorder:
        assert np.array_equal(values, np.clip(dense(path), 0.02, 0.2))


def test_without_reordering_no_packet_overtakes():
    bounds = MovingChannel("c", (0,), (0,), 5, H, 0.02, 0.2, 0.1, reorder=False)
    path = bounds.kept(DelayPath.of([0, 100, 300], [0.2, 0.02, 0.2]), TICKS)
    sent = np.arange(0, TICKS, 5)
    arrives = sent * H + path.at(sent)
    assert (np.diff(arrives) >= -1e-9).all()
    assert path.at(np.array([299]))[0] == 0.02  # it gets there


def test_a_candidate_is_named_after_what_its_run_follows_from():
    paths = [DelayPath.constant(0.1), DelayPath.of([0, 5], [0.1, 0.2])]
    names = {
        Candidate((a, b), axes, ticks).key
        for a in paths for b in paths for axes in ((), (0.5,), (None,)) for ticks in (10, 20)
    }  # fmt: skip
    assert len(names) == 24
    assert Candidate((paths[0],), (), 10, "a").key == Candidate((paths[0],), (), 10, "b").key


def test_pieces_beyond_the_end_are_left_out():
    law = as_law(DelayPath.of([0, 5, 9], [0.1, 0.2, 0.3]), 0.1, Fraction(1, 10), 7)
    assert [(s.begin, s.end, s.delay) for s in law.segments] == [(0.5, 0.7, 0.2)]
    assert all(a.end <= b.begin for a, b in pairwise(law.segments))
