"""Skewed delays and Markov levels: declared facts, theory, and draws that chunks do not change."""

from __future__ import annotations

from fractions import Fraction
from math import exp

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import ScenarioError
from cosim.base.random_numbers import generator
from cosim.links.distributions import Gamma, Lognormal
from cosim.links.laws import Constant, Uniform
from cosim.links.markov import Chain, Markov, stationary
from cosim.links.semantics import Grid, PacketSemantics, PlayoutSemantics, SignalSemantics
from cosim.links.table import DrawnTable, statistics
from cosim.links.traces import DelayTrace

PERIOD = Fraction(5, 1000)
MARKOV = Markov.dwelling((0.05, 0.1, 0.3), (0.5, 0.2, 0.1), 0.01)
RING = Markov((0.3, 0.1, 0.2), ((0, 1, 0), (0, 0, 1), (1, 0, 0)), 0.007)
CUT = [  # (law, how far the tail goes on beyond what is declared)
    Gamma(0.02, 2.0, 0.01, 0.1),
    Gamma(0.02, 2.0, 0.01, 0.05),
    Gamma(0.0, 0.5, 0.05, 0.1, 0.03),
    Gamma(0.1, 60.0, 0.001, 2.0),
    Lognormal(0.02, 0.03, 0.8, 0.1),
    Lognormal(0.0, 0.03, 2.0, 0.5, 0.0125),
    Lognormal(0.3, 0.1, 0.3, 9.0),
]
LAWS = [*CUT, MARKOV, RING]


def delays(law, n, seed=0):
    return law.stream(PERIOD, generator(seed, "x")).take(n)


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_declared_facts_hold(law):
    T = delays(law, 100_000)
    assert np.isfinite(T).all() and not law.loses_packets
    assert law.minimum <= T.min() and T.max() <= law.maximum
    assert law.limit(PERIOD) is None


@pytest.mark.parametrize("law", CUT, ids=str)
def test_the_mean_of_what_was_cut_is_declared(law):
    """Tolerance: five standard errors of the mean (draws that are held count once)."""
    T = delays(law, 400_000)
    independent = 400_000 if law.hold is None else 400_000 * 0.005 / law.hold
    assert T.mean() == pytest.approx(law.mean, abs=5 * T.std() / independent**0.5)


@pytest.mark.parametrize(
    "law, mean", [(Uniform(0.3, 1.2, 0.03), 0.75), (Constant(0.1), 0.1), (MARKOV, None)]
)
def test_other_laws_declare_their_mean_as_well(law, mean):
    """Tolerance: 1 %, many times what 40 000 draws or 5000 dwell times spread by."""
    assert law.mean == pytest.approx(mean or (0.5 * 0.05 + 0.2 * 0.1 + 0.1 * 0.3) / 0.8)
    assert delays(law, 400_000).mean() == pytest.approx(law.mean, rel=0.02)


def test_a_trace_declares_the_mean_of_what_arrives():
    t_send, delay = np.array([0.0, 0.1, 0.3, 0.35]), np.array([0.2, 0.0, np.nan, 1.5])
    assert DelayTrace(t_send, delay, lookup="index").mean == pytest.approx(1.7 / 3)
    law = DelayTrace(t_send, delay, repeat=True)
    assert law.mean == pytest.approx((0.2 * 0.1 + 0.0 * 0.2 + 1.5 * 0.05) / 0.35)
    T = law.stream(Fraction(1, 1000), generator(0, "x")).take(400)
    assert np.nanmean(T) == pytest.approx(law.mean)


def test_gamma_and_lognormal_without_a_cut_have_their_textbook_moments():
    gamma, lognormal = Gamma(0.01, 3.0, 0.02, 10.0), Lognormal(0.01, 0.05, 0.5, 10.0)
    assert gamma.mean == pytest.approx(0.01 + 3 * 0.02, rel=1e-12)
    assert lognormal.mean == pytest.approx(0.01 + 0.05 * exp(0.125), rel=1e-12)
    T = delays(gamma, 200_000)
    assert T.std() == pytest.approx(3**0.5 * 0.02, rel=0.02)
    T = delays(lognormal, 200_000)
    assert np.median(T) == pytest.approx(0.06, rel=0.01)
    assert np.log(T - 0.01).std() == pytest.approx(0.5, rel=0.01)


