"""Metrics and requirements as a page computes them, against those of Python."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from math import isfinite, nan
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cosim.base.units import engineering, time_text
from cosim.live.judged import judged
from cosim.measure import declared_metrics, requirements
from cosim.measure.metric_result import MetricResult
from cosim.measure.metrics import evaluate
from cosim.record import Column
from cosim.reporting.labels import in_order_of_weight, metric_card, metric_title, renamed, rows
from cosim.reporting.run_report import verdict
from cosim.scenario.spec import Scenario, build
from cosim.study.memory import Memory
from tests.cosim.formulas import texts
from tests.cosim.formulas.test_robust import TIMES, UNIFORM
from tests.cosim.live.script import Script, script

JUDGE = """return (document, t, columns) => {
  const named = new Map(Object.entries(columns).map(([name, x]) => [name, Float64Array.from(x)]));
  const seen = found.judge(document, new found.Rows(Float64Array.from(t), named, document.entries));
  return { ...seen, verdict: found.verdict(seen),
    texts: seen.metrics.map(found.metricText),
    cards: seen.metrics.map((r, i) => found.card(document.metrics[i], r)),
    facts: seen.metrics.map((r, i) => found.facts(document.metrics[i], r)) };
};"""
NUMBERS = """return (x, unit, digits) =>
  [found.general(x, digits), found.timeText(x), found.engineering(x, unit)];"""
UNITS = ["rad", "s", "N.m", "m/s", "kg", "deg", "us", "N.m.√s", "1", "", "mm", "kg.m2", "%", "kPa"]


@pytest.fixture(scope="module")
def judge() -> Iterator[Script]:
    with script("measure.js", JUDGE) as found:
        yield found


@pytest.fixture(scope="module")
def numbers() -> Iterator[Script]:
    with script("measure.js", NUMBERS) as found:
        yield found


def declared(**tables: Any) -> Scenario:
    """A scenario of 100 s that declares these tables."""
    run = {"step": "1 s", "stop": "100 s"}
    return build({"run": run, "components": {}, **tables}, "test.toml")


def memory(t: Sequence[float], units: Mapping[str, str], x: Mapping[str, Any]) -> Memory:
    columns = [Column(name, units[name], i) for i, name in enumerate(units)]
    return Memory(columns, np.array(t, float), np.array([x[name] for name in units], float))


def both(
    judge: Script, scenario: Scenario, units: Mapping[str, str], t: Sequence[float],
    x: Mapping[str, Any], end: float | None = None,
) -> tuple[Memory, Any]:  # fmt: skip
    """The signals, and what the page finds in them."""
    signals = memory(t, units, x)
    document = judged(scenario, signals, units, t[-1] if end is None else end)
    columns = {name: [float(v) for v in x[name]] for name in units}
    return signals, judge(document, [float(s) for s in t], columns)


def same(page: float, python: float) -> bool:
    if not isfinite(python):
        return page == python or (page != page and python != python)
    return page == pytest.approx(python, rel=1e-12, abs=1e-13)


# ---- numbers as text ----------------------------------------------------------------------------

ODD = st.sampled_from([0.0, -0.0, 0.5, 1.5, 2.5, 0.00125, 1.0625, 9.9995e-4, 999.95, 0.09995, nan])


@given(st.floats(), st.sampled_from(UNITS), st.integers(1, 8))
@example(2.5, "rad", 1)
@example(1.0625, "s", 4)
@example(95.0, "rad", 1)
@settings(max_examples=200, deadline=None)
def test_numbers_are_written_alike(numbers: Script, x: float, unit: str, digits: int) -> None:
    expected = [f"{x:.{digits}g}", time_text(x), engineering(x, unit)]
    assert numbers(x, unit, digits) == expected


@given(st.one_of(ODD, st.floats(-7, 7).map(lambda e: 10.0**e)), st.sampled_from(UNITS))
@settings(max_examples=200, deadline=None)
def test_sizes_of_every_day_are_written_alike(numbers: Script, x: float, unit: str) -> None:
    expected = [f"{x:.4g}", time_text(x), engineering(x, unit)]
    assert numbers(x, unit, 4) == expected


# ---- requirements -------------------------------------------------------------------------------

PAIR = {"a.x": "m", "b.x": "m"}
ROW = st.one_of(st.integers(-5, 5).map(float), st.sampled_from([nan, float("inf"), 0.1]))


@given(st.data(), texts.formulas(), st.one_of(UNIFORM, TIMES), st.sampled_from([0.0, 1.0, 5.0]))
@settings(max_examples=100, deadline=None)
def test_random_formulas_have_the_same_robustness(
    judge: Script, data: st.DataObject, text: str, t: list[float], missing: float
) -> None:
    rows_ = partial(st.lists, min_size=len(t), max_size=len(t))
    kinds = st.one_of(texts.values(len(t)), rows_(ROW))
    x = {name: data.draw(kinds) for name in PAIR}
    scenario = declared(require={"one": {"formula": text}})
    signals, seen = both(judge, scenario, PAIR, t, x, t[-1] + missing)
    expected = requirements.requirements(scenario, PAIR)[0].evaluate(signals, t[-1] + missing)
    found = seen["required"][0]
    assert found["verdict"] == expected.verdict, text
    assert found["text"] == expected.text
    assert same(found["value"], expected.value) and same(found["time"], expected.time)


@given(st.data(), texts.formulas(), st.integers(20, 60))
@settings(max_examples=40, deadline=None)
def test_windows_slide_over_many_rows_alike(
    judge: Script, data: st.DataObject, text: str, n: int
) -> None:
    """Rows of 0.1 s, so that the windows of whole seconds are long and overlap."""
    t = [0.1 * k for k in range(n)]
    x = {name: data.draw(texts.values(n)) for name in PAIR}
    scenario = declared(require={"one": {"formula": text}})
    signals, seen = both(judge, scenario, PAIR, t, x)
    expected = requirements.requirements(scenario, PAIR)[0].evaluate(signals, t[-1])
    assert seen["required"][0]["text"] == expected.text, text


@pytest.mark.parametrize("word", ["and", "or"])
@pytest.mark.parametrize("first", [0, 1])
def test_of_two_equal_margins_the_left_one_decides(judge: Script, word: str, first: int) -> None:
    text = f"{_at(first)} {word} {_at(1 - first)}"
    scenario = declared(require={"one": {"formula": text}})
    _, seen = both(judge, scenario, PAIR, [0.0, 1.0, 2.0], {name: [1.0] * 3 for name in PAIR})
    assert seen["required"][0]["time"] == first


def _at(second: int) -> str:
    return f"(eventually within [{second} s, {second} s] a.x >= 0 m)"


ARM = {"a.q[0]": "rad", "a.q[1]": "rad", "b.q[0]": "deg", "b.q[1]": "deg", "a.tau": "N.m"}
EXPRESSIONS = (
    "norm(a.q - b.q) <= 0.6 rad",
    "max(abs(a.q)) <= 80 deg",
    "min(a.q, b.q) >= [-2, -1] rad",
    "-1 rad <= a.q[1] <= 1 rad",
    "abs(a.tau * a.q[0]) <= 2 J or a.q[0] / 2 >= 0.1 rad",
    "norm(a.q) <= 1 rad and abs(a.tau) <= 1.5 N.m",
    "eventually within 3 s (norm(a.q) <= 0.5 rad until within [1 s, 2 s] a.tau >= 0.1 N.m)",
    "max(min(a.q), a.q[0] + a.q[1], 0.2 rad) <= 1.2 rad",
)


@pytest.mark.parametrize("text", EXPRESSIONS)
@pytest.mark.parametrize("form", ["always", "eventually", "formula"])
def test_expressions_of_vectors_and_units(judge: Script, text: str, form: str) -> None:
    random = np.random.default_rng(len(text))
    t = np.arange(60) * 0.1
    for _ in range(5):
        x = {name: random.normal(0, 57.0 if unit == "deg" else 1.0, 60) for name, unit in
             ARM.items()}  # fmt: skip
        scenario = declared(require={"one": {form: text}})
        signals, seen = both(judge, scenario, ARM, t.tolist(), x)
        expected = requirements.requirements(scenario, ARM)[0].evaluate(signals, float(t[-1]))
        found = seen["required"][0]
        assert (found["text"], found["unit"]) == (expected.text, expected.unit)
        assert same(found["value"], expected.value) and same(found["time"], expected.time)


# ---- metrics ------------------------------------------------------------------------------------

SIGNALS = {"q": "rad", "f": "N.m", "v": "rad/s"}
TWO = {f"{arm}.{name}[{i}]": u for arm in "ab" for name, u in SIGNALS.items() for i in (0, 1)}
TWO["a.one"] = "m"
METRICS: Mapping[str, Mapping[str, Any]] = {
    "apart": {
        "kind": "error",
        "of": ["a.q"],
        "target": "b.q",
        "within": 0.3,
        "label": "sync error",
    },
    "long": {"kind": "error", "of": ["a.q", "b.q"], "target": [0.1, 0.2], "norm": "euclidean"},
    "each": {"kind": "error", "of": ["a.q", "b.q"], "target": ["b.q", "a.q"], "within": 1e3},
    "norm": {"kind": "norm", "of": ["a.f"], "label": "operator effort"},
    "area": {"kind": "integral_abs", "of": ["a.f", "b.f"]},
    "rms": {"kind": "rms", "of": ["a.v"]},
    "mean": {"kind": "tail_mean", "of": ["a.f"], "window": "1 s"},
    "whole": {"kind": "tail_mean", "of": ["a.f"], "window": "1000 s"},
    "shakes": {"kind": "vibration", "of": ["a.q"], "window": "2 s"},
    "peak": {"kind": "peak", "of": ["a.f", "b.f"]},
    "end": {"kind": "final", "of": ["a.q"]},
    "last": {"kind": "final", "of": ["a.one"]},
    "free": {"kind": "rms_free", "of": ["a.q"], "target": "b.q", "contact": ["a.one"]},
    "touch": {"kind": "rms_contact", "of": ["a.q"], "target": [0.0, 1.0], "contact": ["a.one"]},
    "energy": {"kind": "energy", "of": ["a.f", "a.v", "b.f", "b.v"]},
    "one_port": {"kind": "energy", "of": ["a.f", "a.v"]},
}
REQUIRED = {
    "apart": {"metric": "apart.settle_s <= 3 s"},
    "never": {"metric": "each.settle_s <= 3 s and peak <= 2 N.m"},
    "spread": {"metric": "shakes.frequency_hz >= 1 Hz"},
}


def signals(seed: int, kind: str) -> tuple[list[float], dict[str, list[float]]]:
    random = np.random.default_rng(seed)
    n = int(random.integers(50, 400))
    t = np.arange(n) * 0.02
    x = {name: random.normal(size=n) * np.exp(-t * random.uniform(-0.2, 3)) for name in TWO}
    x["a.one"] = np.where(np.sin(3 * t) > random.uniform(-1, 1.2), 1.0, 0.0)
    if kind == "bad":
        x["a.q[1]"][n // 2 :] = nan
    if kind == "whole":  # values that are equal, or 0
        x = {name: np.round(2 * values) for name, values in x.items()}
    if kind == "still":
        x = {name: np.zeros(n) for name in x}
    return t.tolist(), {name: values.tolist() for name, values in x.items()}


@pytest.mark.parametrize("kind", ["random", "bad", "still", "whole"])
@pytest.mark.parametrize("seed", range(6))
def test_metrics_have_the_same_numbers_and_words(judge: Script, seed: int, kind: str) -> None:
    scenario = declared(metrics=METRICS, require=REQUIRED)
    t, x = signals(seed, kind)
    recorded, seen = both(judge, scenario, TWO, t, x)
    metrics = in_order_of_weight(declared_metrics.metrics(scenario))
    expected = evaluate(metrics, recorded)
    for python, page, text in zip(expected, seen["metrics"], seen["texts"], strict=True):
        assert page["name"] == python.name and page["unit"] == python.unit
        assert same(page["value"], python.value), python.name
        assert set(page["parts"]) == set(python.parts)
        for key, value in python.parts.items():
            assert same(page["parts"][key], value), (python.name, key)
        if kind != "still":  # then a residual is 0 here and 1e-300 there
            assert text == python.text
            assert [tuple(pair) for pair in page["more"]] == list(python.more)
    required = requirements.evaluate(requirements.requirements(scenario, TWO), recorded, t[-1])
    assert [r["text"] for r in seen["required"]] == [r.text for r in required]
    shown: list[MetricResult] = [
        renamed(r, metric_title(m)) for m, r in zip(metrics, expected, strict=True)
    ]
    badge = verdict({}, scenario, tuple(shown), required)
    assert seen["verdict"] == [badge.word, badge.reason]
    for metric, result, card, facts in zip(
        metrics, shown, seen["cards"], seen["facts"], strict=True
    ):
        found = metric_card(metric, result)
        assert card == [found.label, found.value, found.note]
        assert [tuple(fact) for fact in facts] == rows(result)


def test_a_run_without_requirements_is_judged_by_its_errors(judge: Script) -> None:
    scenario = declared(metrics={"apart": METRICS["apart"]})
    for size, word in ((0.01, "passed"), (1.0, "failed")):
        t = [0.0, 0.5, 1.0]
        x = {name: [size, size, size] for name in TWO} | {"b.q[0]": [0.0, 0.0, 0.0]}
        recorded, seen = both(judge, scenario, TWO, t, x)
        result = renamed(declared_metrics.metrics(scenario)[0].evaluate(recorded), "Sync error")
        badge = verdict({}, scenario, (result,))
        assert badge.word == word and seen["verdict"] == [badge.word, badge.reason]
