"""``SystemStructure.ssd`` flattened: components, one-way edges between connectors, values.

SSP 1.0 and 2.0, clause 4. Systems inside systems disappear here: their connectors are stations on
the way from an output to an input, and so are the signals of signal dictionaries. A component that
is an ``.ssd`` or ``.ssp`` file itself is read as if its system stood in its place.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from cosim.base.errors import ScenarioError
from cosim.fmi.file import archive as fmus
from cosim.ssp import nodes
from cosim.ssp.archive import ROOT
from cosim.ssp.connections import Connector, SspConnection, SspElement, directed
from cosim.ssp.files import Files, SspDescription, nested
from cosim.ssp.nodes import XmlNode
from cosim.ssp.values import SspValue, bound, transformation

_FMU = "application/x-fmu-sharedlibrary"
#: Types of components that are systems, in files of their own.
_SYSTEMS = ("application/x-ssp-definition", "application/x-ssp-package")
_IMPLEMENTATIONS = ("any", "CoSimulation", "ModelExchange", "ScheduledExecution")


@dataclass(frozen=True, slots=True)
class SspComponent:
    """A component: its FMU in the unpacked archive, how it is run, and its place in the SSD."""

    fmu: Path
    implementation: str
    place: str


@dataclass(slots=True)
class Structure:
    """A flattened system. `edges` and `values` are by the connector that gets them.

    `elements`: all elements by their names from the outside in; `ignored`: what is said about
    values that fit no element.
    """

    root: XmlNode
    system: XmlNode
    parts: dict[tuple[str, ...], SspComponent] = field(default_factory=dict)
    edges: dict[Connector, SspConnection] = field(default_factory=dict)
    values: dict[Connector, SspValue] = field(default_factory=dict)
    elements: dict[tuple[str, ...], SspElement] = field(default_factory=dict)
    ignored: list[str] = field(default_factory=list)


def read(folder: Path, label: str) -> Structure:
    """Read the unpacked archive called `label`. Raises ScenarioError with file and place."""
    root = nodes.read(folder / ROOT, f"{label}:{ROOT}", "SystemStructureDescription")
    system = root.child("System")
    if system is None:
        raise ScenarioError("no <System>", root.place)
    found = Structure(root, system)
    _Reader(found).system(SspDescription(root, system, Files(folder, label)), (), {})
    return found


class _Reader:
    """Reads systems recursively, inner systems first, so that outer values take precedence."""

    def __init__(self, found: Structure) -> None:
        self._found = found
        self._open: list[str] = []  # places of the files that are being read

    def system(
        self, given: SspDescription, path: tuple[str, ...], outer: Mapping[str, Connector]
    ) -> SspElement:
        """Read a system; `outer`: the signal dictionaries of the systems around it, by name."""
        dictionaries = {**outer, **_dictionaries(given, path)}
        children: dict[str, SspElement] = {}
        for element in given.system.children("Elements"):
            for child in element.children():
                name = child.need("name")
                if name in children:
                    raise ScenarioError(f"a second element is called {name!r}", child.place)
                children[name] = self._element(given, child, (*path, name), dictionaries)
        whole = SspElement(path, _kinds(given.system), children)
        for connection in given.system.children("Connections", "Connection"):
            self._connect(connection, whole)
        self._bind(given.system, whole, given.files, None)
        self._found.elements[path] = whole
        return whole

    def _element(
        self, given: SspDescription, child: XmlNode, path: tuple[str, ...],
        dictionaries: Mapping[str, Connector],
    ) -> SspElement:  # fmt: skip
        if child.tag == "System":
            return self.system(SspDescription(given.root, child, given.files), path, dictionaries)
        if child.tag == "SignalDictionaryReference":
            name = child.need("dictionary")
            if name not in dictionaries:
                there = ", ".join(sorted(dictionaries)) or "none"
                raise ScenarioError(f"no signal dictionary {name!r} (there: {there})", child.place)
            return SspElement(path, _kinds(child), None, dictionaries[name])
        if child.tag != "Component":
            raise ScenarioError(f"<{child.tag}> is not supported", child.place)
        if child.get("type", _FMU) in _SYSTEMS:
            return self._nested(given, child, path, dictionaries)
        return self._component(given, child, path)

    def _nested(
        self, given: SspDescription, child: XmlNode, path: tuple[str, ...],
        dictionaries: Mapping[str, Connector],
    ) -> SspElement:  # fmt: skip
        """A component that is a system: as if it stood there, its bindings after the system's."""
        inner = nested(given, child)
        if inner.system.place in self._open:
            raise ScenarioError(f"source {child.get('source')!r} contains itself", child.place)
        self._open.append(inner.system.place)
        element = self.system(inner, path, dictionaries)
        self._open.pop()
        element = SspElement(path, {**element.kinds, **_kinds(child)}, element.children)
        self._bind(child, element, given.files, inner.files)
        return element

    def _component(
        self, given: SspDescription, child: XmlNode, path: tuple[str, ...]
    ) -> SspElement:
        kind = child.get("type", _FMU)
        if kind != _FMU:
            message = f"a component of type {kind!r} is not supported; expected an FMU"
            raise ScenarioError(message, child.place)
        implementation = child.get("implementation", "any")
        if implementation not in _IMPLEMENTATIONS:
            words = ", ".join(_IMPLEMENTATIONS)
            message = f"implementation {implementation!r}; expected one of {words}"
            raise ScenarioError(message, child.place)
        source = child.need("source")
        fmu = given.files.path(source, child.place)
        if fmu.suffix != ".fmu":
            raise ScenarioError(f"source {source!r} is not an .fmu file", child.place)
        self._found.parts[path] = SspComponent(fmu, implementation, child.place)
        element = SspElement(path, _kinds(child), None)
        inside = Files(fmus.unpack(fmu).folder, f"{given.files.label}:{source}")
        self._bind(child, element, given.files, inside)
        self._found.elements[path] = element
        return element

    def _connect(self, connection: XmlNode, system: SspElement) -> None:
        source, target = directed(connection, system)
        if target in self._found.edges:
            name = ".".join((*target[0], target[1]))
            raise ScenarioError(f"{name} is fed by a second connection", connection.place)
        linear, table = transformation(connection)
        self._found.edges[target] = SspConnection(source, *linear, connection.place, table)

    def _bind(self, node: XmlNode, element: SspElement, files: Files, inside: Files | None) -> None:
        for binding in node.children("ParameterBindings", "ParameterBinding"):
            for name, value in bound(binding, files, inside, self._found.ignored).items():
                target = element.connector(name)
                if target is None:
                    there = ", ".join(sorted(element.children or ())) or "nothing"
                    self._found.ignored.append(
                        f"parameter {name!r} belongs to no element (there are: {there}): its value"
                        " is ignored"
                    )
                else:
                    self._found.values[target] = value


def _kinds(element: XmlNode) -> dict[str, str]:
    """Kinds of an element's connectors by name."""
    return {
        c.need("name"): c.get("kind", "inout") for c in element.children("Connectors", "Connector")
    }


def _dictionaries(given: SspDescription, path: tuple[str, ...]) -> dict[str, Connector]:
    """The signal dictionaries of a system, by name, as the place where their signals are."""
    found: dict[str, Connector] = {}
    for node in given.system.children("SignalDictionaries", "SignalDictionary"):
        if node.get("source"):
            given.files.open(node.get("source"), "SignalDictionary", node.place)
        found[node.need("name")] = ((*path, ""), node.need("name"))
    return found
