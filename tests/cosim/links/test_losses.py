"""Loss models: declared shares and bursts, outages to the sample, and their place on a law."""

from __future__ import annotations

from fractions import Fraction
from math import inf, isnan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import ScenarioError
from cosim.base.random_numbers import generator
from cosim.links.laws import Constant, Uniform, decimal_fraction
from cosim.links.losses import GilbertElliott, Independent, Lossy
from cosim.links.outages import Outage, RandomOutage
from cosim.links.semantics import Grid, PacketSemantics, PlayoutSemantics, SignalSemantics
from cosim.links.table import DrawnTable, statistics
from cosim.links.traces import DelayTrace

PERIOD = Fraction(5, 1000)
GRID = Grid(1, 1, 0.005)
MODELS = [
    Independent(0.0),
    Independent(0.2),
    GilbertElliott(0.01, 0.1),
    GilbertElliott(0.02, 0.25, 0.7, 0.01),
    GilbertElliott(1.0, 1.0),
    GilbertElliott(0.3, 0.7, 0.0, 0.1),
    Outage(0.3, 5.0, 5.0),
    Outage(0.0123, 0.0457, 0.1),
    RandomOutage(0.3, 0.2),
    RandomOutage(0.001, 50.0),
]


def lost(model, n, seed=0, period=PERIOD):
    return model.stream(period, generator(seed, "x")).take(n)


