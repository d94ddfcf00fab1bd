"""The tc netem line of each law, its stated differences, and the distribution tables."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.errors import ScenarioError
from cosim.links.distributions import Gamma, Lognormal
from cosim.links.laws import Constant, Uniform
from cosim.links.losses import GilbertElliott, Independent, Lossy
from cosim.links.markov import Markov
from cosim.links.netem import distribution_table, netem
from cosim.links.outages import Outage, RandomOutage
from cosim.links.traces import DelayTrace

PAPER = Uniform(0.3, 1.2, 0.03)
MARKOV = Markov.dwelling((0.2, 0.05), (0.5, 2.0), 0.01)
TRACE = DelayTrace(np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.1, np.nan, 0.1, 0.4]), repeat=True)
TABLES = [Gamma(0.02, 2.0, 0.005, 0.2, 0.03), Lognormal(0.02, 0.008, 0.8, 0.2), MARKOV, TRACE]


def line(law, loss=None, **period):
    return netem(law, loss, **period).splitlines()[0]


def remarks(law, loss=None, **period):
    rest = netem(law, loss, **period).splitlines()[1:]
    assert all(text.startswith("# ") for text in rest)
    return " ".join(rest)


@pytest.mark.parametrize(
    "law, loss, expected",
    [
        (Constant(0.1), None, "delay 100ms"),
        (Constant(0.0), None, "delay 0ms"),
        (Uniform(0.3, 0.3), None, "delay 300ms"),
        (PAPER, None, "delay 750ms 450ms"),
        (Uniform(0.0101, 0.0104), None, "delay 10.25ms 0.15ms"),
        (Constant(0.1), Independent(0.01), "delay 100ms loss random 1%"),
        (Constant(0.1), GilbertElliott(0.01, 0.1), "delay 100ms loss gemodel 1% 10% 100% 0%"),
        (
            PAPER,
            GilbertElliott(0.012, 0.3, 0.7, 0.001),
            "delay 750ms 450ms loss gemodel 1.2% 30% 70% 0.1%",
        ),
        (MARKOV, None, "delay 80ms 30.0075019ms distribution markov"),
        (TRACE, None, "delay 200ms 50.0125031ms distribution trace loss random 25%"),
    ],
)
def test_the_first_line_is_arguments(law, loss, expected):
    assert line(law, loss) == expected


def test_a_law_that_brings_its_loss_is_the_same_line():
    loss = GilbertElliott(0.01, 0.1)
    assert netem(Lossy(PAPER, loss), period=0.005) == netem(PAPER, loss, period=0.005)
    with pytest.raises(ScenarioError, match="netem supports one loss"):
        netem(Lossy(PAPER, loss), loss)


def test_what_netem_does_exactly_needs_no_remark():
    assert netem(Constant(0.1), GilbertElliott(0.01, 0.1), period=0.005).count("\n") == 0
    assert netem(Uniform(0.1, 0.104), period=0.005).count("\n") == 0


@pytest.mark.parametrize(
    "law, loss, words",
    [
        (PAPER, None, "netem draws for every packet; this law keeps a draw for 30ms"),
        (PAPER, None, "up to 900ms: netem lets packets overtake each other"),
        (PAPER, None, "fifo: add rate 1gbit"),
        (Gamma(0.02, 2.0, 0.005, 0.2, 0.03), None, "keeps a draw for 30ms"),
        (Gamma(0.02, 2.0, 0.005, 0.2), None, "a file gamma.dist for this law"),
        (Lognormal(0.02, 0.01, 0.8, 0.2), None, "a file lognormal.dist for this law"),
        (MARKOV, None, "not how long it lasts: it has no chain"),
        (TRACE, None, "not their order"),
        (TRACE, None, "one independent of the other"),
        (TRACE, Independent(0.1), "the losses of the trace itself are left out"),
        (Uniform(0.0, 6.0), None, "netem cuts a jitter of 3000ms to 2147.48365ms"),
        (Constant(0.1), Outage(0.3, 5.0, 0.0), "300ms every 5000ms; have a script set loss 100%"),
        (Constant(0.1), RandomOutage(0.3, 0.2), "300ms at random, 0.2 a second; have a script"),
    ],
)
def test_what_netem_does_otherwise_is_said(law, loss, words):
    assert words in remarks(law, loss)


def test_packets_overtake_only_where_jitter_exceeds_their_gap():
    assert "up to 5ms, more than the 2ms between" in remarks(Uniform(0.1, 0.105), period=0.002)
    assert "overtake" not in remarks(Uniform(0.1, 0.105), period=0.005)
    assert "overtake" not in remarks(Constant(0.1), period=0.001)


def test_the_queue_holds_what_is_on_its_way():
    """1.2 s of packets every 1 ms are more than netem's 1000."""
    assert line(PAPER, period=0.001) == "limit 1201 delay 750ms 450ms"
    assert "up to 1201 packets wait at once" in remarks(PAPER, period=0.001)
    assert line(PAPER, period=0.005) == line(PAPER)


