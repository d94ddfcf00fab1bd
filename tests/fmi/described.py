"""The variables in a model description, as FMPy reads it."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from fmpy import read_model_description

_TYPES2 = {"Enumeration": "Integer"}
_TYPES3 = {"Enumeration": "Int64"}


@dataclass(frozen=True, slots=True)
class Known:
    """A variable; `initial` with the defaults of the standard, "" for an input of FMI 2.0."""

    name: str
    causality: str
    variability: str
    initial: str
    clocks: tuple[int, ...]
    unknown: bool  # an output, state, derivative, or among the initial unknowns

    @property
    def parameter(self) -> bool:
        return self.causality in ("parameter", "structuralParameter")


@dataclass(frozen=True, slots=True)
class Described:
    """`variables` by type and value reference: aliases share them; `flags` by interface."""

    fmi: str
    variables: dict[tuple[str, int], list[Known]]
    flags: dict[str, set[str]]

    def of(self, kind: str, reference: int) -> list[Known]:
        names = _TYPES2 if self.fmi == "2" else _TYPES3
        return self.variables.get((names.get(kind, kind), reference), [])


def described(fmu: Path) -> Described:
    found = read_model_description(str(fmu), validate=False)
    two = found.fmiVersion.startswith("2")
    unknown = {id(u.variable) for u in (*found.outputs, *found.derivatives, *found.initialUnknowns)}
    unknown |= {id(u.variable.derivative) for u in found.derivatives}
    variables: dict[tuple[str, int], list[Known]] = {}
    for v in found.modelVariables:
        variability = v.variability or ("continuous" if v.type in ("Real", "Float64", "Float32")
                                        else "discrete")  # fmt: skip
        causality = v.causality or "local"
        given = "" if two and causality == "input" else v.initial
        known = Known(
            v.name, causality, variability, given or _initial(causality, variability, two),
            tuple(int(c.valueReference) for c in (getattr(v, "clocks", None) or ())),
            causality == "output" or id(v) in unknown,
        )  # fmt: skip
        kind = (_TYPES2 if two else _TYPES3).get(v.type, v.type)
        variables.setdefault((kind, int(v.valueReference)), []).append(known)
    return Described("2" if two else "3", variables, _flags(fmu))


def _flags(fmu: Path) -> dict[str, set[str]]:
    """Capabilities that are true, as they are written."""
    with zipfile.ZipFile(fmu) as archive:
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    kinds = ("CoSimulation", "ModelExchange", "ScheduledExecution")
    return {
        kind: {name for name, value in element.attrib.items() if value in ("true", "1")}
        for kind in kinds
        for element in root.findall(kind)
    }


def _initial(causality: str, variability: str, two: bool) -> str:
    """FMI 2.0.5 table in 2.2.7, 3.0.2 table in 2.4.7.5."""
    if causality == "input":
        return "" if two else "exact"
    if causality in ("parameter", "structuralParameter") or variability == "constant":
        return "exact"
    return "" if causality == "independent" else "calculated"
