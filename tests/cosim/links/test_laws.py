"""Delay laws: declared facts, draws that chunks do not change, hold intervals to the sample."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import RunError, ScenarioError
from cosim.base.random_numbers import generator
from cosim.links.laws import Constant, Uniform, decimal_fraction
from cosim.links.traces import DelayTrace

TRACE = DelayTrace(np.array([0.0, 0.1, 0.3, 0.35]), np.array([0.2, 0.0, np.nan, 1.5]), repeat=True)
LAWS = [
    Constant(0.1),
    Uniform(0.3, 1.2, 0.03),
    Uniform(0.3, 1.2, 0.0004),
    Uniform(0.3, 1.2),
    Uniform(0.7, 0.7, 1.0),
    TRACE,
    DelayTrace(TRACE.t_send, TRACE.delay, lookup="index", repeat=True),
]
PERIOD = Fraction(5, 1000)


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_declared_facts_hold(law):
    T = law.stream(PERIOD, generator(0, "x")).take(20_000)
    arrives = np.isfinite(T)
    assert arrives.all() != law.loses_packets
    assert law.minimum <= T[arrives].min() <= T[arrives].max() <= law.maximum
    assert T[arrives].max() - T[arrives].min() >= 0.99 * (law.maximum - law.minimum)


@given(law=st.sampled_from(LAWS), cuts=st.lists(st.integers(0, 500), max_size=12))
def test_chunks_do_not_change_the_delays(law, cuts):
    cuts = sorted(cuts)
    whole = law.stream(PERIOD, generator(5, "x")).take(500)
    stream = law.stream(PERIOD, generator(5, "x"))
    parts = [stream.take(b - a) for a, b in zip([0, *cuts], [*cuts, 500], strict=True)]
    assert np.array_equal(np.concatenate(parts), whole, equal_nan=True)


@given(
    period=st.sampled_from([0.005, 0.001, 0.007, 0.0125, 1 / 300]),
    hold=st.sampled_from([0.03, 0.005, 0.1, 0.0007, 1 / 3, 0.0123457, 1.0]),
    start=st.integers(0, 10**6),
)
def test_a_draw_holds_for_exactly_its_interval(period, hold, start):
    """Sample k has draw floor(k·period/hold), in exact arithmetic, late in a run as well."""
    p, q = decimal_fraction(period), decimal_fraction(hold)
    stream = Uniform(0.0, 1.0, hold).stream(p, generator(1, "x"))
    draws = generator(1, "x").random(int((start + 300) * p / q) + 1)
    for n in [*[50_000] * (start // 50_000), start % 50_000]:
        stream.take(n)
    index = [int(k * p / q) for k in range(start, start + 300)]
    assert stream.take(300).tolist() == draws[index].tolist()


def test_units_written_differently_redraw_at_the_same_sample():
    a = Uniform(0.3, 1.2, 0.03).stream(PERIOD, generator(0, "x")).take(5000)
    b = (
        Uniform(0.3, 1.2, 30 * 1e-3)
        .stream(5 * decimal_fraction(1e-3), generator(0, "x"))
        .take(5000)
    )
    assert np.array_equal(a, b)
    assert np.flatnonzero(np.diff(a)).tolist() == list(range(5, 4999, 6))


def test_the_bytes_of_a_seed_are_pinned():
    """A change here changes every recorded run: do not make it by accident."""
    T = Uniform(0.3, 1.2, 0.03).stream(PERIOD, generator(0, "slave.xi->master.xi_in")).take(13)
    assert T[[0, 6, 12]].tolist() == [1.0608499128608002, 1.157534062646739, 0.4160594516526891]


def test_generators_differ_by_seed_and_by_name():
    first = [generator(s, n).random() for s, n in [(0, "a"), (0, "b"), (1, "a"), (0, "ab")]]
    assert len(set(first)) == 4
    assert first[0] == generator(0, "a").random()


def test_a_hold_that_is_absurdly_short_is_refused():
    with pytest.raises(ScenarioError, match="hold = 1e-09 s; expected at least 1/10000"):
        Uniform(0.0, 1.0, 1e-9).stream(PERIOD, generator(0, "x"))


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: Constant(-0.1), "delay = -0.1 s; expected a delay of 0 or more"),
        (lambda: Constant(float("nan")), "delay = nan s"),
        (lambda: Uniform(-1, 1), "low = -1 s"),
        (lambda: Uniform(0, float("inf")), "high = inf s"),
        (lambda: Uniform(0.4, 0.3), "high = 0.3 s is less than low = 0.4 s"),
        (lambda: Uniform(0.3, 0.4, 0.0), "hold = 0 s; expected a time greater than 0"),
        (lambda: Uniform(0.3, 0.4, float("nan")), "hold = nan s"),
    ],
)
def test_what_is_no_law_is_refused(make, message):
    with pytest.raises(ScenarioError, match=message):
        make()


def test_a_trace_is_looked_up_by_time_of_sending():
    T = TRACE.stream(Fraction(1, 20), generator(0, "x")).take(16)
    # rows at 0, .1, .3, .35; the last interval is .05, then it starts again at .4
    once = [0.2, 0.2, 0, 0, 0, 0, np.nan, 1.5]
    assert np.array_equal(T, once * 2, equal_nan=True)


def test_a_trace_counts_from_its_first_row():
    late = DelayTrace(TRACE.t_send + 1e6, TRACE.delay, repeat=True)
    a = TRACE.stream(Fraction(1, 20), generator(0, "x")).take(30)
    b = late.stream(Fraction(1, 20), generator(0, "x")).take(30)
    assert np.array_equal(a, b, equal_nan=True)


def test_a_trace_that_ends_says_so():
    by_time = DelayTrace(TRACE.t_send, TRACE.delay)
    by_index = DelayTrace(TRACE.t_send, TRACE.delay, lookup="index")
    assert by_time.limit(Fraction(1, 20)) == 8
    assert by_time.limit(Fraction(3, 20)) == 3
    assert by_index.limit(Fraction(1, 20)) == 4
    stream = by_index.stream(Fraction(1, 20), generator(0, "x"))
    stream.take(4)
    with pytest.raises(RunError, match="ends after 4 samples"):
        stream.take(1)


@pytest.mark.parametrize(
    "t_send, delay, message",
    [
        ([], [], "row 0: .*not empty"),
        ([0.0], [0.1], "one row has no interval"),
        ([0, 1, 1], [0, 0, 0], "row 2: t_send = 1 s after 1 s; expected increasing"),
        ([0, np.nan], [0, 0], "row 1: t_send = nan s"),
        ([0, 1], [0, -1], "row 1: delay = -1 s; expected 0 or more"),
        ([0, 1], [np.nan, np.inf], "every packet is lost"),
    ],
)
def test_what_is_no_trace_is_refused(t_send, delay, message):
    with pytest.raises(ScenarioError, match=message):
        DelayTrace(np.array(t_send, dtype=float), np.array(delay, dtype=float))


def test_a_trace_does_not_change_behind_its_back():
    delay = np.array([0.1, 0.2])
    law = DelayTrace(np.array([0.0, 1.0]), delay)
    delay[:] = 9.0
    assert law.maximum == 0.2
    with pytest.raises(ValueError, match="read-only"):
        law.delay[0] = 9.0
