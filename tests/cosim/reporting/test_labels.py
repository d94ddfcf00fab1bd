"""Numbers and labels of a report as a person reads them."""

from __future__ import annotations

from math import inf, nan
from typing import Any

import numpy as np
import pytest

from cosim.base.units import conversion, engineering, engineering_range, prefixed, printed_unit
from cosim.measure.metric_result import MetricResult
from cosim.measure.metrics import metric
from cosim.reporting.html import Card, capital, cards, round_ticks, whole
from cosim.reporting.labels import in_order_of_weight, metric_card, metric_title, renamed, rows


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.6, "s", "600 ms"),
        (6e5, "us", "600 ms"),
        (2.5e-4, "ms", "250 ns"),
        (4000.0, "s", "4000 s"),
        (1234.0, "N", "1.234 kN"),
        (0.5, "rad", "0.5 rad"),
        (-0.05, "rad", "-50 mrad"),
        (1.181e-9, "rad", "1.181 nrad"),
        (2e-14, "rad", "2 × 10⁻¹⁴ rad"),
        (0.02, "kg.m2", "0.02 kg·m²"),
        (0.003, "N.m.s/rad", "3 mN·m·s/rad"),
        (1e-4, "m2", "0.0001 m²"),
        (48e3, "Hz", "48 kHz"),
        (12345.0, "1", "12340"),
        (43.21, "%", "43.21 %"),
        (90.0, "deg", "90°"),
        (0.0, "N.m", "0 N·m"),
        (nan, "s", "–"),
        (inf, "s", "–"),
    ],
)
def test_numbers_have_the_unit_in_which_people_read_them(
    value: float, unit: str, text: str
) -> None:
    assert engineering(value, unit) == text


@pytest.mark.parametrize("unit", ["s", "us", "N.m", "rad/s", "kg.m2", "m", "Hz", "N.m.s/rad"])
def test_a_prefix_changes_the_number_and_the_unit_alike(unit: str) -> None:
    for value in np.geomspace(1e-8, 1e8, 33):
        factor, shown = prefixed(value, unit)
        plain = shown.translate(str.maketrans("·²", ".2"))
        assert conversion(unit, plain)[0] == pytest.approx(factor, rel=1e-12)


def test_intervals_have_one_unit_and_units_are_printed() -> None:
    assert engineering_range(0.3, 1.2, "s") == "0.3 to 1.2 s"
    assert engineering_range(3e-3, 0.2, "s") == "3 to 200 ms"
    assert [printed_unit(u) for u in ("us", "Ohm", "1", "rad/s2", "uA")] == [
        "µs", "Ω", "", "rad/s²", "µA",
    ]  # fmt: skip
    assert whole("0.3 to 1.2 s, held 30 ms") == "0.3 to 1.2\u00a0s, held 30\u00a0ms"


@pytest.mark.parametrize(
    ("kind", "of", "further", "title"),
    [
        ("error", ["b.q"], {"target": "a.q"}, "Difference of b.q and a.q"),
        ("error", ["a.q", "b.q"], {"target": [1.0]}, "Distance of q of a and b from the target"),
        ("peak", ["a.tau", "b.tau", "c.tau"], {}, "Greatest |tau| of a and 2 more"),
        ("tail_mean", ["a.tau"], {"window": 1.0}, "Mean of |a.tau|"),
        ("energy", ["a.f", "a.v"], {}, "Least energy at a.f and a.v"),
        ("norm", ["a.f"], {"label": "operator's effort"}, "Operator's effort"),
    ],
)
def test_a_metric_without_a_label_is_called_by_what_it_measures(
    kind: str, of: list[str], further: Any, title: str
) -> None:
    assert metric_title(metric("at_q_h", kind, of, **further)) == title


def test_cards_say_when_a_number_was_taken_and_keep_its_key() -> None:
    error = metric("sync", "error", ["b.q"], target="a.q", within=0.05, label="sync error")
    parts = {"settle_s": 3.25, "rmse": 0.2, "max": 2.0, "max_at_s": 0.5}
    result = MetricResult("sync", "Sync error", 2e-3, "rad", "x; below 0.05 from 3.25 s on", parts)
    card = metric_card(error, result)
    assert card == Card(
        "Sync error at the end", "2 mrad", "sync", "below 50 mrad after 3.25 s"
    )  # fmt: skip
    assert 'title="sync"' in cards([card]) and "<span>Runs</span><b>3</b>" in cards([("runs", "3")])
    never = metric_card(error, MetricResult("sync", "", 2.0, "rad", "", {"settle_s": inf}))
    assert never.note == "not below 50 mrad at the end"
    holding = metric("hold", "tail_mean", ["a.f"], window=0.5)
    assert metric_card(holding, MetricResult("hold", "", 1.0, "N")).label.endswith(", last 500 ms")
    shaking = metric("v", "vibration", ["a.q"], window=1.0)
    shaken = MetricResult("v", "", 1.0, "rad", "", {"frequency_hz": 12.5})
    assert metric_card(shaking, shaken).note == "at 12.5 Hz"
    highest = metric_card(
        metric("p", "peak", ["a.f"]), MetricResult("p", "", 1.0, "N", "", {"at_s": 2})
    )
    assert highest.note == "at 2 s"
    assert metric_card(metric("n", "norm", ["a.f"]), result).note == "L2 norm"
    more = (("e, RMS", "0.2 rad over 6 s"), ("settled", "after 3.25 s"))
    named = renamed(MetricResult("e", "e", 2e-3, "rad", "at the end", more=more), "Sync error")
    assert rows(named) == [
        ("Sync error", "2 mrad at the end"),
        ("Sync error, RMS", "0.2 rad over 6 s"),
        ("Settled", "after 3.25 s"),
    ]
    plain = metric("plain", "error", ["b.q"], target="a.q")
    assert in_order_of_weight([holding, plain, error]) == [error, plain, holding]


def test_symbols_and_names_of_signals_keep_their_first_letter() -> None:
    texts = [
        "first coordinate",
        "x",
        "z, the height",
        "master.q[0], slave.q[0]",
        "q_h",
        "µ-law",
        "",
    ]
    assert [capital(text) for text in texts] == ["First coordinate", *texts[1:]]


def test_ticks_are_round_and_few() -> None:
    assert round_ticks(0.31, 1.197) == pytest.approx([0.4, 0.6, 0.8, 1.0])
    for low, high in [(0.0, 1.0), (299.0, 1201.0), (-3.0, 5.0), (7.0, 7.001), (0.0, 6e5)]:
        ticks = round_ticks(low, high)
        assert 2 <= len(ticks) <= 7 and low <= ticks[0] and ticks[-1] <= high + 1e-9
