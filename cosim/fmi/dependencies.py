"""What outputs depend on, as the ModelStructure says (FMI 2.0.5 §2.2.8, 3.0.2 §2.4.8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from xml.etree.ElementTree import Element

from cosim.fmi.variables import FmuVariable

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


def read_dependencies(
    root: Element, fmi: str, variables: Sequence[FmuVariable]
) -> tuple[Dependencies, Dependencies]:
    """Those of a run, and those of Initialization Mode where these are other ones.

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