def test_outages_become_bursts_where_the_period_is_known():
    """r = period/length; p: outages begin at their rate per up-time."""
    assert line(Constant(0.1), RandomOutage(0.3, 0.2), period=0.005) == (
        "delay 100ms loss gemodel 0.09995% 1.66667% 100% 0%"
    )
    regular = line(Constant(0.1), Outage(0.3, 5.3, 0.0), period=0.005)
    assert regular == line(Constant(0.1), RandomOutage(0.3, 0.2), period=0.005)
    assert "exactly 300ms every 5300ms; in netem 60 packets in the mean" in remarks(
        Constant(0.1), Outage(0.3, 5.3, 0.0), period=0.005
    )


def test_a_period_that_is_no_time_is_refused():
    with pytest.raises(ScenarioError, match="period = 0 s; expected more than 0"):
        netem(PAPER, period=0.0)


def delays_of(law):
    """What netem makes of a table: mean + jitter·entry/8192, (4096,), s."""
    rows = [r for r in distribution_table(law).splitlines() if not r.startswith("#")]
    entries = np.array([int(entry) for row in rows for entry in row.split()])
    assert entries.shape == (4096,) and entries.min() >= -(2**15) and entries.max() < 2**15
    _, mean, jitter, *_ = line(law).split()
    return 1e-3 * (float(mean[:-2]) + float(jitter[:-2]) * entries / 8192)


@pytest.mark.parametrize("law", TABLES, ids=str)
def test_tables_have_the_distribution_of_their_law(law):
    """Mean to 0.5 % of the jitter's reach; quantiles against 100 000 draws, to 2 % of it."""
    T, reach = delays_of(law), law.maximum - law.minimum
    assert law.minimum - 1e-4 * reach <= T.min() and T.max() <= law.maximum + 1e-4 * reach
    assert T.mean() == pytest.approx(law.mean, abs=0.005 * reach)
    if isinstance(law, Gamma | Lognormal):
        free = type(law)(**{k: v for k, v in law.facts().items() if k not in ("law", "hold")})
        draws = free.stream(1, np.random.default_rng(1)).take(100_000)
        for share in (0.05, 0.5, 0.95):
            assert np.quantile(T, share) == pytest.approx(
                np.quantile(draws, share), abs=0.02 * reach
            )


def test_tables_of_levels_have_their_shares():
    T = delays_of(MARKOV)
    assert np.mean(T > 0.125) == pytest.approx(0.2, abs=1e-3)
    T = delays_of(TRACE)
    assert np.mean(T > 0.25) == pytest.approx(1 / 3, abs=1e-3)


@pytest.mark.parametrize("law", [PAPER, Constant(0.1), Lossy(PAPER, Independent(0.1))])
def test_laws_that_netem_knows_need_no_table(law):
    with pytest.raises(ScenarioError, match="netem needs no table for law"):
        distribution_table(law)
