"""Connections between elements of a system: where they start and end, and what they do on the way.

SSP 1.0 and 2.0, clause 4.5.4: the order of start and end says nothing, the kinds of the connectors
give the direction.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from cosim.base.errors import ScenarioError
from cosim.ssp.nodes import XmlNode

#: A connector: the names of systems and component, and its own.
Connector = tuple[tuple[str, ...], str]
#: What a mapping transformation makes of values: pairs of texts.
MapEntries = tuple[tuple[str, str], ...]
_SOURCES = ("output", "calculatedParameter", "constant", "local")
_SINKS = ("input", "parameter", "structuralParameter")


@dataclass(frozen=True, slots=True)
class SspConnection:
    """The source of a connector: ``factor * value + offset``, after units unless `suppress`.

    `table`: the entries of a mapping transformation instead, () if there is none.
    """

    source: Connector
    factor: float
    offset: float
    suppress: bool
    place: str
    table: MapEntries = ()


@dataclass(frozen=True, slots=True)
class SspElement:
    """An element of a system: kinds of its connectors, and the elements inside of a system.

    `path`: its name and those of the systems around it; `children`: None for an FMU and for a
    reference to a signal dictionary; `dictionary`: where the signals of the latter are.
    """

    path: tuple[str, ...]
    kinds: Mapping[str, str]
    children: Mapping[str, SspElement] | None
    dictionary: Connector | None = None

    def connector(self, name: str) -> Connector | None:
        """The connector that the name of a parameter means: ``k``, or ``inner.control.k`` of a
        system.

        None if no element has that name.
        """
        if self.children is None or name in self.kinds:
            return self.path, name
        for child in sorted(self.children, key=len, reverse=True):
            rest = name.removeprefix(f"{child}.")
            if rest != name:
                return self.children[child].connector(rest)
        return None


def directed(connection: XmlNode, system: SspElement) -> tuple[Connector, Connector]:
    """(source, target) of a connection in a system. Raises ScenarioError with its place."""
    for which in ("start", "end"):
        if connection.get(f"{which}Indices"):
            message = f"{which}Indices, a connection of an entry of an array, is not supported"
            raise ScenarioError(message, connection.place)
    first, from_first = _end(connection, "start", system)
    second, from_second = _end(connection, "end", system)
    if from_first is None and from_second is None:
        return first, second  # both in dictionaries
    if from_first == from_second:
        raise ScenarioError("connects two sources or two sinks", connection.place)
    forward = from_first if from_first is not None else not from_second
    return (first, second) if forward else (second, first)


def _end(connection: XmlNode, which: str, system: SspElement) -> tuple[Connector, bool | None]:
    """An end, and whether it is a source inside this system (None: either)."""
    name = connection.get(f"{which}Element") or None
    connector = connection.need(f"{which}Connector")
    children = system.children or {}
    if name is not None and name not in children:
        there = ", ".join(sorted(children)) or "none"
        raise ScenarioError(f"no element {name!r} (there are: {there})", connection.place)
    element = system if name is None else children[name]
    if element.dictionary is not None:
        path, dictionary = element.dictionary
        return ((*path, dictionary), connector), None
    if connector not in element.kinds:
        there = ", ".join(sorted(element.kinds)) or "none"
        message = f"{name or 'the system'} has no connector {connector!r} (there are: {there})"
        raise ScenarioError(message, connection.place)
    kind = element.kinds[connector]
    if kind not in (*_SOURCES, *_SINKS):
        raise ScenarioError(f"{connector} is {kind!r}, which is not supported", connection.place)
    return (element.path, connector), (kind in _SOURCES) != (name is None)