def bursts(losses):
    """Lengths of the runs of lost packets."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], losses.astype(int), [0]))))
    return edges[1::2] - edges[::2]


@pytest.mark.parametrize("model", MODELS, ids=str)
def test_the_declared_share_is_lost(model):
    """Over 4000 s. Tolerance: 5 standard errors of as many bursts, at most 20 % of the share."""
    losses = lost(model, 800_000)
    burst = bursts(losses).mean() if losses.any() else 1
    error = 5 * (model.share * burst / losses.size) ** 0.5
    assert losses.mean() == pytest.approx(model.share, abs=max(error, 1e-9))
    assert error <= 0.2 * model.share


@pytest.mark.parametrize("model", MODELS[1:6], ids=str)
def test_losses_come_in_bursts_of_the_declared_length(model):
    """Mean number of packets lost in a row; tolerance 3 %."""
    assert bursts(lost(model, 800_000)).mean() == pytest.approx(model.burst, rel=0.03)


def test_known_cases_of_gilbert_elliott():
    assert GilbertElliott(0.01, 0.1).burst == pytest.approx(10.0)
    assert GilbertElliott(0.01, 0.1).share == pytest.approx(1 / 11)
    bernoulli = GilbertElliott(0.2, 0.8)
    assert (bernoulli.share, bernoulli.burst) == pytest.approx((0.2, Independent(0.2).burst))
    assert lost(GilbertElliott(1.0, 1.0), 1000).sum() == 500
    silent = GilbertElliott(0.1, 0.1, 0.0, 0.0)
    assert silent.share == 0 and isnan(silent.burst) and silent.longest == 0


def test_a_gilbert_elliott_burst_ends_with_probability_r():
    """Burst lengths of the simple Gilbert model are geometric: P(length > 10) = 0.9^10."""
    lengths = bursts(lost(GilbertElliott(0.05, 0.1), 800_000))
    assert np.mean(lengths > 10) == pytest.approx(0.9**10, abs=0.02)


@given(model=st.sampled_from(MODELS), cuts=st.lists(st.integers(0, 3000), max_size=12))
def test_chunks_do_not_change_the_losses(model, cuts):
    cuts = sorted(cuts)
    stream = model.stream(PERIOD, generator(5, "x"))
    parts = [stream.take(b - a) for a, b in zip([0, *cuts], [*cuts, 3000], strict=True)]
    assert np.array_equal(np.concatenate(parts), lost(model, 3000, seed=5))


@given(
    period=st.sampled_from([0.005, 0.001, 0.007, 1 / 300, 2.5]),
    length=st.sampled_from([0.005, 0.3, 0.25, 0.0123]),
    gap=st.sampled_from([0.005, 0.7, 0.0456, 0.01]),
    start=st.sampled_from([0.0, 0.005, 0.3, 7.1]),
    first=st.integers(0, 10**6),
)
def test_an_outage_begins_and_ends_at_its_sample(period, length, gap, start, first):
    """k is lost where start <= k·period and (k·period - start) mod every < length, exactly."""
    model = Outage(length, round(length + gap, 4), start)
    p, begin, every = (
        decimal_fraction(period),
        decimal_fraction(start),
        decimal_fraction(model.every),
    )
    stream = model.stream(p, generator(0, "x"))
    stream.take(first)
    expected = [
        k * p >= begin and (k * p - begin) % every < decimal_fraction(length)
        for k in range(first, first + 99)
    ]
    assert stream.take(99).tolist() == expected


def test_outages_last_as_long_as_they_say():
    assert set(bursts(lost(Outage(0.3, 5.0, 2.0), 100_000)[:99_000]).tolist()) == {60}
    assert Outage(0.3, 5.0, 2.0).longest == 0.3
    lengths = bursts(lost(RandomOutage(0.3, 0.01), 1_000_000))
    assert set(lengths.tolist()) <= {60, 61} and lengths.size > 30


def test_time_between_random_outages_is_exponential():
    """Rate 2/s, 4000 s: mean 0.5 s and as much standard deviation; tolerance 5 %."""
    losses = lost(RandomOutage(0.1, 2.0), 4_000_000, period=Fraction(1, 1000))
    up = 0.001 * bursts(~losses)
    assert up.mean() == pytest.approx(0.5, rel=0.05)
    assert up.std() == pytest.approx(0.5, rel=0.05)


def test_what_has_no_bound_says_so():
    assert Independent(0.1).longest == GilbertElliott(0.1, 0.1).longest == inf
    assert RandomOutage(0.1, 0.1).longest == inf
    assert Independent(0.0).longest == 0


# on top of a delay law


@pytest.mark.parametrize("model", MODELS, ids=str)
def test_what_arrives_has_the_delays_it_had_without_loss(model):
    law = Uniform(0.3, 1.2, 0.03)
    T = law.stream(PERIOD, generator(3, "x")).take(20_000)
    lossy = Lossy(law, model)
    with_loss = lossy.stream(PERIOD, generator(3, "x")).take(20_000)
    arrives = np.isfinite(with_loss)
    assert np.array_equal(with_loss[arrives], T[arrives])
    assert arrives.all() != lossy.loses_packets
    assert (lossy.minimum, lossy.maximum, lossy.mean) == (0.3, 1.2, 0.75)
    assert lossy.facts() == {**law.facts(), "loss": model.facts()}


@given(model=st.sampled_from(MODELS), cuts=st.lists(st.integers(0, 900), max_size=8))
def test_chunks_do_not_change_lossy_tables(model, cuts):
    cuts = sorted(cuts)
    table = DrawnTable(
        "x", Grid(2, 3, 0.005), Lossy(Uniform(0.0, 0.1), model), PacketSemantics("last-arrival"), 4
    )
    stream = table.stream(900)
    parts = [stream.rows(b - a) for a, b in zip([0, *cuts], [*cuts, 900], strict=True)]
    assert np.array_equal(np.concatenate(parts), table.stream(900).rows(900))


def test_losses_of_a_trace_and_of_a_model_add_up():
    trace = DelayTrace(np.array([0.0, 1.0]), np.array([0.1, np.nan]), lookup="index", repeat=True)
    law = Lossy(trace, Independent(0.5))
    assert law.loses_packets and law.limit(PERIOD) is None
    arrives = np.isfinite(law.stream(PERIOD, generator(0, "x")).take(10_000))
    assert not arrives[1::2].any()
    assert arrives[::2].mean() == pytest.approx(0.5, abs=0.05)
    once = DelayTrace(trace.t_send, trace.delay, lookup="index")
    assert Lossy(once, Independent(0.5)).limit(PERIOD) == 2


@pytest.mark.parametrize("rule", [SignalSemantics(), PacketSemantics("fifo")], ids=str)
def test_rules_that_cannot_lose_refuse_with_a_sentence(rule):
    with pytest.raises(ScenarioError, match="packets are lost, but semantics = "):
        DrawnTable("x", GRID, Lossy(Constant(0.1), Independent(0.1)), rule, 0)
    without = DrawnTable("x", GRID, Lossy(Constant(0.1), Independent(0.0)), rule, 0)
    assert without.stream(100).rows(100).tolist() == [*[-1] * 20, *range(80)]


def test_an_outage_ages_what_is_held_by_its_length():
    """What is sent in [1, 1.3) s is lost: the last sample before gets 300 ms older than 100 ms."""
    law = Lossy(Constant(0.1), Outage(0.3, 5.0, 1.0))
    for rule in (
        PacketSemantics("last-arrival"),
        PacketSemantics("newest-stamp"),
        PlayoutSemantics(0.1),
    ):
        rows = DrawnTable("x", GRID, law, rule, 0).stream(1000).rows(1000)
        assert rows[219:280].tolist() == [199] * 61 and rows[280] == 260
        assert statistics(rows, GRID).age_maximum == pytest.approx(0.1 + 0.3)


def test_lost_packets_are_packets_never_used():
    law = Lossy(Constant(0.1), GilbertElliott(0.02, 0.2))
    rows = DrawnTable("x", GRID, law, PacketSemantics("newest-stamp"), 1).stream().rows(200_000)
    assert statistics(rows, GRID).unused_percent == pytest.approx(100 * law.loss.share, rel=0.1)


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: Independent(1.0), "p = 1; expected a probability from 0 to less than 1"),
        (lambda: Independent(float("nan")), "p = nan"),
        (lambda: GilbertElliott(0.0, 0.1), "p = 0; expected a probability of more than 0"),
        (
            lambda: GilbertElliott(0.1, 1.1),
            "r = 1.1; expected a probability of more than 0, up to 1",
        ),
        (lambda: GilbertElliott(0.1, 0.1, 1.5), "1-h = 1.5; expected a probability from 0 to 1"),
        (lambda: GilbertElliott(0.1, 0.1, 1, 1), "1-k = 1; expected a probability from 0 to less"),
        (lambda: Outage(0.0, 1, 0), "length = 0 s; expected a time"),
        (lambda: Outage(1.0, 1.0, 0), "every = 1 s; expected more than the outage's length, 1 s"),
        (lambda: Outage(0.5, 1.0, -1), "start = -1 s; expected 0 or more"),
        (lambda: RandomOutage(0.5, 0.0), "rate = 0 1/s; expected more than 0"),
        (lambda: RandomOutage(-0.5, 1.0), "length = -0.5 s"),
        (lambda: RandomOutage(1e-9, 1e9).stream(PERIOD, None), "expected at most 10000 outages"),
    ],
)
def test_what_is_no_model_is_refused(make, message):
    with pytest.raises(ScenarioError, match=message):
        make()
