"""Model descriptions of FMI 1.0 (§3 there), in the words of later versions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any
from xml.etree.ElementTree import Element

from cosim.fmi.file.variables import TYPES2, FmuVariable, limits_of

#: The reference of a variable that has no value.
_UNDEFINED = 4294967295


def interface1(root: Element) -> Element:
    """The element CoSimulation or ModelExchange that FMI 2.0 would have. Raises ValueError if it
    cannot be run.
    """
    alone = root.find("Implementation/CoSimulation_StandAlone")
    if alone is None and root.find("Implementation") is not None:
        raise ValueError(
            "found FMI 1.0 for co-simulation by a tool; expected FMI 1.0 for co-simulation alone "
            "or for model exchange, or FMI 2.0 or 3.0"
        )
    if alone is None:
        return Element("ModelExchange", {"modelIdentifier": root.get("modelIdentifier", "")})
    capabilities = alone.find("Capabilities")
    known: dict[str, str] = {} if capabilities is None else dict(capabilities.attrib)
    return Element("CoSimulation", {**known, "modelIdentifier": root.get("modelIdentifier", "")})


def variables1(root: Element) -> Iterator[FmuVariable]:
    """The variables of FMI 1.0; a negated alias is left out unless it is an input or output.

    Raises ValueError or KeyError for what cannot be one, and for an input or output that is a
    negated alias.
    """
    types = {t.get("name", ""): child for t in root.iterfind("TypeDefinitions/Type") for child in t}
    for element in root.iterfind("ModelVariables/ScalarVariable"):
        name, reference = element.attrib["name"], int(element.attrib["valueReference"])
        typed = next((child for child in element if child.tag in TYPES2), None)
        if typed is None:
            raise ValueError(f"ScalarVariable {name!r} has no type of {TYPES2}")
        port = element.get("causality") in ("input", "output")
        if element.get("alias") == "negatedAlias":
            if port:
                raise ValueError(
                    f"variable {name!r} is a negated alias; expected an input or output with a "
                    "value of its own, or an alias"
                )
            continue
        if reference != _UNDEFINED:
            yield _variable(element, typed, _declared(types, typed, name), name, reference)


def _variable(
    element: Element, typed: Element, declared: Element | None, name: str, reference: int
) -> FmuVariable:
    attributes = {**(declared.attrib if declared is not None else {}), **typed.attrib}
    start = typed.get("start")
    kept = (start,) if start is not None else ()
    fixed = typed.get("fixed", "true") in ("true", "1")
    causality, variability = _roles(element, kept)
    return FmuVariable(
        name=name,
        type=typed.tag,
        reference=reference,
        causality=causality,
        variability=variability,
        initial=("exact" if fixed else "approx") if kept and causality != "input" else "",
        shape=(),
        unit=attributes.get("unit", ""),
        start=kept,
        description=element.get("description", ""),
        limits=limits_of(name, attributes),
        items=_items(declared),
        attributes={**attributes, **element.attrib},
    )


def _roles(element: Element, start: tuple[str, ...]) -> tuple[str, str]:
    """Causality and variability; a parameter without a start value is computed by the FMU."""
    causality = element.get("causality", "internal")
    variability = element.get("variability", "continuous")
    typed = next((child.tag for child in element if child.tag in TYPES2), "")
    if variability == "continuous" and typed != "Real":
        variability = "discrete"
    if causality in ("input", "output"):
        return causality, "fixed" if variability == "parameter" else variability
    if variability == "parameter":
        return ("parameter" if start else "calculatedParameter"), "fixed"
    return "local", variability


def _declared(types: Mapping[str, Element], typed: Element, name: str) -> Element | None:
    wanted = typed.get("declaredType")
    if wanted is not None and wanted not in types:
        raise ValueError(f"variable {name!r}: no type {wanted!r} is defined")
    return None if wanted is None else types[wanted]


def _items(declared: Element | None) -> dict[str, int]:
    """Items of an enumeration are numbered from 1."""
    if declared is None:
        return {}
    items: Any = declared.iterfind("Item")
    return {item.attrib["name"]: i for i, item in enumerate(items, start=1)}
