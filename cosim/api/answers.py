"""Questions about a run, each answered with yes or no and the numbers that decide it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any, final

import numpy as np

from cosim.base.convert import Number, number
from cosim.base.errors import ScenarioError
from cosim.base.names import unknown
from cosim.measure.link_ages import age_groups
from cosim.measure.metrics import Error, Measure, MetricResult
from cosim.measure.robustness import Robustness
from cosim.record import Run
from cosim.record.piecewise import NotFinite, Stacked

#: A signal, or its value: a number or a text with a unit, one for all entries or a list.
Target = str | float | Sequence[Number]


@final
@dataclass(frozen=True, slots=True)
class Answer:
    """An answer about a run: `text` says which number was found, and which was expected.

    It is true where the answer is yes, so that ``assert run.settles(...)`` fails with the text.
    """

    yes: bool
    text: str

    def __bool__(self) -> bool:
        return self.yes

    def __repr__(self) -> str:
        return f"{'yes' if self.yes else 'no'}: {self.text}"


def settles(run: Run, signal: str, to: Target, band: Number, within: Number) -> Answer:
    """Answer :meth:`cosim.RunResult.settles`. Raises ScenarioError."""
    unit, seconds = run.unit(signal), number(within, "s", "within")
    width = number(band, unit, "band")
    if not width > 0:
        raise ScenarioError(f"found {band!r}, expected a width above 0", "band")
    found = Error("settles", (signal,), _target(run, signal, to), width).evaluate(run)
    if not isfinite(found.value):
        return Answer(False, f"{signal}: {found.detail}")
    at = found.parts["settle_s"] - run.span[0]
    about = f"{_with_unit(width, unit)} of {_name(to)}"
    if not isfinite(at):
        last = _with_unit(found.value, unit)
        wanted = f"expected to stay within {about} after {seconds:g} s"
        return Answer(False, f"{signal} is {last} away from {_name(to)} at the end; {wanted}")
    text = f"{signal} stays within {about} after {at:.6g} s; expected within {seconds:g} s"
    return Answer(at <= seconds, text)


def stays_below(run: Run, signal: str, bound: Number) -> Answer:
    """Answer :meth:`cosim.RunResult.stays_below`."""
    unit = run.unit(signal)
    found = Measure("peak", "peak", (signal,)).evaluate(run)
    most = number(bound, unit, "bound")
    if not isfinite(found.value):
        return Answer(False, f"{signal}: {found.detail}")
    value = _with_unit(found.value, unit)
    text = (
        f"the greatest {signal} is {value} {found.detail}; expected below {_with_unit(most, unit)}"
    )
    return Answer(found.value < most, text)


def overshoot(run: Run, signal: str, to: Target, bound: Number) -> Answer:
    """Answer :meth:`cosim.RunResult.overshoot_stays_below`."""
    unit, target = run.unit(signal), _target(run, signal, to)
    most = number(bound, unit, "bound")
    names = (signal, target) if isinstance(target, str) else (signal,)
    whole, size = Stacked(run, names, "overshoot"), len(run.entries(signal))
    fixed = np.empty((0, 0)) if isinstance(target, str) else np.array([target])
    _same_size(signal, size, fixed.shape[1] or len(whole.names) - size)
    try:
        ends = [(rows.x[:1].copy(), rows.x[-1:].copy()) for rows in whole]
    except NotFinite as why:
        return Answer(False, f"{signal}: {why}")
    aim = fixed if fixed.size else ends[-1][1][:, size:]
    ahead = np.sign(aim[-1] - ends[0][0][0, :size])  # from the start to the target
    found, where = 0.0, "at all times"
    for rows in whole:
        x, aim = rows.x[:, :size], fixed if fixed.size else rows.x[:, size:]
        beyond = ahead * (x - aim)
        row, entry = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
        if beyond[row, entry] > found:
            found = float(beyond[row, entry])
            where = f"at {rows.t[row]:.4g} s ({whole.names[entry]})"
    text = f"{signal} overshoots {_name(to)} by {_with_unit(found, unit)} {where}"
    return Answer(found < most, f"{text}; expected less than {_with_unit(most, unit)}")


def age(run: Run, link: str, bound: Number) -> Answer:
    """Answer :meth:`cosim.RunResult.age_stays_below`. Raises ScenarioError."""
    tables, most = run.link_tables, number(bound, "s", "bound")
    if link not in tables:
        raise ScenarioError(unknown(link, tables, "link"), str(run.path.parent))
    worst, at, row, came = -1.0, 0.0, 0, False
    for found in age_groups(tables[link]):
        ages = found.waited(row)
        step = int(np.argmax(ages))
        if ages[step] > worst:
            worst, at = float(ages[step]), (row + step) * found.period
        came = came or not np.isnan(found.age).all()
        row += ages.size
    if not came:
        return Answer(False, f"no sample came over {link}")
    text = f"the greatest age of {link} is {worst:.6g} s at {at:.4g} s"
    return Answer(worst < most, f"{text}; expected below {most:g} s")


def passes(
    required: Mapping[str, Robustness],
    results: Mapping[str, MetricResult],
    names: Sequence[str],
    place: str,
) -> Answer:
    """Answer :meth:`cosim.RunResult.passes`. Raises ScenarioError."""
    bounded = {name: r for name, r in results.items() if "settle_s" in r.parts}
    for name in names:
        if name not in required and name not in bounded:
            what = "requirement, or metric with the key 'within',"
            raise ScenarioError(unknown(name, {**required, **bounded}, what), place)
    chosen = names or tuple(required) or tuple(bounded)
    if not chosen:
        text = "the scenario declares no requirement and no metric with the key 'within'"
        raise ScenarioError(text, place)
    said = {name: _judged(name, required, bounded) for name in chosen}
    missed = [answer.text for answer in said.values() if not answer]
    return Answer(not missed, "; ".join(missed or [answer.text for answer in said.values()]))


def _judged(
    name: str, required: Mapping[str, Robustness], bounded: Mapping[str, MetricResult]
) -> Answer:
    """The answer about one requirement, or one metric with a band."""
    if name in required:
        return Answer(required[name].verdict == "passed", required[name].line)
    r = bounded[name]
    settled = isfinite(r.value) and isfinite(r.parts["settle_s"])
    return Answer(settled, "; ".join(f"{label}: {text}" for label, text in r.facts))


def no_faults(facts: Mapping[str, Any]) -> Answer:
    """Answer :meth:`cosim.RunResult.has_no_faults`; `facts`: ``run.json``."""
    judged = facts.get("rehearsal") or {}
    reasons = [str(reason) for reason in judged.get("reasons", ())]
    if facts.get("status") != "finished":
        reasons.append(str(facts.get("error") or f"the run is {facts.get('status', 'unknown')}"))
    if facts.get("ended"):
        reasons.append(f"{facts['ended']['component']} ended it before its time")
    verdict = judged.get("verdict", "passed" if not reasons else "failed")
    for life, node in (judged.get("nodes") or {}).items():
        if node.get("reasons"):
            reasons.append(f"{life}: {', '.join(map(str, node['reasons']))}")
    text = "; ".join(dict.fromkeys(reasons)) or "the run came to its end"
    return Answer(verdict == "passed" and not reasons, f"{verdict}: {text}")


def identical(run: Run, other: Path) -> Answer:
    """Answer :meth:`cosim.RunResult.is_identical_to`."""
    from cosim.base.parts import part

    found = part("differences").compare_runs(run.path.parent, other)
    lengths = len(run), len(Run.open(other))
    only = [name for names in found.only for name in names]
    if only:
        return Answer(False, f"only one of the two runs has {', '.join(only[:4])}")
    if lengths[0] != lengths[1]:
        return Answer(False, f"found {lengths[0]} rows, expected {lengths[1]} as in {other}")
    if found.verdict == "identical":
        return Answer(True, found.sentence())
    apart = [s for s in found.signals if s.largest > 0.0]
    worst = apart[0]
    by = f"{_with_unit(worst.largest, worst.unit)} at {worst.at:.6g} s"
    text = f"{len(apart)} of {len(found.signals)} signals differ from {other}"
    return Answer(False, f"{text}, most of all {worst.name} by {by}")


def _target(run: Run, signal: str, to: Target) -> tuple[float, ...] | str:
    """A target as a metric has it: the name of a signal, or a number for each entry."""
    if isinstance(to, str) and run.has(to):
        return to
    entries, unit = len(run.entries(signal)), run.unit(signal)
    given = [to] * entries if isinstance(to, str | int | float) else list(to)
    _same_size(signal, entries, len(given))
    if isinstance(to, str) and to[:1].strip("+-.0123456789"):
        run.entries(to)  # raises, with the signals whose names are near
    return tuple(number(value, unit, "to") for value in given)


def _same_size(signal: str, size: int, of_target: int) -> None:
    if size != of_target:
        raise ScenarioError(f"{signal} has size {size}, but its target has size {of_target}", "to")


def _name(to: Target) -> str:
    if isinstance(to, str | int | float):
        return str(to)
    return f"({', '.join(map(str, to))})"


def _with_unit(value: float, unit: str) -> str:
    return f"{value:.6g}" if unit in ("", "1") else f"{value:.6g} {unit}"
