"""Reads ``modelDescription.xml`` (FMI 1.0, 2.0.5 §2.2, 3.0.2 §2.4) as far as a run needs it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property, lru_cache
from math import isfinite, isnan
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from cosim.base.convert import Struct, field
from cosim.base.errors import FmuError
from cosim.base.units import BASE, Unit
from cosim.fmi.file.archive import unpack
from cosim.fmi.file.model_structure import (
    ContinuousStates,
    Dependencies,
    read_dependencies,
    read_states,
)
from cosim.fmi.file.ports import VariableGroup, groups
from cosim.fmi.file.variables import NUMERIC, FmuVariable, variables2, variables3


class Description(Struct, frozen=True, dict=True):
    """The model description of an FMU, which all its instances share.

    `ignored`: sentences about what was found in it and is not used.
    """

    fmi: str
    name: str
    identifier: str
    token: str
    description: str
    tool: str
    variables: tuple[FmuVariable, ...]
    units: Mapping[str, Unit]
    flags: Mapping[str, bool]
    default_step: float | None  # s; like the next three, of the DefaultExperiment
    default_stop: float | None  # s
    tolerance: float | None
    default_start: float  # s
    kind: str | None
    optional: frozenset[str] = frozenset()  # inputs that are often left unfed
    step_attributes: Mapping[str, str] = field(default_factory=dict)
    interfaces: tuple[str, ...] = ("CoSimulation",)  # of those in INTERFACES, what there is
    interface: str = "CoSimulation"  # of those, by which it is run
    states: ContinuousStates | None = None  # of model exchange, else None
    dependencies: tuple[Dependencies, Dependencies] = ({}, {})  # in a run, and at its start
    ignored: tuple[str, ...] = ()

    @property
    def scheduled(self) -> bool:
        """True if it is run by scheduled execution: its clocks activate its partitions."""
        return self.interface == "ScheduledExecution"

    @cached_property
    def derived(self) -> dict[Any, Any]:
        """Values computed from it so far, by what they depend on."""
        return {}

    @cached_property
    def groups(self) -> Mapping[str, VariableGroup]:
        """The signals that the variables are, by name."""
        return {g.name: g for g in groups(self.variables)}


#: Interfaces that a run uses, in the order of preference, and what they are called.
INTERFACES = {
    "CoSimulation": "co-simulation",
    "ModelExchange": "model exchange",
    "ScheduledExecution": "scheduled execution",
}


def read(
    path: str | Path, origin: Path, sizes: Mapping[str, int] | None = None, interface: str = ""
) -> Description:
    """Read a model description; `origin` is the FMU named in messages.

    `sizes`: of structural parameters (FMI 3.0), where they are not what is written.
    `interface`: one of :data:`INTERFACES`; "": the first that there is. Raises FmuError.
    """
    path = Path(path)
    try:
        root = ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, ValueError, LookupError, OSError) as error:
        raise FmuError(f"{origin}: modelDescription.xml is not well-formed: {error}") from error
    version = root.get("fmiVersion", "")
    fmi = {"1": "1.0", "2": "2.0", "3": "3.0"}.get(version.split(".")[0], "")
    if root.tag != "fmiModelDescription" or not fmi:
        raise FmuError(
            f"{origin}: fmiVersion is {version!r} (root element {root.tag!r}); "
            "expected 1.0, 2.0 or 3.0"
        )
    try:
        chosen = _interface(root, fmi, origin, interface)
        return _describe(root, chosen, fmi, origin, sizes or {})
    except KeyError as error:
        raise FmuError(f"{origin}: modelDescription.xml: a variable has no {error}") from error
    except (ValueError, OverflowError) as error:
        raise FmuError(f"{origin}: modelDescription.xml: {error}") from error


@lru_cache(maxsize=64)
def read_cached(
    folder: Path, origin: Path, sizes: tuple[tuple[str, int], ...] = (), interface: str = ""
) -> Description:
    """Read the description in a folder that its contents name, once: it cannot change."""
    return read(folder / "modelDescription.xml", origin, dict(sizes), interface)


def structural_sizes(path: str | Path) -> frozenset[str]:
    """Names of the structural parameters of an FMU that are sizes of arrays. Raises FmuError."""
    archive = unpack(path)
    found = read_cached(archive.folder, archive.path)
    return frozenset(v.name for v in found.variables if v.is_size)


def _interfaces(root: ElementTree.Element, fmi: str) -> dict[str, ElementTree.Element]:
    """The :data:`INTERFACES` of an FMU; FMI 2.0 has no scheduled execution.

    Raises ValueError for FMI 1.0 that cannot be run.
    """
    if fmi == "1.0":
        from cosim.fmi.file.description1 import interface1

        found = interface1(root)
        return {found.tag: found}
    known = [name for name in INTERFACES if fmi != "2.0" or name != "ScheduledExecution"]
    there = ((name, root.find(name)) for name in known)
    return {name: element for name, element in there if element is not None}


def _interface(
    root: ElementTree.Element, fmi: str, origin: Path, wanted: str
) -> ElementTree.Element:
    there = _interfaces(root, fmi)
    for name in [wanted] if wanted else there:
        if name in there:
            return there[name]
    expected = INTERFACES.get(wanted) or "co-simulation, model exchange or scheduled execution"
    raise FmuError(
        f"{origin}: found the interfaces {', '.join(there) or 'none'}; expected an FMU exported "
        f"for {expected}"
    )


def _describe(
    root: ElementTree.Element,
    interface: ElementTree.Element,
    fmi: str,
    origin: Path,
    sizes: Mapping[str, int],
) -> Description:
    identifier = interface.get("modelIdentifier", "")
    word = "instantiationToken" if fmi == "3.0" else "guid"
    token = root.get(word, "")  # which the FMU itself accepts or refuses
    if not re.fullmatch(r"\w[\w .+-]*", identifier):
        raise FmuError(f"{origin}: modelIdentifier is {identifier!r}; expected a C identifier")
    experiment = root.find("DefaultExperiment")
    if fmi != "3.0" and sizes:
        raise FmuError(f"{origin}: FMI {fmi} has no structural parameters, found {sorted(sizes)}")
    every = tuple(_variables(root, fmi, sizes))
    variables, ignored = _named_once(every)
    ticked = any(v.type == "Clock" and v.causality == "input" for v in variables)
    if interface.tag == "ScheduledExecution" and not ticked:
        raise FmuError(f"{origin}: has no input clock, which scheduled execution needs")
    kind, optional = _ours(root)
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
        default_step=_positive(experiment, "stepSize"),
        default_stop=_positive(experiment, "stopTime"),
        tolerance=_positive(experiment, "tolerance"),
        default_start=_start(experiment),
        kind=kind,
        optional=optional,
        step_attributes=dict(interface.attrib),
        interfaces=tuple(_interfaces(root, fmi)),
        interface=interface.tag,
        states=read_states(root, interface, fmi, every)
        if interface.tag == "ModelExchange"
        else None,
        dependencies=read_dependencies(root, fmi, every),
        ignored=(*ignored, *_unusable_starts(variables)),
    )


def _variables(
    root: ElementTree.Element, fmi: str, sizes: Mapping[str, int]
) -> Iterable[FmuVariable]:
    if fmi == "3.0":
        return variables3(root, sizes)
    if fmi == "2.0":
        return variables2(root)
    from cosim.fmi.file.description1 import variables1

    return variables1(root)


_BOOLEANS = ("true", "false", "1", "0")


def _positive(experiment: ElementTree.Element | None, name: str) -> float | None:
    """An attribute of the DefaultExperiment; None: it is absent, or 0 or infinite, which says as
    much. Raises ValueError.
    """
    text = experiment.get(name) if experiment is not None else None
    if not text:
        return None
    value = float(text)
    if isnan(value) or value < 0.0:
        raise ValueError(f"{name} {text!r} is not a positive number")
    return value if isfinite(value) and value > 0.0 else None


def _start(experiment: ElementTree.Element | None) -> float:
    """The startTime of the DefaultExperiment, s; 0 where it is absent. Raises ValueError."""
    text = experiment.get("startTime") if experiment is not None else None
    value = float(text) if text else 0.0
    if not isfinite(value):
        raise ValueError(f"startTime {text!r} is not a number")
    return value


def _named_once(
    variables: Sequence[FmuVariable],
) -> tuple[tuple[FmuVariable, ...], list[str]]:
    """The variables without later ones of the same name, and what is said of these."""
    found: dict[str, FmuVariable] = {}
    ignored = []
    for variable in variables:
        first = found.setdefault(variable.name, variable)
        if first is not variable:
            ignored.append(
                f"variable {variable.name!r} is declared twice: that of value reference "
                f"{first.reference} is used, that of {variable.reference} is not"
            )
    return tuple(found.values()), ignored


def _unusable_starts(variables: Iterable[FmuVariable]) -> Iterator[str]:
    for v in variables:
        text = v.attributes.get("start", "")
        if text and not v.start and v.type in NUMERIC:
            yield f"variable {v.name!r} has the start {text!r}, which is no number: none is taken"


def _units(root: ElementTree.Element) -> dict[str, Unit]:
    """Definitions by name; display units are another way to write a number, and are not read."""
    units: dict[str, Unit] = {}
    for element in root.iterfind("UnitDefinitions/Unit"):
        base, name = element.find("BaseUnit"), element.get("name", "")
        if base is None:
            continue
        try:
            exponents = tuple(int(base.get(b, "0")) for b in BASE)
            factor, offset = float(base.get("factor", "1")), float(base.get("offset", "0"))
        except ValueError as error:
            raise ValueError(f"unit {name!r}: {error}") from None
        if not (isfinite(factor) and isfinite(offset) and factor != 0.0):
            raise ValueError(
                f"unit {name!r}: factor {factor:g} and offset {offset:g} do not define a scale"
            )
        units[name] = Unit(exponents, factor, offset)
    return units


def _ours(root: ElementTree.Element) -> tuple[str | None, frozenset[str]]:
    """Our annotation: whether the FMU samples (a controller) or integrates (a plant), and inputs
    that are often left unfed.
    """
    for element in root.iter("Component"):
        if element.get("kind") in ("sampled", "continuous"):
            return element.get("kind"), frozenset(element.get("optional", "").split())
    return None, frozenset()
