"""Metrics and requirements of a scenario as data that ``assets/measure.js`` evaluates in a page."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from typing import Any

from cosim.base.names import listed
from cosim.formulas.robust import Both, Extreme, HeldInequality, Not, Until
from cosim.formulas.syntax import TimeInterval
from cosim.formulas.terms import Term
from cosim.formulas.trace import Robust
from cosim.measure import declared_metrics
from cosim.measure.contact_metrics import PhaseError
from cosim.measure.metric_result import MetricResult
from cosim.measure.metrics import Error, Measure, Metric, evaluate
from cosim.measure.requirements import Requirement, requirements
from cosim.record.signals import Signals
from cosim.reporting.labels import in_order_of_weight, metric_card, metric_title
from cosim.scenario.spec import Scenario


def judged(
    scenario: Scenario, signals: Signals, units: Mapping[str, str], end: float
) -> dict[str, Any]:
    """The metrics and requirements of a scenario, in the order of a report.

    `signals`: of a run of it, from which the units come; `units`: of each scalar by its name;
    `end`: of the run, s. Raises ScenarioError for what does not fit the signals.
    """
    metrics = in_order_of_weight(declared_metrics.metrics(scenario))
    required = requirements(scenario, units)
    names = dict.fromkeys(name for one in (*metrics, *required) for name in one.signals)
    results = evaluate(metrics, signals)
    return {
        "end": end,
        "entries": {name: list(signals.entries(name)) for name in names},
        "metrics": [_metric(*pair) for pair in zip(metrics, results, strict=True)],
        "require": [requirement_data(one) for one in required],
    }


def _metric(metric: Metric, result: MetricResult) -> dict[str, Any]:
    shown = {"title": metric_title(metric), "shown": metric_card(metric, result).label}
    return metric_data(metric, result.unit) | shown


def metric_data(metric: Metric, unit: str) -> dict[str, Any]:
    """A metric as data; `unit`: of its value."""
    found: dict[str, Any] = {
        "name": metric.name, "kind": "energy", "of": list(metric.of), "label": metric.label,
        "unit": unit,
    }  # fmt: skip
    if isinstance(metric, Error):
        found |= {"kind": "error", "norm": metric.norm, "within": metric.within}
    elif isinstance(metric, Measure):
        found |= {"kind": metric.kind, "window": metric.window, "listed": listed(metric.of)}
    elif isinstance(metric, PhaseError):
        found |= {"kind": metric.kind, "contact": list(metric.contact)}
    if isinstance(metric, Error | PhaseError):
        target = metric.target
        found["target"] = target if isinstance(target, str) else list(target)
    return found


def requirement_data(one: Requirement) -> dict[str, Any]:
    """A requirement as data."""
    return {
        "name": one.name, "condition": one.condition, "unit": one.unit, "relative": one.relative,
        "word": one.word, "names": list(one.names), "metrics": [m.name for m in one.metrics],
        "formula": _formula(one.formula),
    }  # fmt: skip


def _formula(formula: Robust) -> dict[str, Any]:
    match formula:
        case HeldInequality(margin, scale, negated):
            return {"op": "held", "margin": _term(margin), "scale": scale, "negated": negated}
        case Not(of):
            return {"op": "not", "of": _formula(of)}
        case Both(left, right, either):
            both = {"left": _formula(left), "right": _formula(right)}
            return {"op": "both", **both, "either": either}
        case Extreme(of, interval, eventually):
            inner = {"of": _formula(of), "eventually": eventually}
            return {"op": "extreme", **inner, **_interval(interval)}
        case Until(left, right, interval):
            both = {"left": _formula(left), "right": _formula(right)}
            return {"op": "until", **both, **_interval(interval)}
    raise TypeError(type(formula))


def _interval(interval: TimeInterval) -> dict[str, Any]:
    return {"begin": interval.begin, "end": None if interval.end == inf else interval.end}


def _term(term: Term) -> dict[str, Any]:
    if term.kind == "constant":
        return {"kind": term.kind, "values": list(term.values)}
    if term.kind == "signal":
        return {"kind": term.kind, "name": term.name, "gain": term.gain, "offset": term.offset}
    return {"kind": term.kind, "of": [_term(part) for part in term.of]}
