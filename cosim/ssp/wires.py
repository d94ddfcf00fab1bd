"""Connections of a flattened SSP as the wires of a scenario, and values that travel along them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from cosim.base.errors import ScenarioError, UnitError
from cosim.base.units import conversion
from cosim.fmi.file.ports import VariableGroup
from cosim.ssp.connections import Connector, SspConnection
from cosim.ssp.parts import SspPart, number_of
from cosim.ssp.structure import Structure


def feed(structure: Structure, parts: Mapping[tuple[str, ...], SspPart], target: Connector) -> bool:
    """Wire an input to the output at the beginning of its connections; whether there is one."""
    path, name = target
    if path not in parts:
        return False  # a station on the way
    source, way = _traced(structure, parts, target)
    if source[0] in parts:
        wire = _wire(parts[source[0]], source[1], parts[path], name, way)
        parts[path].feed(name, wire, way.place)
    elif source in structure.values:
        value = structure.values[source].through(way.factor, way.offset, way.suppress)
        parts[path].set(name, value)
    else:
        return False
    return True


def _traced(
    structure: Structure, parts: Mapping[tuple[str, ...], SspPart], target: Connector
) -> tuple[Connector, SspConnection]:
    """The source of the connections to `target`, and all of them as one edge."""
    way = structure.edges[target]
    passed = {target}
    while way.source in structure.edges and way.source[0] not in parts:
        if way.source in passed:
            raise ScenarioError("connections form a loop without a component", way.place)
        passed.add(way.source)
        before = structure.edges[way.source]
        if before.table and way.table:
            raise ScenarioError("two mapping transformations in a row are not supported", way.place)
        way = SspConnection(
            before.source,
            way.factor * before.factor,
            way.factor * before.offset + way.offset,
            way.suppress or before.suppress,
            way.place,
            before.table or way.table,
        )
    return way.source, way


def _wire(sender: SspPart, output: str, receiver: SspPart, name: str, way: SspConnection) -> Any:
    """The entry of a scenario for a connection: an endpoint, or one with gain and offset."""
    _check_ends(sender, output, receiver, name, way)
    factor, offset = way.factor, way.offset
    if way.table:
        factor, offset = _straight(sender.group(output), receiver.group(name), way)
    units = [
        p.variable(v, way.place)[0].first.unit for p, v in ((sender, output), (receiver, name))
    ]
    if way.suppress and all(units):
        try:  # what the wire would convert by, and must not
            gain, shift = conversion(sender.unit(output, way.place), receiver.unit(name, way.place))
        except UnitError as error:
            message = f"{error}; suppressing the conversion does not make them the same"
            raise ScenarioError(message, way.place) from None
        factor, offset = factor / gain, offset - factor / gain * shift
    origin = sender.endpoint(output, way.place)
    plain = (factor, offset) == (1.0, 0.0)
    return origin if plain else {"from": origin, "gain": factor, "offset": offset}


def _check_ends(
    sender: SspPart, output: str, receiver: SspPart, name: str, way: SspConnection
) -> None:
    """Raise ScenarioError for a wire that does not go from a readable variable to an input."""
    first = sender.variable(output, way.place)[0].name
    if sender.group(output).first.causality != "output" and first not in sender.fmu.observable:
        found = sender.group(output).first.causality
        message = f"{sender.name}.{output} is a {found} of its FMU, which cannot be read"
        raise ScenarioError(message, way.place)
    receiver.variable(name, way.place)
    found = receiver.group(name).first.causality
    if found != "input":
        message = f"{receiver.name}.{name} is a {found} of its FMU, no input"
        raise ScenarioError(message, way.place)


def _straight(
    sender: VariableGroup, receiver: VariableGroup, way: SspConnection
) -> tuple[float, float]:
    """(gain, offset) of a mapping transformation, which is a table of numbers, Booleans or names.

    Raises ScenarioError if its points are not on a straight line.
    """
    try:
        points = {number_of(sender, a): number_of(receiver, b) for a, b in way.table}
    except ValueError:
        message = f"a mapping has an entry that is no value of {sender.name} or {receiver.name}"
        raise ScenarioError(message, way.place) from None
    (x0, y0), *rest = sorted(points.items())
    gain = (rest[0][1] - y0) / (rest[0][0] - x0) if rest else 0.0
    if (way.factor, way.offset) != (1.0, 0.0) or any(
        y != gain * x + (y0 - gain * x0) for x, y in rest
    ):
        message = "a mapping on a connection whose points are not on one line is not supported"
        raise ScenarioError(message, way.place)
    return gain, y0 - gain * x0
