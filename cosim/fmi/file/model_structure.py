"""The ModelStructure: states, and what outputs depend on (FMI 2.0.5 §2.2.8, 3.0.2 §2.4.8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from xml.etree.ElementTree import Element

from cosim.base.convert import Struct
from cosim.fmi.file.ports import REAL
from cosim.fmi.file.variables import FmuVariable

#: Names of the variables that each output depends on directly. What is not in it is not stated.
Dependencies = Mapping[str, frozenset[str]]

_STEPPING = {
    "1.0": "ModelStructure",
    "2.0": "ModelStructure/Outputs/Unknown",
    "3.0": "ModelStructure/Output",
}
_STARTING = {
    "1.0": "ModelStructure",  # there is none
    "2.0": "ModelStructure/InitialUnknowns/Unknown",
    "3.0": "ModelStructure/InitialUnknown",
}


class ContinuousStates(Struct, frozen=True):
    """The states of an FMU for model exchange, in the order of the vectors that it gives and takes.

    `references` and `rates`: value references of the states and of their derivatives (arrays of
    FMI 3.0 are one reference each); `count`, `indicators`: numbers of scalars. `completed`: whether
    the FMU must be told of each step of the solver; `directional`: whether it has directional
    derivatives.
    """

    references: tuple[int, ...]
    rates: tuple[int, ...]
    count: int
    indicators: int
    completed: bool
    directional: bool


def read_states(
    root: Element, interface: Element, fmi: str, variables: Sequence[FmuVariable]
) -> ContinuousStates:
    """The states that the ModelStructure lists. Raises ValueError for a derivative of no state."""
    if fmi == "1.0":  # which lists neither states nor derivatives
        count, indicators = (
            int(root.get(f"numberOf{what}", "0"))
            for what in ("ContinuousStates", "EventIndicators")
        )
        return ContinuousStates((), (), count, indicators, completed=True, directional=False)
    flags = {name: value in ("true", "1") for name, value in interface.attrib.items()}
    if fmi == "2.0":
        by = {i + 1: v for i, v in enumerate(variables)}
        entries = root.iterfind("ModelStructure/Derivatives/Unknown")
        rates = [_found(by, e.get("index", ""), "derivative") for e in entries]
        indicators = int(root.get("numberOfEventIndicators", "0"))
        completed = not flags.get("completedIntegratorStepNotNeeded", False)
        directional = flags.get("providesDirectionalDerivative", False)
    else:
        by = {v.reference: v for v in variables}
        entries = root.iterfind("ModelStructure/ContinuousStateDerivative")
        rates = [_found(by, e.get("valueReference", ""), "derivative") for e in entries]
        found = root.iterfind("ModelStructure/EventIndicator")
        marks = [_found(by, e.get("valueReference", ""), "event indicator") for e in found]
        indicators = sum(v.size for v in marks)
        completed = flags.get("needsCompletedIntegratorStep", False)
        directional = flags.get("providesDirectionalDerivatives", False)
    states = [_found(by, v.attributes.get("derivative", ""), f"state of {v.name}") for v in rates]
    for v in (*states, *rates):
        if v.type not in REAL:
            raise ValueError(f"variable {v.name!r} of type {v.type} cannot be a continuous state")
    return ContinuousStates(
        references=tuple(v.reference for v in states),
        rates=tuple(v.reference for v in rates),
        count=sum(v.size for v in states),
        indicators=indicators,
        completed=completed,
        directional=directional,
    )


def _found(by: Mapping[int, FmuVariable], text: str, what: str) -> FmuVariable:
    if not text.isdecimal() or int(text) not in by:
        raise ValueError(f"ModelStructure: {what}: {text!r} names no variable")
    return by[int(text)]


def read_dependencies(
    root: Element, fmi: str, variables: Sequence[FmuVariable]
) -> tuple[Dependencies, Dependencies]:
    """The dependencies of a run, and those of Initialization Mode where they differ.

    An entry with the number of no variable states nothing.
    """
    stepping = _entries(root, _STEPPING[fmi], fmi, variables)
    starting = _entries(root, _STARTING[fmi], fmi, variables)
    return stepping, {name: starting.get(name, known) for name, known in stepping.items()}


def _entries(
    root: Element, path: str, fmi: str, variables: Sequence[FmuVariable]
) -> dict[str, frozenset[str]]:
    if fmi == "2.0":
        key, by = "index", {str(i + 1): v.name for i, v in enumerate(variables)}
    else:
        key, by = "valueReference", {str(v.reference): v.name for v in variables}
    found = {}
    for element in root.iterfind(path):
        given = element.get("dependencies")
        if given is None:
            continue
        named = [element.get(key, ""), *given.split()]
        if all(text in by for text in named):
            found[by[named[0]]] = frozenset(by[text] for text in named[1:])
    return found
