"""Reads ``modelDescription.xml`` (FMI 2.0.5 §2.2, 3.0.2 §2.4) as far as co-simulation needs it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import prod
from pathlib import Path
from xml.etree import ElementTree

from cosim.errors import FmuError
from cosim.units import BASE, Unit

_TYPES2 = ("Real", "Integer", "Boolean", "String", "Enumeration")
_TYPES3 = (
    *(
        "Float64",
        "Float32",
        "Int8",
        "UInt8",
        "Int16",
        "UInt16",
        "Int32",
        "UInt32",
        "Int64",
        "UInt64",
    ),
    *("Boolean", "String", "Binary", "Enumeration", "Clock"),
)


@dataclass(frozen=True, slots=True)
class Variable:
    """One variable: a scalar in FMI 2.0, possibly an array in FMI 3.0."""

    name: str
    type: str
    reference: int
    causality: str
    variability: str
    initial: str
    shape: tuple[int, ...]
    unit: str
    start: tuple[str, ...]
    description: str

    @property
    def size(self) -> int:
        """Number of scalars."""
        return prod(self.shape)


@dataclass(frozen=True, slots=True)
class Description:
    """What an FMU says about itself."""

    fmi: str
    name: str
    identifier: str
    token: str
    description: str
    tool: str
    variables: tuple[Variable, ...]
    units: Mapping[str, Unit]
    flags: Mapping[str, bool]
    default_step: float | None
    kind: str | None
    step_attributes: Mapping[str, str] = field(default_factory=dict)


def read(path: Path, origin: Path) -> Description:
    """Read a model description; `origin` is the FMU named in messages. Raises FmuError."""
    try:
        root = ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise FmuError(f"{origin}: modelDescription.xml is not well-formed: {error}") from error
    version = root.get("fmiVersion", "")
    fmi = {"2": "2.0", "3": "3.0"}.get(version.split(".")[0], "")
    if root.tag != "fmiModelDescription" or not fmi:
        raise FmuError(
            f"{origin}: fmiVersion is {version!r} (root element {root.tag!r}); expected 2.0 or 3.0"
        )
    interface = root.find("CoSimulation")
    if interface is None:
        other = [n for n in ("ModelExchange", "ScheduledExecution") if root.find(n) is not None]
        raise FmuError(f"{origin}: no CoSimulation interface (found: {', '.join(other) or 'none'})")
    try:
        return _describe(root, interface, fmi, origin)
    except (ValueError, KeyError) as error:
        raise FmuError(f"{origin}: modelDescription.xml: {error}") from error


def _describe(
    root: ElementTree.Element, interface: ElementTree.Element, fmi: str, origin: Path
) -> Description:
    identifier = interface.get("modelIdentifier", "")
    token = root.get("guid" if fmi == "2.0" else "instantiationToken", "")
    if not re.fullmatch(r"[A-Za-z_]\w*", identifier):
        raise FmuError(f"{origin}: modelIdentifier is {identifier!r}; expected a C identifier")
    if not token:
        raise FmuError(f"{origin}: no {'guid' if fmi == '2.0' else 'instantiationToken'}")
    experiment = root.find("DefaultExperiment")
    step = experiment.get("stepSize") if experiment is not None else None
    variables = tuple(_variables2(root) if fmi == "2.0" else _variables3(root))
    _check_names(variables, origin)
    return Description(
        fmi=fmi,
        name=root.get("modelName", identifier),
        identifier=identifier,
        token=token,
        description=root.get("description", ""),
        tool=root.get("generationTool", ""),
        variables=variables,
        units=_units(root),
        flags={k: v in ("true", "1") for k, v in interface.attrib.items() if v in _BOOLEANS},
        default_step=float(step) if step else None,
        kind=_kind(root),
        step_attributes=dict(interface.attrib),
    )


_BOOLEANS = ("true", "false", "1", "0")


def _check_names(variables: Iterable[Variable], origin: Path) -> None:
    seen: set[str] = set()
    for variable in variables:
        if variable.name in seen:
            raise FmuError(f"{origin}: variable {variable.name!r} is declared twice")
        seen.add(variable.name)


def _variables2(root: ElementTree.Element) -> Iterable[Variable]:
    types = {
        t.get("name", ""): child.attrib
        for t in root.iterfind("TypeDefinitions/SimpleType")
        for child in t
    }
    for element in root.iterfind("ModelVariables/ScalarVariable"):
        name = element.get("name")
        typed = next((child for child in element if child.tag in _TYPES2), None)
        if not name or typed is None:
            raise ValueError(f"ScalarVariable {name!r} has no name or no type of {_TYPES2}")
        declared = types.get(typed.get("declaredType", ""), {})
        start = typed.get("start")
        yield Variable(
            name=name,
            type=typed.tag,
            reference=int(element.attrib["valueReference"]),
            causality=element.get("causality", "local"),
            variability=element.get("variability", "continuous"),
            initial=element.get("initial", ""),
            shape=(),
            unit=typed.get("unit") or declared.get("unit", ""),
            start=(start,) if start is not None else (),
            description=element.get("description", ""),
        )


def _variables3(root: ElementTree.Element) -> Iterable[Variable]:
    declared = {t.get("name", ""): t.attrib for t in root.iterfind("TypeDefinitions/*")}
    elements = [e for e in root.iterfind("ModelVariables/*") if e.tag in _TYPES3]
    sizes = {e.get("valueReference"): e.get("start", "1") for e in elements}
    for element in elements:
        default = "continuous" if element.tag.startswith("Float") else "discrete"
        inherited = declared.get(element.get("declaredType", ""), {})
        yield Variable(
            name=element.attrib["name"],
            type=element.tag,
            reference=int(element.attrib["valueReference"]),
            causality=element.get("causality", "local"),
            variability=element.get("variability", default),
            initial=element.get("initial", ""),
            shape=tuple(_dimension(d, sizes) for d in element.iterfind("Dimension")),
            unit=element.get("unit") or inherited.get("unit", ""),
            start=_starts(element),
            description=element.get("description", ""),
        )


def _starts(element: ElementTree.Element) -> tuple[str, ...]:
    if element.tag in ("String", "Binary"):
        return tuple(s.get("value", "") for s in element.iterfind("Start"))
    return tuple(element.get("start", "").split())


def _dimension(element: ElementTree.Element, sizes: Mapping[str | None, str]) -> int:
    start = element.get("start")
    return int(start if start is not None else sizes[element.get("valueReference")])


def _units(root: ElementTree.Element) -> dict[str, Unit]:
    units: dict[str, Unit] = {}
    for element in root.iterfind("UnitDefinitions/Unit"):
        base = element.find("BaseUnit")
        if base is None:
            continue
        units[element.get("name", "")] = Unit(
            tuple(int(base.get(name, "0")) for name in BASE),
            float(base.get("factor", "1")),
            float(base.get("offset", "0")),
        )
    return units


def _kind(root: ElementTree.Element) -> str | None:
    """Our own annotation: whether the FMU samples (a controller) or integrates (a plant)."""
    for element in root.iter("Component"):
        if element.get("kind") in ("sampled", "continuous"):
            return element.get("kind")
    return None
