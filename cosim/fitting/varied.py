"""Parameters that a fit varies: read from texts like ``m:0.5..2`` or ``arm.theta[1]=1:0.1..5``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cosim.base.component import Parameter
from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.base.names import unknown
from cosim.schedule.parts import Step
from cosim.schedule.plan import Plan

_TEXT = re.compile(r"(?P<name>[^=]+?)(?:=(?P<start>[^:]+))?:(?P<low>.+?)\.\.(?P<high>.+)$")
_INDEX = re.compile(r"\[(\d+(?:,\d+)*)\]$")


@dataclass(frozen=True, slots=True)
class Varied:
    """One number of a parameter: entry `index` of its flattened values, from `low` to `high`.

    All in the parameter's `unit`; `start`: where the fit begins. `entries`: how many it has.
    """

    component: str
    parameter: str
    index: int
    entries: int
    unit: str
    low: float
    high: float
    start: float
    label: str

    @property
    def name(self) -> str:
        """``component.parameter``, with the entry of an array."""
        return f"{self.component}.{self.label}"


def varied(plan: Plan, texts: Sequence[str]) -> tuple[Varied, ...]:
    """The parameters that these texts name. Raises ScenarioError for what cannot be varied."""
    found = [_varied(plan, text) for text in texts]
    names = [v.name for v in found]
    for name in names:
        if names.count(name) > 1:
            raise ScenarioError(f"--vary: found {name} more than once")
    return tuple(found)


def with_values(plan: Plan, parameters: Sequence[Varied], values: Sequence[float]) -> list[Step]:
    """The components of the plan with these values of the parameters, in their units."""
    steps = {s.name: dict(s.values) for s in plan.components}
    for v, value in zip(parameters, values, strict=True):
        given = steps[v.component]
        flat = list(given.get(v.parameter) or _declared(plan, v.component, v.parameter).default)
        flat[v.index] = float(value)
        given[v.parameter] = tuple(flat)
    return [_replaced(s, steps[s.name]) for s in plan.components]


def _replaced(step: Step, values: dict[str, tuple[float, ...]]) -> Step:
    return replace(step, values=values)


def _varied(plan: Plan, text: str) -> Varied:
    place = f"--vary {text!r}"
    match = _TEXT.match(text)
    if match is None:
        raise ScenarioError("expected NAME:LOW..HIGH or NAME=START:LOW..HIGH", place)
    component, parameter, label = _named(plan, match["name"].strip(), place)
    index = _index(parameter, label, place)
    low, high = (_number(match[key], place) for key in ("low", "high"))
    if not low < high:
        raise ScenarioError(f"expected LOW below HIGH, found {low:g} and {high:g}", place)
    given = plan.component(component).values.get(parameter.name) or parameter.default
    default = min(max(given[index], low), high)
    start = default if match["start"] is None else _number(match["start"], place)
    if not low <= start <= high:
        raise ScenarioError(f"the start {start:g} is not from {low:g} to {high:g}", place)
    if parameter.type != "real":
        raise ScenarioError(f"{label} is a {parameter.type}; expected a real parameter", place)
    return Varied(
        component, parameter.name, index, parameter.size, parameter.unit, low, high, start, label
    )


def _named(plan: Plan, name: str, place: str) -> tuple[str, Parameter, str]:
    """(component, parameter, what is behind the component) of ``component.parameter[i]``.

    The component may be left out where only one has such a parameter.
    """
    head, dot, rest = name.partition(".")
    names = {s.name for s in plan.components}
    within = [(head, rest)] if dot and head in names else [(s, name) for s in sorted(names)]
    found = [
        (component, p, label)
        for component, label in within
        for p in plan.component(component).component.parameters
        if p.name in (label, _INDEX.sub("", label))
    ]
    if len(found) > 1:
        where = ", ".join(f"{c}.{label}" for c, _, label in found)
        raise ScenarioError(f"{name} is ambiguous; expected one of {where}", place)
    if not found:
        known = [f"{s.name}.{p.name}" for s in plan.components for p in s.component.parameters]
        raise ScenarioError(unknown(name, known, "parameter"), place)
    return found[0]


def _index(parameter: Parameter, label: str, place: str) -> int:
    match = None if label == parameter.name else _INDEX.search(label)
    if match is None:
        if parameter.size != 1:
            raise ScenarioError(
                f"{label} has the shape {list(parameter.shape)}; expected one entry, such as "
                f"{label}[{','.join(str(parameter.base) for _ in parameter.shape)}]",
                place,
            )
        return 0
    at = tuple(int(i) - parameter.base for i in match[1].split(","))
    if len(at) != len(parameter.shape) or any(
        not 0 <= i < n for i, n in zip(at, parameter.shape, strict=False)
    ):
        raise ScenarioError(
            f"{label} is outside of the shape {list(parameter.shape)} of {parameter.name}", place
        )
    return int(np.ravel_multi_index(at, parameter.shape))


def _declared(plan: Plan, component: str, name: str) -> Parameter:
    return next(p for p in plan.component(component).component.parameters if p.name == name)


def _number(text: str, place: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ScenarioError(f"{text.strip()!r} is not a number", place) from None
    if not np.isfinite(value):
        raise ScenarioError(f"{text.strip()!r} is not finite", place)
    return value