def test_the_mean_of_an_exponential_tail_is_its_integral():
    """Gamma with shape 1: ∫_0^c e^(-x/θ) dx = θ(1 - e^(-c/θ))."""
    for c in (1e-4, 0.01, 0.1, 5.0):
        law = Gamma(0.0, 1.0, 0.02, c)
        assert law.mean == pytest.approx(0.02 * (1 - exp(-c / 0.02)), rel=1e-11)


@given(law=st.sampled_from(LAWS), cuts=st.lists(st.integers(0, 500), max_size=12))
def test_chunks_do_not_change_the_delays(law, cuts):
    cuts = sorted(cuts)
    stream = law.stream(PERIOD, generator(5, "x"))
    parts = [stream.take(b - a) for a, b in zip([0, *cuts], [*cuts, 500], strict=True)]
    assert np.array_equal(np.concatenate(parts), delays(law, 500, seed=5))


@pytest.mark.parametrize("law", [CUT[2], CUT[5], MARKOV, RING], ids=str)
def test_a_draw_is_kept_for_its_interval(law):
    """Delays change only at samples that are the first of a hold interval or step."""
    hold = Fraction(str(law.step if isinstance(law, Markov) else law.hold))
    interval = np.array([int(k * PERIOD / hold) for k in range(3000)])
    changes = np.flatnonzero(np.diff(delays(law, 3000)))
    assert changes.size > 10
    assert (np.diff(interval)[changes] > 0).all()


# Markov chains


@st.composite
def chains(draw):
    """An irreducible transition matrix: at least a ring."""
    m = draw(st.integers(2, 5))
    weights = np.array(draw(st.lists(st.integers(0, 3), min_size=m * m, max_size=m * m)), float)
    P = weights.reshape(m, m)
    P[np.arange(m), (np.arange(m) + 1) % m] += 1
    return P / P.sum(axis=1, keepdims=True)


@given(P=chains(), seed=st.integers(0, 99), n=st.integers(0, 300))
def test_a_chain_walks_as_state_by_state(P, seed, n):
    u = generator(seed, "x").random(n)
    state, walked = None, []
    for draw in u:
        row = stationary(P) if state is None else P[state]
        possible = np.flatnonzero(row)
        state = next((b for b in possible if draw < row[: b + 1].sum()), possible[-1])
        walked.append(int(state))
    assert Chain(P, generator(seed, "x")).take(n).tolist() == walked


@given(P=chains())
def test_the_stationary_distribution_stays(P):
    share = stationary(P)
    assert share.sum() == pytest.approx(1.0)
    assert np.allclose(share @ P, share, atol=1e-12)


def test_levels_occur_and_follow_each_other_as_declared():
    """Tolerances: 2 % of all in the shares, 1 % in probabilities, 5 % in mean times."""
    x = np.searchsorted(
        MARKOV.levels, MARKOV.stream(Fraction(1, 100), generator(0, "x")).take(400_000)
    )
    share = np.bincount(x) / x.size
    assert MARKOV.shares == pytest.approx(np.array([0.5, 0.2, 0.1]) / 0.8)
    assert share == pytest.approx(MARKOV.shares, abs=0.02)
    counts = np.zeros((3, 3))
    np.add.at(counts, (x[:-1], x[1:]), 1)
    assert counts / counts.sum(axis=1, keepdims=True) == pytest.approx(
        np.array(MARKOV.transitions), abs=0.01
    )
    ends = np.flatnonzero(np.diff(x))
    lengths, state = np.diff(ends) * 0.01, x[ends[1:]]
    means = [lengths[state == a].mean() for a in range(3)]
    assert means == pytest.approx([0.5, 0.2, 0.1], rel=0.05)


def test_one_dwell_time_stands_for_all_levels():
    a = Markov.dwelling((0.1, 0.2, 0.3), (0.5,), 0.01)
    assert a == Markov.dwelling((0.1, 0.2, 0.3), (0.5, 0.5, 0.5), 0.01)


