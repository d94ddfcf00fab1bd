"""Requirements that cannot fail, cannot hold, or are about times after the run.

Ranges of signals follow from the limits of joints and torques; expressions are evaluated with
intervals in the place of signals (interval arithmetic), formulas by the same minima and maxima as
their robustness.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import inf, isfinite
from typing import Any

import numpy as np

from cosim.base.units import time_text
from cosim.checks import Finding
from cosim.formulas.robust import Both, Extreme, HeldInequality, Not, Until
from cosim.formulas.terms import Range, Term, span
from cosim.formulas.trace import Robust
from cosim.measure.metric_result import with_unit
from cosim.measure.requirements import Requirement, requirements
from cosim.predict.system import AnalyzedSystem

#: Entries of each signal with their limits, in its unit.
Limits = Mapping[str, Sequence[Range]]


def intervals(system: AnalyzedSystem) -> Iterator[Finding]:
    """Requirements whose intervals begin or end after the run."""
    duration = system.plan.end - system.plan.start
    for requirement in _of(system):
        begin, tail = _begin(requirement.formula), requirement.formula.tail
        if begin > duration * (1 + 1e-9):
            words = f"its interval begins at {time_text(begin)}"
        elif tail > duration * (1 + 1e-9):
            words = f"its intervals reach to {time_text(tail)}"
        else:
            continue
        yield _finding(
            requirement, max(begin, tail), "s",
            f"{words}, but the run takes {time_text(duration)}: what is behind is not judged",
            f"shorten the interval, or set run.stop to {system.plan.start + max(begin, tail):g} s",
        )  # fmt: skip


def decided(system: AnalyzedSystem) -> Iterator[Finding]:
    """Requirements that hold, or are violated, whatever happens within the limits of signals."""
    limits = _limits(system)
    for requirement in _of(system):
        low, high = _range(requirement.formula, requirement, limits)
        of = [f"{name} stays within {_shown(limits[name])}" for name in requirement.names
              if name in limits and not requirement.metrics]  # fmt: skip
        why = f" ({'; '.join(of)})" if of else ""
        if low >= 0:
            margin = with_unit(low, requirement.unit, 4)
            reason = f"cannot fail: its margin is at least {margin}{why}"
            yield _finding(requirement, low, requirement.unit, reason, "choose a tighter bound")
        elif high < 0 or _contradicts(requirement.formula):
            reason = "cannot hold: its conditions contradict each other"
            if high < 0:
                margin = with_unit(high, requirement.unit, 4)
                reason = f"cannot hold: its margin is at most {margin}{why}"
            yield _finding(requirement, high, requirement.unit, reason, "choose another bound")


def _of(system: AnalyzedSystem) -> list[Requirement]:
    """The requirements of the scenario. Raises ScenarioError for those that cannot be read."""
    from cosim.engine.simulate import columns

    scenario = system.scenario
    recorded = columns(
        system.plan, scenario.run.record.signals, scenario.place("run.record.signals")
    )
    return requirements(scenario, {c.name: c.unit for c in recorded})


def _finding(
    requirement: Requirement, number: float, unit: str, reason: str, advice: str
) -> Finding:
    return Finding(
        rule="requirement", severity="warning", where=f"require.{requirement.name}",
        number=number, unit=unit, reason=reason, advice=advice,
    )  # fmt: skip


def _begin(formula: Robust) -> float:
    """The earliest time that decides a formula, s."""
    if isinstance(formula, Extreme):
        return formula.interval.begin + _begin(formula.of)
    if isinstance(formula, Until):
        return formula.interval.begin
    if isinstance(formula, Both):
        return min(_begin(formula.left), _begin(formula.right))
    return _begin(formula.of) if isinstance(formula, Not) else 0.0


# ---- limits -------------------------------------------------------------------------------------


def _limits(system: AnalyzedSystem) -> Limits:
    """The limits of joints, and of torques that controllers saturate."""
    found: dict[str, Sequence[Range]] = {}
    for name, arm in system.arms.items():
        if len(arm.lower) == len(arm.q) and np.isfinite([*arm.lower, *arm.upper]).any():
            found[f"{name}.{arm.position}"] = list(zip(arm.lower, arm.upper, strict=True))
        for wire in system.plan.wires:
            law: Any = system.facts.get(wire.source.component)
            most = np.asarray(getattr(law, "tau_max", (inf,)), dtype=np.float64)
            moves = (wire.target.component, wire.target.port) == (name, arm.torque)
            if moves and np.isfinite(most).any() and most.size in (1, wire.source.size):
                sizes = np.resize(most, wire.source.size).tolist()
                found[wire.source.name] = [(-x, x) for x in sizes]
    return found


def _shown(limits: Sequence[Range]) -> str:
    low, high = min(a for a, _ in limits), max(b for _, b in limits)
    return f"{low:.4g} to {high:.4g}"


def _range(formula: Robust, requirement: Requirement, limits: Limits) -> Range:
    """The range of the robustness of a formula."""
    if isinstance(formula, HeldInequality):
        ranges = _metrics if requirement.metrics else limits.get
        each = span(formula.margin, lambda name: _known(name, formula.margin, ranges))
        low = min(a for a, _ in each) / formula.scale
        high = min(b for _, b in each) / formula.scale
        return (-inf if low != low else low), (inf if high != high else high)
    if isinstance(formula, Not):
        low, high = _range(formula.of, requirement, limits)
        return -high, -low
    if isinstance(formula, Extreme):
        return _range(formula.of, requirement, limits)
    pair = [_range(x, requirement, limits) for x in (formula.left, formula.right)]  # type: ignore[attr-defined]
    if isinstance(formula, Until):
        lows, highs = zip(*pair, strict=True)
        return min(lows), highs[1]
    pick = max if isinstance(formula, Both) and formula.either else min
    return pick(pair[0][0], pair[1][0]), pick(pair[0][1], pair[1][1])


def _known(name: str, term: Term, ranges: Any) -> Sequence[Range]:
    """The range of each entry of a signal, or of its one entry that is named, in its unit."""
    found = ranges(name)
    if found is not None:
        return found  # type: ignore[no-any-return]
    whole, _, entry = name.partition("[")
    found = ranges(whole) if entry else None
    if found is not None and entry[:-1].isdecimal() and int(entry[:-1]) < len(found):
        return [found[int(entry[:-1])]]
    return [(-inf, inf)] * _size(name, term)


def _size(name: str, term: Term) -> int:
    if term.name == name:
        return term.size
    return max((_size(name, part) for part in term.of), default=1)


def _metrics(name: str) -> Sequence[Range] | None:
    """The range of a number of a metric, as far as its name tells it: a time is not negative."""
    return [(0.0, inf)] if name.endswith(("_s", "_hz", ".rmse", ".max")) else None


# ---- contradictions -----------------------------------------------------------------------------


def _contradicts(formula: Robust) -> bool:
    """True if a conjunction bounds an expression from below and from above, without a number
    between the two.
    """
    least: dict[Term, float] = {}
    most: dict[Term, float] = {}
    while isinstance(formula, Extreme):
        formula = formula.of
    for inequality in _conjunction(formula):
        large, small = inequality.margin.of
        if large.constant is None and small.kind == "constant" and small.size == 1:
            least[large] = max(least.get(large, -inf), small.values[0])
        if small.constant is None and large.kind == "constant" and large.size == 1:
            most[small] = min(most.get(small, inf), large.values[0])
    return any(isfinite(x) and x > most.get(term, inf) for term, x in least.items())


def _conjunction(formula: Robust) -> list[HeldInequality]:
    """The comparisons all of which have to hold at one time."""
    if isinstance(formula, HeldInequality):
        return [formula] if formula.margin.kind == "-" else []
    if isinstance(formula, Both) and not formula.either:
        return [*_conjunction(formula.left), *_conjunction(formula.right)]
    return []
