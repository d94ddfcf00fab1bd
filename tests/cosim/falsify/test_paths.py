"""Paths of channels: their pieces, their law, and how they are kept within bounds."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from math import inf
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.falsify.bounds import MovingChannel
from cosim.falsify.paths import Candidate, DelayPath, PathLaw, Piece, as_law
from cosim.links.semantics import Grid, PacketSemantics, SignalSemantics
from cosim.links.spec import delay_law
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


SPEEDS = st.sampled_from([(inf, inf), (0.5, inf), (inf, 1.0), (0.3, 2.0)])


@given(
    path=delay_paths(lost=True),
    periods=st.sampled_from([(5, 5), (1, 5), (5, 2), (3, 7)]),
    speeds=SPEEDS,
)
def test_a_path_and_the_law_that_is_written_down_give_the_same_rows(path, periods, speeds):
    """The law of a search and the law "segments" of the scenario it writes."""
    loses = bool(np.isnan(path.values).any())
    rule = PacketSemantics("last-arrival") if loses else SignalSemantics()
    share = 1.0 if loses else 0.0
    bounds = MovingChannel(
        "c", (0,), (0,), 1, H, 0.0, 0.4, 0.1, speeds=speeds, lost=TICKS, share=share
    )  # fmt: skip
    law = bounds.law(path)
    read = delay_law(written(law, TICKS), Path())
    tables = [DrawnTable("x", Grid(*periods, H), x, rule, 0) for x in (law, read)]
    n = TICKS // periods[1]
    rows = [table.stream().rows(n).tolist() for table in tables]
    assert rows[0] == rows[1]


def written(law, ticks):
    """The table of the law in a scenario."""
    return as_law(law, 0.1, ticks).facts()


def test_a_candidate_is_named_after_what_its_run_follows_from():
    paths = [DelayPath.constant(0.1), DelayPath.of([0, 5], [0.1, 0.2])]
    names = {
        Candidate((a, b), axes, ticks).key
        for a in paths for b in paths for axes in ((), (0.5,), (None,)) for ticks in (10, 20)
    }  # fmt: skip
    assert len(names) == 24
    assert Candidate((paths[0],), (), 10, "a").key == Candidate((paths[0],), (), 10, "b").key


def test_pieces_beyond_the_end_are_left_out():
    path = DelayPath.of([0, 5, 9], [0.1, 0.2, 0.3])
    law = as_law(PathLaw(path, Fraction(1, 10), 0.1, 0.3, False), 0.1, 7)
    assert [(s.begin, s.end, s.delay) for s in law.segments] == [(0.5, 0.7, 0.2)]
    assert all(a.end <= b.begin for a, b in pairwise(law.segments))
