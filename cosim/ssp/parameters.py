"""Parameter sets that are written: values of a plan and texts, in the units of their variables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree.ElementTree import Element, SubElement

from cosim.fmi.component import FmuComponent
from cosim.fmi.file.ports import VariableGroup

_NAMES = "http://ssp-standard.org/SSP1/"
SSC, SSD, SSV = (
    f"{_NAMES}{name}"
    for name in (
        "SystemStructureCommon",
        "SystemStructureDescription",
        "SystemStructureParameterValues",
    )
)
#: What every parameter set is called; Ecos applies the sets of a name.
VALUES = "initialValues"
_TYPES = {**dict.fromkeys(("Real", "Float64", "Float32", "Clock"), "Real"), "Boolean": "Boolean"}

#: A value of a parameter set: name of the variable, type of the element, and text.
Entry = tuple[str, str, str]


def values_of(
    fmu: FmuComponent, values: Mapping[str, Sequence[float]], texts: Mapping[str, Any]
) -> list[Entry]:
    """Flattened `values` by port, each in its unit, and `texts`, as entries of a parameter set."""
    found = []
    for name, numbers in sorted(values.items()):
        group = fmu.groups[name]
        literals = [literal(group, x) for x in numbers]
        if group.first.shape:
            found.append((name, type_of(group), " ".join(literals)))
        else:
            names = (v.name for v in group.variables)
            found += [(n, type_of(group), x) for n, x in zip(names, literals, strict=True)]
    for name, text in sorted(texts.items()):
        found.append((name, fmu.groups[name].first.type, str(text)))
    return found


def binding(entries: Sequence[Entry]) -> Element:
    """A ParameterBinding with a set of these entries inside."""
    made = Element(f"{{{SSD}}}ParameterBinding")
    inner = SubElement(made, f"{{{SSD}}}ParameterValues")
    values = SubElement(inner, f"{{{SSV}}}ParameterSet", version="1.0", name=VALUES)
    parameters = SubElement(values, f"{{{SSV}}}Parameters")
    for name, kind, text in entries:
        parameter = SubElement(parameters, f"{{{SSV}}}Parameter", name=name)
        SubElement(parameter, f"{{{SSV}}}{kind}", value=text)
    return made


def type_of(group: VariableGroup) -> str:
    """The type of SSP 1.0 of a variable that is a number."""
    return _TYPES.get(group.first.type, "Integer")


def literal(group: VariableGroup, value: float) -> str:
    """A value, in the unit of its variable, written as the type of the variable requires."""
    kind = type_of(group)
    if kind == "Real":
        return repr(float(value))
    return str(int(value)) if kind == "Integer" else ("true" if value else "false")
