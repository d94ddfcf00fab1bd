"""``SystemStructure.ssd`` flattened: components, one-way edges between connectors, values.

SSP 1.0 and 2.0, clause 4. Systems inside systems disappear here: their connectors are stations on
the way from an output to an input, and so are the signals of signal dictionaries.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from cosim.base.errors import ScenarioError
from cosim.ssp import nodes
from cosim.ssp.archive import ROOT, archive_member
from cosim.ssp.nodes import XmlNode
from cosim.ssp.values import Files, SspValue, bound, linear

#: A connector: the names of systems and component, and its own.
Connector = tuple[tuple[str, ...], str]
_SOURCES, _SINKS = ("output", "calculatedParameter"), ("input", "parameter")
_FMU = "application/x-fmu-sharedlibrary"


@dataclass(frozen=True, slots=True)
class SspConnection:
    """What feeds a connector: ``factor * value + offset``, after units unless `suppress`."""

    source: Connector
    factor: float
    offset: float
    suppress: bool
    place: str


@dataclass(frozen=True, slots=True)
class SspComponent:
    """A component: its FMU in the unpacked archive, and its place in the SSD."""

    fmu: Path
    place: str


@dataclass(slots=True)
class Structure:
    """A flattened system. `edges` and `values` are by the connector that gets them."""

    root: XmlNode
    system: XmlNode
    parts: dict[tuple[str, ...], SspComponent] = field(default_factory=dict)
    edges: dict[Connector, SspConnection] = field(default_factory=dict)
    values: dict[Connector, SspValue] = field(default_factory=dict)


def read(folder: Path, label: str) -> Structure:
    """Read the unpacked archive called `label`. Raises ScenarioError with file and place."""
    root = nodes.read(folder / ROOT, f"{label}:{ROOT}", "SystemStructureDescription")
    system = root.child("System")
    if system is None:
        raise ScenarioError("no <System>", root.place)
    found = Structure(root, system)
    _Reader(Files(folder, label), found).system(system, ())
    return found


class _Reader:
    """Reads systems recursively, inner systems first, so that outer values take precedence."""

    def __init__(self, files: Files, found: Structure) -> None:
        self._files, self._found = files, found

    def system(self, system: XmlNode, path: tuple[str, ...]) -> None:
        kinds: dict[str | None, dict[str, str]] = {None: _kinds(system)}
        children: dict[str, XmlNode] = {}
        for element in system.children("Elements"):
            for child in element.children():
                name = child.need("name")
                if name in children:
                    raise ScenarioError(f"a second element is called {name!r}", child.place)
                children[name] = child
                kinds[name] = _kinds(child)
                self._element(child, (*path, name))
        ends = _ConnectionEnds(
            path, kinds, {n: c for n, c in children.items() if _is_dictionary(c)}
        )
        for connection in system.children("Connections", "Connection"):
            self._connect(connection, ends)
        self._bind(system, path, children)

    def _element(self, child: XmlNode, path: tuple[str, ...]) -> None:
        if child.tag == "System":
            self.system(child, path)
        elif child.tag == "Component":
            self._component(child, path)
        elif child.tag != "SignalDictionaryReference":
            raise ScenarioError(f"<{child.tag}> is not supported", child.place)

    def _component(self, child: XmlNode, path: tuple[str, ...]) -> None:
        kind, source = child.get("type", _FMU), child.need("source")
        if kind != _FMU:
            message = f"a component of type {kind!r} is not supported; expected an FMU"
            raise ScenarioError(message, child.place)
        if child.get("implementation") in ("ModelExchange", "SourceCode"):
            what = child.get("implementation")
            raise ScenarioError(f"implementation {what!r}; expected CoSimulation", child.place)
        fmu = archive_member(self._files.folder, source, child.place)
        if fmu.suffix != ".fmu":
            raise ScenarioError(f"source {source!r} is not an .fmu file", child.place)
        self._found.parts[path] = SspComponent(fmu, child.place)
        self._bind(child, path, {})

    def _connect(self, connection: XmlNode, ends: _ConnectionEnds) -> None:
        source, target = ends.directed(connection)
        if target in self._found.edges:
            name = ".".join((*target[0], target[1]))
            raise ScenarioError(f"{name} is fed by a second connection", connection.place)
        self._found.edges[target] = SspConnection(source, *linear(connection), connection.place)

    def _bind(
        self, element: XmlNode, path: tuple[str, ...], children: Mapping[str, XmlNode]
    ) -> None:
        for binding in element.children("ParameterBindings", "ParameterBinding"):
            for name, value in bound(binding, self._files).items():
                self._found.values[_resolve(element, path, name, children)] = value


def _kinds(element: XmlNode) -> dict[str, str]:
    """Kinds of an element's connectors by name."""
    return {
        c.need("name"): c.get("kind", "inout") for c in element.children("Connectors", "Connector")
    }


def _is_dictionary(child: XmlNode) -> bool:
    return child.tag == "SignalDictionaryReference"


def _resolve(
    element: XmlNode, path: tuple[str, ...], name: str, children: Mapping[str, XmlNode]
) -> Connector:
    """The connector a parameter's name means: ``k``, or ``inner.controller.k`` of a system."""
    if element.tag != "System" or name in _kinds(element):
        return path, name
    for child in sorted(children, key=len, reverse=True):
        rest = name.removeprefix(f"{child}.")
        if rest != name:
            inner = children[child]
            below = {c.get("name"): c for e in inner.children("Elements") for c in e.children()}
            return _resolve(inner, (*path, child), rest, below)
    there = ", ".join(sorted(children)) or "nothing"
    raise ScenarioError(
        f"parameter {name!r} belongs to no element (there are: {there})", element.place
    )


@dataclass(frozen=True, slots=True)
class _ConnectionEnds:
    """The ends a connection in the system at `path` can have; None is the system itself."""

    path: tuple[str, ...]
    kinds: Mapping[str | None, Mapping[str, str]]
    dictionaries: Mapping[str, XmlNode]

    def directed(self, connection: XmlNode) -> tuple[Connector, Connector]:
        """(source, target): start and end do not tell the direction, kinds do (clause 4.5.4)."""
        start, end = self._end(connection, "start"), self._end(connection, "end")
        (first, from_first), (second, from_second) = start, end
        if from_first is None and from_second is None:
            return first, second  # both in dictionaries
        if from_first == from_second:
            raise ScenarioError("connects two sources or two sinks", connection.place)
        forward = from_first if from_first is not None else not from_second
        return (first, second) if forward else (second, first)

    def _end(self, connection: XmlNode, which: str) -> tuple[Connector, bool | None]:
        """An end, and whether it is a source inside this system (None: either)."""
        name = connection.get(f"{which}Element") or None
        connector = connection.need(f"{which}Connector")
        if name not in self.kinds:
            there = ", ".join(sorted(k for k in self.kinds if k)) or "none"
            raise ScenarioError(f"no element {name!r} (there are: {there})", connection.place)
        if name in self.dictionaries:
            dictionary = self.dictionaries[name].need("dictionary")  # type: ignore[index]
            return (("", dictionary), connector), None
        if connector not in self.kinds[name]:
            there = ", ".join(sorted(self.kinds[name])) or "none"
            owner = name or "the system"
            message = f"{owner} has no connector {connector!r} (there are: {there})"
            raise ScenarioError(message, connection.place)
        kind = self.kinds[name][connector]
        if kind not in (*_SOURCES, *_SINKS):
            raise ScenarioError(
                f"{connector} is {kind!r}, which is not supported", connection.place
            )
        path = self.path if name is None else (*self.path, name)
        return (path, connector), (kind in _SOURCES) != (name is None)