def test_a_chain_starts_where_it_will_be():
    """x_0 ~ π over seeds; 2000 seeds, tolerance 4 %."""
    first = [delays(MARKOV, 1, seed)[0] for seed in range(2000)]
    shares = [first.count(level) / 2000 for level in MARKOV.levels]
    assert shares == pytest.approx(MARKOV.shares.tolist(), abs=0.04)


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: Gamma(-1, 1, 1, 1), "shift = -1 s; expected a delay of 0"),
        (lambda: Gamma(0.1, 0, 1, 1), "shape = 0; expected more than 0"),
        (lambda: Gamma(0.1, 1, float("nan"), 1), "scale = nan s; expected more"),
        (lambda: Gamma(0.1, 1, 1, 0.1), "maximum = 0.1 s is not more than shift = 0.1 s"),
        (lambda: Gamma(0.1, 1, 1, float("inf")), "maximum = inf s; expected a delay"),
        (lambda: Gamma(0.1, 1, 1, 1, 0.0), "hold = 0 s; expected a time"),
        (lambda: Lognormal(0.1, 0, 1, 1), "median = 0 s; expected more than 0"),
        (lambda: Lognormal(0.1, 1, -1, 1), "sigma = -1; expected more than 0"),
        (lambda: Lognormal(0.1, 1, 11, 1), "sigma = 11; expected at most 10"),
        (lambda: Markov((0.1,), ((1,),), 1), "1 levels; expected two or more"),
        (lambda: Markov((0.1, -1), ((1, 0), (0, 1)), 1), r"levels\[1\] = -1 s"),
        (lambda: Markov((0.1, 0.2), ((0.5, 0.5),), 1), "1 rows.*expected 2 rows of 2"),
        (lambda: Markov((0.1, 0.2), ((0.5, 0.5), (1,)), 1), r"\[2, 1\] values; expected 2 rows"),
        (lambda: Markov((0.1, 0.2), ((0.5, 0.4), (1, 0)), 1), r"transitions\[0\].*sum to 1"),
        (lambda: Markov((0.1, 0.2), ((0.5, 0.5), (2, -1)), 1), r"transitions\[1\].*sum to 1"),
        (lambda: Markov((0.1, 0.2), ((0.5, 0.5), (0, 1)), 1), r"levels\[0\] is never reached from"),
        (lambda: Markov((0.1, 0.2), ((0, 1), (1, 0)), 0), "step = 0 s; expected a time"),
        (lambda: Markov.dwelling((0.1, 0.2), (1, 1, 1), 0.1), "3 dwell times for 2 levels"),
        (
            lambda: Markov.dwelling((0.1, 0.2), (0.05,), 0.1),
            "dwell = 0.05 s; expected at least one",
        ),
        (lambda: Markov.dwelling((0.1, 0.2), (float("inf"),), 0.1), "dwell = inf s"),
    ],
)
def test_what_is_no_law_is_refused(make, message):
    with pytest.raises(ScenarioError, match=message):
        make()


def test_a_step_that_is_absurdly_short_is_refused():
    with pytest.raises(ScenarioError, match="step = 1e-09 s; expected at least 1/10000"):
        Markov.dwelling((0.1, 0.2), (1.0,), 1e-9).stream(PERIOD, generator(0, "x"))


@pytest.mark.parametrize(
    "rule", [SignalSemantics(), PacketSemantics("last-arrival"), PlayoutSemantics(0.15)], ids=str
)
@pytest.mark.parametrize("law", [CUT[0], CUT[2], CUT[5], MARKOV, RING], ids=str)
def test_tables_keep_what_they_declare(law, rule):
    """No row is younger than declared, no new one older than the history reaches."""
    table = DrawnTable("x", Grid(2, 3, 0.005), law, rule, 0)
    rows = table.stream().rows(10_000)
    age = 3 * np.arange(10_000) - 2 * rows
    new = np.diff(rows, prepend=-1) != 0
    assert age[rows >= 0].min() >= table.minimum_delay_ticks
    assert age[new & (rows >= 0)].max() < 2 * table.history


def test_jitter_reorders_packets_and_levels_rarely_do():
    """The same mean and bounds: redrawn every packet, `last-arrival` often goes back in time."""
    grid = Grid(1, 1, 0.005)
    often, rarely = (
        statistics(
            DrawnTable("x", grid, law, PacketSemantics("last-arrival"), 0).stream().rows(20_000),
            grid,
        )
        for law in (Gamma(0.05, 1.0, 0.05, 0.3), Markov.dwelling((0.05, 0.3), (1.0,), 0.005))
    )
    assert often.backwards_percent > 10
    assert 0 < rarely.backwards_percent < 1
