"""``modelDescription.xml`` of FMI 2.0.5 (clause 2.2 and 4.3).

Scalars only: ``q[0]``, ``xi_in[0,1]`` (structured names). A value reference is the place of a
scalar in the C struct; the last one is the time.
"""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree.ElementTree import Element, SubElement

from fmus.build.source import c_files, scalars, token
from fmus.model import Model, Variable, annotation, attributes

_TYPE = {"real": "Real", "integer": "Integer", "boolean": "Boolean"}


def describe(model: Model) -> Element:
    """``modelDescription.xml`` as an element."""
    root = Element("fmiModelDescription", fmiVersion="2.0", modelName=model.identifier)
    root.set("guid", token(model))
    attributes.identify(root, model)
    root.set("numberOfEventIndicators", "0")
    own = {"canHandleVariableCommunicationStepSize": "true"}
    if model.exchange:
        own = {"completedIntegratorStepNotNeeded": "true", "providesDirectionalDerivative": "true"}
    interface = SubElement(
        root,
        "ModelExchange" if model.exchange else "CoSimulation",
        {
            "modelIdentifier": model.identifier,
            **own,
            "canNotUseMemoryManagementFunctions": "true",
            "canGetAndSetFMUstate": "true",
            "canSerializeFMUstate": "true",
        },
    )
    files = SubElement(interface, "SourceFiles")
    for name in c_files(model):
        SubElement(files, "File", name=name)
    attributes.units(root, model)
    attributes.categories(root)
    attributes.experiment(root, model)
    tool = SubElement(SubElement(root, "VendorAnnotations"), "Tool", name="cosim")
    SubElement(tool, "Component", annotation(model.kind, model.inputs()))
    _variables(SubElement(root, "ModelVariables"), model)
    _structure(SubElement(root, "ModelStructure"), model)
    return root


def _variables(listed: Element, model: Model) -> None:
    reference = 0
    first, at = {}, 0
    for variable in model.variables:
        first[variable.name], at = at, at + variable.size
    states = {rate: first[state] for state, rate in model.states} if model.exchange else {}
    for variable in model.variables:
        starts = attributes.as_text(variable, variable.starts)
        for name, start in zip(scalars(variable), starts, strict=True):
            scalar = SubElement(listed, "ScalarVariable", name=name)
            scalar.attrib |= {"valueReference": str(reference)} | attributes.attributes(
                variable, model
            )
            typed = SubElement(scalar, _TYPE[variable.type])
            if variable.type == "real":
                typed.set("unit", variable.unit)
            if variable.name in states:
                entry = reference - first[variable.name]
                typed.set("derivative", str(states[variable.name] + entry + 1))
            attributes.limits(typed, variable)
            if attributes.has_start(variable):
                typed.set("start", start)
            reference += 1
    time = SubElement(listed, "ScalarVariable", name="time", valueReference=str(reference))
    time.attrib |= {"description": "Time", "causality": "independent", "variability": "continuous"}
    SubElement(time, "Real", unit="s")


def _structure(structure: Element, model: Model) -> None:
    """Outputs and InitialUnknowns; an unknown is named by its place in ModelVariables, from 1."""
    place: dict[str, range] = {}
    first = 1
    for variable in model.variables:
        place[variable.name] = range(first, first + variable.size)
        first += variable.size
    _unknowns(SubElement(structure, "Outputs"), attributes.outputs(model), place)
    if model.exchange:
        _unknowns(SubElement(structure, "Derivatives"), attributes.derivatives(model), place)
    calculated = attributes.initial_unknowns(model)
    if calculated:
        _unknowns(SubElement(structure, "InitialUnknowns"), calculated, place)


def _unknowns(
    group: Element, unknowns: Iterable[attributes.Unknown], place: dict[str, range]
) -> None:
    for variable, knowns in unknowns:
        for entry, index in enumerate(place[variable.name]):
            on = [k for name in knowns for k in _related(variable, entry, place[name])]
            SubElement(group, "Unknown", index=str(index)).attrib |= attributes.dependencies(on)


def _related(variable: Variable, entry: int, places: range) -> range:
    """The entries of a known that entry `entry` of an unknown depends on."""
    if variable.elementwise and len(places) == variable.size:
        return places[entry : entry + 1]
    return places
