"""Networks by name and the laws that published studies use: facts, theory, and statistics."""

from __future__ import annotations

from fractions import Fraction
from math import exp
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.base.errors import ScenarioError
from cosim.base.random_numbers import generator
from cosim.cli.delays import figures, figures_of_preset
from cosim.links.distributions import Gamma, Hyperexponential, Normal
from cosim.links.laws import Constant, Sum, Uniform
from cosim.links.losses import Independent, Lossy, ParetoBursts
from cosim.links.netem import netem
from cosim.links.outages import UniformOutage
from cosim.links.presets import PRESETS, preset
from cosim.links.spec import delay_law, loss_model
from tests.cosim.links.tables import table_of

PERIOD = Fraction(5, 1000)
LAWS = [
    Normal(0.1, 0.025, 0.0, 0.25),
    Normal(0.01, 0.03, 0.0, 0.05, 0.03),
    Hyperexponential(0.07, (0.72645, 0.27355), (1e-3 / 0.02711, 1e-3 / 0.08529), 1.0),
    Hyperexponential(0.0, (0.5, 0.5), (0.01, 0.2), 0.15, 0.02),
    Sum((Constant(0.02), Gamma(0.0, 1.0, 0.002, 0.04), Uniform(0.0, 0.01, 0.03))),
]
MODELS = [
    ParetoBursts((0.95, 0.9), (4.428, 4.966), (1.638, 0.271)),
    ParetoBursts((0.95, 0.9), (3.859, 3.797), (3.324, 6.049)),
    ParetoBursts((0.2, 0.3), (2.5, 9.0), (2.0, 0.5)),
]


def delays(law, n, seed=0):
    return law.stream(PERIOD, generator(seed, "x")).take(n)


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_declared_facts_hold(law):
    """The mean of the cut law: five standard errors; held draws count once."""
    T = delays(law, 400_000)
    assert law.minimum <= T.min() and T.max() <= law.maximum * (1 + 1e-12)
    hold = max([x.hold or 0 for x in getattr(law, "parts", (law,)) if hasattr(x, "hold")])
    independent = 400_000 * min(1, 0.005 / (hold or 0.005))
    assert T.mean() == pytest.approx(law.mean, abs=5 * T.std() / independent**0.5)
    assert not law.loses_packets and law.limit(PERIOD) is None


@pytest.mark.parametrize("law", LAWS, ids=str)
@settings(max_examples=20)
@given(cuts=st.lists(st.integers(0, 500), max_size=8))
def test_chunks_do_not_change_the_delays(law, cuts):
    cuts = sorted(cuts)
    stream = law.stream(PERIOD, generator(5, "x"))
    parts = [stream.take(b - a) for a, b in zip([0, *cuts], [*cuts, 500], strict=True)]
    assert np.array_equal(np.concatenate(parts), delays(law, 500, seed=5))


def test_quantiles_of_a_hyperexponential_law_are_those_of_its_distribution():
    """P(T > t) = Σ w e^(-(t - shift)/mean); tolerance five standard errors of the share."""
    law = LAWS[2]
    T = delays(law, 200_000)
    for t in (0.075, 0.1, 0.168, 0.228):
        parts = zip(law.weights, law.means, strict=True)
        share = sum(w * exp(-(t - law.shift) / m) for w, m in parts)
        assert np.mean(t < T) == pytest.approx(share, abs=5 * (share / 200_000) ** 0.5)


def test_a_normal_law_has_its_moments_where_the_cut_is_far():
    T = delays(LAWS[0], 200_000)
    assert T.mean() == pytest.approx(0.1, abs=3e-4) and T.std() == pytest.approx(0.025, rel=0.01)
    assert LAWS[0].mean == pytest.approx(0.1, abs=1e-6)


# Bursts and outages


def lost(model, n, seed=0):
    return model.stream(PERIOD, generator(seed, "x")).take(n)


