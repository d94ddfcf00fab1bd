"""``modelDescription.xml`` of FMI 3.0.2 (clauses 2.4 and 4.3).

Arrays are arrays. A value reference is the place of a variable in the declaration; then comes the
time, and last the clock of a model that has one.
"""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement

from fmus.build.source import token
from fmus.model import Model, Variable, annotation, attributes

_TYPE = {"real": "Float64", "integer": "Int32", "boolean": "Boolean", "size": "UInt64"}


def describe(model: Model) -> Element:
    """``modelDescription.xml`` as an element."""
    root = Element("fmiModelDescription", fmiVersion="3.0", modelName=model.identifier)
    root.set("instantiationToken", token(model))
    attributes.identify(root, model)
    own = {"canHandleVariableCommunicationStepSize": "true"}
    if model.exchange:
        own = {"needsCompletedIntegratorStep": "false", "providesDirectionalDerivatives": "true"}
    interface = SubElement(
        root,
        "ModelExchange" if model.exchange else "CoSimulation",
        {
            "modelIdentifier": model.identifier,
            **own,
            "canGetAndSetFMUState": "true",
            "canSerializeFMUState": "true",
        },
    )
    if model.clock:
        interface.set("hasEventMode", "true")
    attributes.units(root, model)
    attributes.categories(root)
    attributes.experiment(root, model)
    _variables(SubElement(root, "ModelVariables"), model)
    _structure(SubElement(root, "ModelStructure"), model)
    ours = SubElement(SubElement(root, "Annotations"), "Annotation", type="cosim.component")
    SubElement(ours, "Component", annotation(model.kind, model.inputs()))
    return root


def _variables(listed: Element, model: Model) -> None:
    place = {variable.name: n for n, variable in enumerate(model.variables)}
    states = {rate: state for state, rate in model.states} if model.exchange else {}
    for reference, variable in enumerate(model.variables):
        element = SubElement(listed, _TYPE[variable.type], name=variable.name)
        element.attrib |= {"valueReference": str(reference)} | attributes.attributes(
            variable, model
        )
        if variable.type == "real":
            element.set("unit", variable.unit)
        if variable.name in states:
            element.set("derivative", str(place[states[variable.name]]))
        if model.clock and variable.causality != "parameter":
            element.set("clocks", str(len(model.variables) + 1))
        attributes.limits(element, variable)
        if attributes.has_start(variable):
            starts = variable.starts[: _entries(variable, model)]
            element.set("start", " ".join(attributes.as_text(variable, starts)))
        for axis, size in enumerate(variable.shape):
            if axis == variable.axis:
                SubElement(element, "Dimension", valueReference=str(place[model.structural]))
            else:
                SubElement(element, "Dimension", start=str(size))
    time = SubElement(listed, "Float64", name="time", valueReference=str(len(model.variables)))
    time.attrib |= {"description": "Time", "causality": "independent", "variability": "continuous"}
    time.set("unit", "s")
    if model.clock:
        clock = SubElement(
            listed, "Clock", name="clock", valueReference=str(len(model.variables) + 1)
        )
        clock.attrib |= {"description": "Each tick is a step", "causality": "input"}
        clock.attrib |= {"variability": "discrete", "intervalVariability": "constant"}
        clock.set("intervalDecimal", repr(model.clock))


def _entries(variable: Variable, model: Model) -> int:
    """Entries of a variable with the default of the structural parameter."""
    if variable.axis < 0:
        return variable.size
    default = next(v for v in model.variables if v.name == model.structural).starts[0]
    return variable.size // variable.shape[variable.axis] * int(default)


def _structure(structure: Element, model: Model) -> None:
    """Outputs and initial unknowns, by value reference."""
    reference = {variable.name: n for n, variable in enumerate(model.variables)}
    initial = (
        [] if model.clock else attributes.initial_unknowns(model)
    )  # not expected of clocked variables
    for tag, unknowns in (
        ("Output", attributes.outputs(model)),
        ("ContinuousStateDerivative", attributes.derivatives(model)),
        ("InitialUnknown", initial),
    ):
        for variable, knowns in unknowns:
            element = SubElement(structure, tag, valueReference=str(reference[variable.name]))
            element.attrib |= attributes.dependencies(reference[name] for name in knowns)
