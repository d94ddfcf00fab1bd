"""Attributes of a model that FMI 2.0 and FMI 3.0 express alike."""

from __future__ import annotations

import os
from collections.abc import Iterable
from datetime import UTC, datetime
from xml.etree.ElementTree import Element, SubElement

from cosim.base.units import BASE, parse
from fmus.model import Model, Variable

_CATEGORIES = {
    "logEvents": "Instantiation and initialization",
    "logStatusWarning": "Messages of calls that return a warning",
    "logStatusDiscard": "Messages of steps that are discarded",
    "logStatusError": "Messages of calls that are refused",
    "logAll": "All messages",
}
_STEPS = 1000  # of the default experiment

#: An unknown and the names of what it depends on.
Unknown = tuple[Variable, tuple[str, ...]]


def outputs(model: Model) -> list[Unknown]:
    """Every output and the inputs it depends on."""
    inputs = {v.name for v in model.variables if v.causality == "input"}
    states = tuple(state for state, _ in model.states) if model.exchange else ()
    return [
        (v, (*(name for name in v.depends if name in inputs), *states))
        for v in model.variables
        if v.causality == "output"
    ]


def derivatives(model: Model) -> list[Unknown]:
    """The derivative of every state of an FMU for model exchange: it depends on everything."""
    if not model.exchange:
        return []
    rates = {rate: state for state, rate in model.states}
    states = tuple(rates.values())
    inputs = tuple(v.name for v in model.variables if v.causality == "input")
    by_name = {v.name: v for v in model.variables}
    return [
        (by_name[rate], (rate,) if rate in states else (*inputs, *states))
        for _, rate in model.states
    ]


def initial_unknowns(model: Model) -> list[Unknown]:
    """All outputs calculated at the start, with their dependencies there."""
    return [
        (v, (*v.depends, *v.start_depends))
        for v in model.variables
        if v.causality == "output" and not v.settable
    ] + [
        (v, (*names, *(p.name for p in model.variables if p.causality == "parameter")))
        for v, names in derivatives(model)
        if not v.settable
    ]


def dependencies(on: Iterable[int]) -> dict[str, str]:
    """Attributes of an unknown that depends on the unknowns numbered `on`."""
    numbers = sorted(set(on))
    return {
        "dependencies": " ".join(map(str, numbers)),
        "dependenciesKind": " ".join("dependent" for _ in numbers),
    }


def identify(root: Element, model: Model) -> None:
    """Description, version, tool and date; the date only where SOURCE_DATE_EPOCH gives one."""
    root.set("description", model.description)
    root.set("version", model.version)
    root.set("generationTool", "cosim fmus")
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    if epoch is not None:
        made = datetime.fromtimestamp(int(epoch), tz=UTC)
        root.set("generationDateAndTime", made.strftime("%Y-%m-%dT%H:%M:%SZ"))
    root.set("variableNamingConvention", "structured")


def attributes(variable: Variable, model: Model) -> dict[str, str]:
    """Description, causality, variability and initial of a variable."""
    found = {"description": variable.description} if variable.description else {}
    found["causality"] = variable.causality
    if variable.causality in ("structuralParameter", "parameter"):
        found["variability"] = "fixed"
    elif model.kind == "sampled" or variable.type != "real":
        found["variability"] = "discrete"
    else:
        found["variability"] = "continuous"
    if variable.causality in ("output", "local"):
        found["initial"] = "exact" if variable.settable else "calculated"
    elif variable.causality in ("structuralParameter", "parameter"):
        found["initial"] = "exact"
    return found


def has_start(variable: Variable) -> bool:
    """True if a variable is given a start value, rather than calculated."""
    given = ("structuralParameter", "parameter", "input")
    return variable.settable or variable.causality in given


def as_text(variable: Variable, values: Iterable[float]) -> list[str]:
    """Values, in the unit of the variable, as text of the variable's type."""
    if variable.type == "real":
        return [repr(float(value)) for value in values]
    if variable.type in ("integer", "size"):
        return [str(int(value)) for value in values]
    return ["true" if value else "false" for value in values]


def limits(element: Element, variable: Variable) -> None:
    """Set min and max."""
    if variable.type == "boolean":
        return
    for name, limit in (("min", variable.minimum), ("max", variable.maximum)):
        if limit is not None:
            element.set(name, *as_text(variable, [limit]))


def units(root: Element, model: Model) -> None:
    """All units in use, in base units."""
    definitions = SubElement(root, "UnitDefinitions")
    for name in sorted({"s"} | {v.unit for v in model.variables if v.type == "real"}):
        unit = parse(name)
        base = SubElement(SubElement(definitions, "Unit", name=name), "BaseUnit")
        for symbol, exponent in zip(BASE, unit.exponents, strict=True):
            if exponent:
                base.set(symbol, str(exponent))
        if unit.factor != 1.0:
            base.set("factor", repr(unit.factor))
        if unit.offset != 0.0:
            base.set("offset", repr(unit.offset))


def categories(root: Element) -> None:
    """The log categories of the C layer."""
    listed = SubElement(root, "LogCategories")
    for name, description in _CATEGORIES.items():
        SubElement(listed, "Category", name=name, description=description)


def experiment(root: Element, model: Model) -> None:
    """A run of a thousand steps."""
    SubElement(
        root,
        "DefaultExperiment",
        startTime="0.0",
        stopTime=repr(_STEPS * model.step),
        stepSize=repr(model.step),
    )