@pytest.mark.parametrize("model", MODELS, ids=str)
def test_pareto_bursts_lose_the_share_of_their_closed_form(model):
    """Tolerance 2 %, four standard errors of 400 000 packets in bursts of two or three."""
    found = figures(np.where(lost(model, 400_000), np.nan, 0.0))
    assert found.lost == pytest.approx(model.share, rel=0.03)
    assert found.burst == pytest.approx(model.burst, rel=0.03)


def test_a_burst_is_longer_than_k_with_the_probability_of_the_pareto_law():
    """Both states alike: P(L > 4 | L > 0) = ((1 + 5/b)/(1 + 1/b))^-a."""
    model = ParetoBursts((0.5, 0.5), (3.0, 3.0), (2.0, 2.0))
    edges = np.flatnonzero(np.diff(np.r_[0, lost(model, 400_000).astype(int), 0]))
    lengths = edges[1::2] - edges[::2]
    expected = ((1 + 5 / 2) / (1 + 1 / 2)) ** -3
    assert np.mean(lengths > 4) == pytest.approx(expected, rel=0.05)
    # one packet in a cycle arrives: share = E L/(1 + E L), E L = Σ (1 + k/b)^-a
    mean = sum((1 + k / 2) ** -3.0 for k in range(1, 100_000))
    assert model.share == pytest.approx(mean / (1 + mean), rel=1e-9)


@pytest.mark.parametrize("model", [*MODELS, UniformOutage(0.0, 0.4, 0.2)], ids=str)
@settings(max_examples=20)
@given(cuts=st.lists(st.integers(0, 500), max_size=8))
def test_chunks_do_not_change_the_losses(model, cuts):
    cuts = sorted(cuts)
    stream = model.stream(PERIOD, generator(5, "x"))
    parts = [stream.take(b - a) for a, b in zip([0, *cuts], [*cuts, 500], strict=True)]
    assert np.array_equal(np.concatenate(parts), lost(model, 500, seed=5))


def test_outages_of_random_length_and_fixed_pause():
    """Share E L/(E L + pause); gaps of 1 s, lengths of up to 2 s, to the sample."""
    model = UniformOutage(0.0, 2.0, 1.0)
    losses = lost(model, 400_000)
    assert losses.mean() == pytest.approx(model.share, rel=0.03) and model.share == 0.5
    edges = np.flatnonzero(np.diff(np.r_[0, losses.astype(int)]))
    up = np.diff(edges)[1::2] if losses[edges[0]] else np.diff(edges)[::2]
    assert edges[0] == 200
    assert set(np.unique(up[:400])) <= set(range(199, 402))  # short outages may fall in between
    down = np.diff(edges)[::2]
    assert down.max() <= 401 and down.mean() == pytest.approx(200, rel=0.1)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ({"law": "normal", "mean": 0.1, "sd": 0, "maximum": 1}, "sd = 0 s; expected more than 0"),
        ({"law": "normal", "mean": 0.1, "sd": 1, "maximum": 0}, "not more than minimum"),
        (
            {"law": "hyperexponential", "shift": 0, "weights": [0.5], "means": [1], "maximum": 2},
            "sum to 1",
        ),
        (
            {"law": "hyperexponential", "shift": 0, "weights": [1], "means": [1, 2], "maximum": 2},
            "as many of both",
        ),
        ({"law": "sum", "of": []}, "no delay law"),
        ({"law": "sum", "of": [{"law": "preset", "name": "wifi5"}]}, "loses packets"),
        ({"law": "preset", "name": "wifi7"}, "no preset of a network 'wifi7'; did you mean"),
        ({"law": "frozen", "name": "lte"}, "no frozen trace 'lte'; did you mean"),
    ],
)
def test_what_is_no_law_is_one_sentence(text, says):
    with pytest.raises(ScenarioError, match=says):
        delay_law(text, Path())


