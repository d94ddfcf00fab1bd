"""The labels of metrics as a person reads them, and the order in which a page shows metrics."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import inf, isfinite

from cosim.base.copies import replace
from cosim.base.units import engineering
from cosim.measure.metric_result import MetricResult
from cosim.measure.metrics import Error, Measure, Metric
from cosim.reporting.html import Card, capital

#: Signals that a label names; of more, their number.
NAMED = 2
#: What a number of a kind is, of signals without a label of their own.
_KINDS = {
    "norm": "Norm of {}",
    "integral_abs": "Integral of |{}|",
    "rms": "RMS of {}",
    "tail_mean": "Mean of |{}|",
    "vibration": "Vibration of {}",
    "peak": "Greatest |{}|",
    "final": "{}",
    "rms_free": "RMS error of {} without contact",
    "rms_contact": "RMS error of {} in contact",
    "energy": "Least energy at {}",
}


def metric_title(metric: Metric) -> str:
    """The label of a metric with a capital letter; without one, what it measures of which signals.

    ``Sync error``, ``Difference of slave.q and master.q``, ``Greatest |arm.tau|``.
    """
    if metric.label:
        return capital(metric.label)
    what, whose = _named(metric.of)
    if not isinstance(metric, Error):
        return _KINDS[_kind(metric)].format(what) + whose
    of = what + whose
    if isinstance(metric.target, str):
        return f"Difference of {of} and {metric.target}"
    return f"Distance of {of} from the target"


def _named(signals: Sequence[str]) -> tuple[str, str]:
    """Signals in a label: ("tau", " of arm and hand") where they are of one kind."""
    parts = {name.partition(".")[2] for name in signals}
    if len(signals) == 1 or len(parts) > 1:
        return _few(signals), ""
    return parts.pop(), f" of {_few([name.partition('.')[0] for name in signals])}"


def _few(names: Sequence[str]) -> str:
    return " and ".join(names) if len(names) <= NAMED else f"{names[0]} and {len(names) - 1} more"


def metric_card(metric: Metric, result: MetricResult) -> Card:
    """The number of a metric: when it was taken stands in the label, a bound below the number."""
    title, note = metric_title(metric), ""
    if isinstance(metric, Error) or _kind(metric) == "final":
        title += " at the end"
    elif isinstance(metric, Measure) and metric.window:
        title += f", last {engineering(metric.window, 's')}"
    if isinstance(metric, Error) and metric.within is not None:
        settled, bound = result.parts.get("settle_s", inf), engineering(metric.within, result.unit)
        since = f"after {engineering(settled, 's')}"
        note = f"below {bound} {since}" if isfinite(settled) else f"not below {bound} at the end"
    if (frequency := result.parts.get("frequency_hz", 0.0)) > 0.0:
        note = f"at {engineering(frequency, 'Hz')}"
    if "at_s" in result.parts:
        note = f"at {engineering(result.parts['at_s'], 's')}"
    note = {"norm": "L2 norm", "integral_abs": "integral"}.get(_kind(metric), note)
    return Card(title, engineering(result.value, result.unit), metric.name, note)


def renamed(result: MetricResult, label: str) -> MetricResult:
    """The result with another label, also in front of its further facts."""
    more = [(label + name.removeprefix(result.label), text) for name, text in result.more
            if name.startswith(result.label)]  # fmt: skip
    others = [fact for fact in result.more if not fact[0].startswith(result.label)]
    return replace(result, label=label, more=(*more, *others))


def rows(result: MetricResult) -> list[tuple[str, str]]:
    """Label and text of each fact of a result, for a table."""
    value = engineering(result.value, result.unit)
    facts = [(result.label, f"{value} {result.detail}".rstrip()), *result.more]
    return [(capital(label), text) for label, text in facts]


def _kind(metric: Metric) -> str:
    return getattr(metric, "kind", "energy")


def in_order_of_weight(metrics: Iterable[Metric]) -> list[Metric]:
    """Metrics that judge a run first: errors with a bound, other errors, and the others."""

    def weight(metric: Metric) -> int:
        return 2 if not isinstance(metric, Error) else int(metric.within is None)

    return sorted(metrics, key=weight)
