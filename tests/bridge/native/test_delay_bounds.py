"""Delay lines in C: the newest, bounded memory, replay."""

from __future__ import annotations

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from bridge.native import delay as native
from cosim.links.semantics import Grid
from tests.bridge.lines import LOOKS, arrivals, drive, line

# ---- the newest; bounds ----


def test_none_is_the_newest_that_came_whatever_the_time():
    d = line(native.NONE, Grid(1, 1, 0.001), [])
    assert d.take(0) == -1
    d.put(3, 3_000_000, 3_400_000, [3.0])
    d.put(2, 2_000_000, 3_500_000, [2.0])
    assert (d.take(1), d.values().tolist()) == (3, [3.0])


@given(
    kind=st.integers(0, 5),
    puts=st.lists(
        st.tuples(st.integers(-2, 400), st.integers(0, 10**9), st.integers(-(10**9), 10**9)),
        max_size=120,
    ),
    every=st.integers(1, 9),
)
@example(kind=0, puts=[(-2, 0, 0)], every=1)
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
    assert s.newest <= max([-1, *(j for j, _, _ in puts)])
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


def test_a_signal_of_which_too_little_is_kept_stays_and_says_so():
    """Eight samples are kept: the first one goes when the ninth comes, not sooner."""
    grid = Grid(1, 1, 0.001)
    for ticks, held in ((7, 0), (8, -1)):
        d = line(native.SIGNAL, grid, [ticks * 0.001], 8)
        for j in range(ticks + 1):
            d.put(j, j * 10**6, j * 10**6, [float(j)])
            found = d.take(j, j * 10**6)
        assert (found, d.struct.forgotten) == (held, int(held < 0))


def test_put_twice_counts_once():
    d = line(native.LAST, Grid(1, 1, 0.001), [0.0])
    d.put(0, 0, 0, [1.0])
    d.put(0, 0, 500_000, [2.0])
    assert (d.take(5), d.values().tolist(), d.struct.ignored) == (0, [1.0], 1)


def test_delays_begin_again():
    grid = Grid(1, 1, 0.001)
    rows = drive(line(native.LAST, grid, [0.007]), grid, arrivals(grid, [0] * 100))
    assert rows == [-1] * 7 + list(range(33))


def test_reset_forgets():
    grid = Grid(2, 1, 0.001)
    d = line(native.STAMP, grid, [0.003])
    first = drive(d, grid, arrivals(grid, [0] * 50))
    d.reset()
    assert drive(d, grid, arrivals(grid, [0] * 50)) == first