@pytest.mark.parametrize(
    "text",
    [
        {"law": "pareto-bursts", "stay": [1, 0.5], "shape": [2, 2], "scale": [1, 1]},
        {"law": "pareto-bursts", "stay": [0.5, 0.5], "shape": [1, 2], "scale": [1, 1]},
        {"law": "pareto-bursts", "stay": [0.5, 0.5], "shape": [2, 2], "scale": [0, 1]},
        {"law": "outage", "length": 3, "longest": 2, "pause": 1},
        {"law": "outage", "length": 0, "longest": 2, "pause": 0},
        {"law": "outage", "length": 0, "longest": 2, "pause": 1, "rate": 1},
    ],
)
def test_what_is_no_loss_is_refused(text):
    with pytest.raises(ScenarioError, match=r"expected|needs"):
        loss_model(text)


# Presets

#: (mean, p50, p95, p99) in ms as published; "mean" within 2 %, quantiles within 4 %.
PUBLISHED = {
    "telesim-high": (100, 100, 141.1, 158.2),
    "telesim-medium": (400, 400, 482.2, 516.3),
    "telesim-low": (1000, 1000, 1329, 1465),
    "netfi-dlm-1": (100, 88, 168, 228),
    "netfi-dlm-2": (299, 271, 479, 626),
    "netfi-dlm-3": (500, 471, 691, 847),
    "netfi-4g": (53, 24, 222, 464),
}
#: (share lost, tolerance): as published, or by the published formula.
LOST = {
    "telesim-high": 0.001, "telesim-medium": 0.01, "telesim-low": 0.03, "netfi-plm-1": 0.098,
    "netfi-plm-2": 0.305, "netfi-plm-3": 0.505, "netfi-clm-1": 0.15, "netfi-clm-2": 1 / 3,
    "netfi-clm-3": 0.5,
}  # fmt: skip


@pytest.mark.parametrize("name", PUBLISHED)
def test_presets_of_studies_have_the_published_quantiles(name):
    f = figures_of_preset(name, 200_000)
    mean, p50, p95, p99 = (x / 1000 for x in PUBLISHED[name])
    assert f.mean == pytest.approx(mean, rel=0.02)
    assert (f.p50, f.p95, f.p99) == pytest.approx((p50, p95, p99), rel=0.04)


@pytest.mark.parametrize("name", LOST)
def test_presets_of_studies_lose_what_is_published(name):
    model = loss_model(preset(name).loss)
    assert model.share == pytest.approx(LOST[name], rel=0.02)


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_is_a_law_with_a_source(name):
    found = preset(name)
    law = delay_law({"law": "preset", "name": name}, Path())
    assert found.source and found.title
    assert isinstance(law, Lossy) == (found.loss is not None)
    f = figures_of_preset(name, 200_000)
    if not name.startswith(("leo", "lte")):  # few independent draws
        assert f.mean == pytest.approx(law.mean, rel=0.02)
    assert netem(law.delay if isinstance(law, Lossy) else law, period=0.005)


@pytest.mark.parametrize(
    ("name", "p50", "p95", "tolerance"),
    [("lte-up", 24, 222, 0.2), ("leo-up", 28, 36, 0.15), ("geo", 307, 330, 0.02),
     ("wifi6", 3.4, 8.0, 0.05), ("atlantic", 42.5, 45.0, 0.01)],
)  # fmt: skip
def test_constructed_presets_have_the_quantiles_they_were_made_for(name, p50, p95, tolerance):
    assert preset(name).constructed
    f = figures_of_preset(name, 400_000)
    assert (1e3 * f.p50, 1e3 * f.p95) == pytest.approx((p50, p95), rel=tolerance)


def link(**given):
    return table_of(semantics="newest-stamp", **given)


def test_any_link_takes_a_preset_with_its_losses():
    table = link(delay={"law": "preset", "name": "wifi5"})
    assert table.law.loses_packets and table.facts()["delay"]["loss"]["law"] == "gilbert-elliott"
    with pytest.raises(ScenarioError, match="already defines losses; expected no key loss"):
        link(delay={"law": "preset", "name": "wifi5"}, loss={"law": "independent", "p": 0.1})
    both = link(delay={"law": "preset", "name": "lan"}, loss={"law": "independent", "p": 0.1})
    assert isinstance(both.law, Lossy) and both.law.loss == Independent(0.1)
