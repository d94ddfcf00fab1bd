"""A scenario as SSP 1.0: FMUs, connections and start values, for tools without links.

A scenario that was read from an SSP is that SSP with its changes (:mod:`cosim.ssp.rewrite`).

Every FMU is in ``resources/``, every scalar is a connector, and values are in parameter sets inside
the components. An annotation (:mod:`cosim.ssp.annotation`) contains what SSP cannot express, so
that the exported file gives the same run.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from cosim.base.errors import ScenarioError
from cosim.fmi import components
from cosim.fmi.component import FmuComponent
from cosim.fmi.file.ports import VariableGroup
from cosim.fmi.file.variables import TEXTS
from cosim.scenario.spec import Scenario
from cosim.schedule.parts import Link, Slot, Step, Wire
from cosim.schedule.plan import Plan
from cosim.ssp import annotation
from cosim.ssp.archive import ROOT, pack
from cosim.ssp.parameters import SSC, SSD, SSV, binding, type_of, values_of
from cosim.ssp.rewrite import rewrite

#: Said where an SSP is written anew.
_FLAT = (
    "nested systems are written flattened, and parameter sets in the components; dictionaries, "
    "geometry and annotations of other tools are left out"
)
Links = Literal["annotation", "fmu"]


def write(
    scenario: Scenario, plan: Plan, out: str | Path, links: Links = "annotation"
) -> list[str]:
    """Write the SSP of a scenario and its plan; returns what other tools will not see.

    `links`: "annotation" connects the ends of a link directly, "fmu" through a small FMU that
    delays as the link does, tick by tick. Raises ScenarioError for what cannot be exported.
    """
    out = Path(out)
    lost = []
    if scenario.path.suffix == ".ssp":
        notes = rewrite(scenario, plan, out) if links == "annotation" else None
        if notes is not None:
            return notes + _unseen(plan, links)
        lost = [_FLAT]
    packer = _Packer(scenario, plan)
    with tempfile.TemporaryDirectory(prefix="ssp-") as scratch:
        if links == "fmu":
            from cosim.ssp.delays import build_delays

            packer.delay(build_delays(scenario, plan, Path(scratch)))
        content = packer.content()
    pack(content, out)
    return lost + _unseen(plan, links)


def _unseen(plan: Plan, links: Links) -> list[str]:
    """Sentences about what only this project's runner does with the file."""
    notes = []
    slow = [c.name for c in plan.components if c.period != 1]
    if slow:
        notes.append(f"other tools step {', '.join(slow)} in every step, not at their own period")
    if plan.links and links == "annotation":
        notes.append("other tools see links as connections without delay (--links fmu: with)")
    if any(x.age is not None for x in plan.links):
        notes.append("ages of links are not fed by other tools")
    if plan.players:
        notes.append("weights of a topology, tables and events are not played by other tools")
    return notes


class _Packer:
    """Collects what goes into the archive."""

    def __init__(self, scenario: Scenario, plan: Plan) -> None:
        self._scenario, self._plan = scenario, plan
        self._fmus = {c.name: fmu_of(c, scenario) for c in plan.components}
        self._files: dict[str, bytes] = {}
        edges: tuple[Wire | Link, ...] = (*plan.wires, *plan.links)
        for slot in (s for edge in edges for s in (edge.source, edge.target)):
            kind = self._fmus[slot.component].groups[slot.port].first.type
            if kind == "Clock" or kind in TEXTS:
                said = "a clock, which SSP 1.0 has no connectors for"
                said = f"a {kind} variable, which is not exported" if kind in TEXTS else said
                what = f"{slot.name} is {said}"
                raise ScenarioError(what, str(scenario.path))
        self._fed = {name for edge in edges for name in edge.target.scalars()}
        self._delays: dict[str, Path] = {}  # by the link's name

    def delay(self, fmus: Mapping[str, Path]) -> None:
        """Put FMUs, by link, where the links are."""
        self._delays = {self._name(link): path for link, path in fmus.items()}
        self._by_link = dict(zip(fmus, self._delays, strict=True))
        for path in fmus.values():
            self._files[f"resources/{path.name}"] = path.read_bytes()

    def _name(self, link: str) -> str:
        names = [x.name for x in self._plan.links]
        name = f"delay_{names.index(link) + 1}"
        while name in self._fmus:
            name += "_"
        return name

    def content(self) -> dict[str, bytes]:
        """Everything by its name in the archive."""
        root = _root(self._scenario.name)
        system = SubElement(root, f"{{{SSD}}}System", name="system")
        elements = SubElement(system, f"{{{SSD}}}Elements")
        for step in self._plan.components:
            elements.append(self._component(step))
        connections = SubElement(system, f"{{{SSD}}}Connections")
        for wire in self._plan.wires:
            connections.extend(_connections(wire, wire.source, wire.target))
        for link in self._plan.links:
            self._link(link, elements, connections)
        if not len(connections):
            system.remove(connections)
        start, stop = repr(self._plan.start), repr(self._plan.end)
        SubElement(root, f"{{{SSD}}}DefaultExperiment", startTime=start, stopTime=stop)
        notes = SubElement(root, f"{{{SSD}}}Annotations")
        said = annotation.content(self._scenario, self._files)
        said["delays"] = sorted(self._delays)
        annotation.write(notes, said, SSC)
        return {ROOT: _text(root), **self._files}

    def _component(self, step: Step) -> Element:
        fmu = self._fmus[step.name]
        name = f"resources/{self._resource(fmu)}"
        element = _element(step.name, name)
        connectors = SubElement(element, f"{{{SSD}}}Connectors")
        for group in _connector_signals(fmu):
            kind = group.first.causality
            for scalar in _scalars(group):
                if kind == "input" and f"{step.name}.{scalar}" not in self._fed:
                    continue  # keeps its start value, which some tools would overwrite with 0
                connector = SubElement(connectors, f"{{{SSD}}}Connector", name=scalar, kind=kind)
                SubElement(connector, f"{{{SSC}}}{type_of(group)}")
        spec = self._scenario.components[step.name]
        texts = {k: v for k, v in {**spec.parameters, **spec.start}.items() if fmu.is_text(k)}
        _parameters(element, step, fmu, texts)
        return element

    def _resource(self, fmu: FmuComponent) -> str:
        """The file name of an FMU in the archive: its own, unless another has that."""
        data = fmu.archive.path.read_bytes()
        name, n = fmu.archive.path.name, 1
        while self._files.setdefault(f"resources/{name}", data) != data:
            n += 1
            name = f"{fmu.archive.path.stem}_{n}.fmu"
        return name

    def _link(self, link: Link, elements: Element, connections: Element) -> None:
        path = self._delays.get(self._by_link[link.name]) if self._delays else None
        if path is None:
            connections.extend(_connections(link, link.source, link.target))
            return
        name, size = self._by_link[link.name], link.target.size
        element = _element(name, f"resources/{path.name}")
        elements.append(element)
        connectors = SubElement(element, f"{{{SSD}}}Connectors")
        for kind, port in (("input", "u"), ("output", "y")):
            for i in range(size):
                at = f"{port}[{i}]"
                connector = SubElement(connectors, f"{{{SSD}}}Connector", name=at, kind=kind)
                SubElement(connector, f"{{{SSC}}}Real")
        before = Slot(f"{name}.u", name, "u", 0, (size,), link.target.unit)
        after = Slot(f"{name}.y", name, "y", 0, (size,), link.target.unit)
        connections.extend(_connections(link, link.source, before))
        connections.extend(_connections(Wire(after, link.target), after, link.target))


def fmu_of(step: Step, scenario: Scenario) -> FmuComponent:
    """The FMU of a component. Raises ScenarioError for one that SSP 1.0 cannot hold."""
    place = scenario.place("components", step.name, "model")
    fmu = components.stepped_fmu(step.component)
    if fmu is None and scenario.components[step.name].bus:
        raise ScenarioError(
            "found an FMU on a simulated CAN bus, which an SSP does not hold; expected one without",
            scenario.place("components", step.name, "bus"),
        )
    if components.is_simulator(step.component):
        raise ScenarioError(
            "found a scene of MuJoCo, which an SSP does not hold; expected FMUs only", place
        )
    if fmu is None:
        model = scenario.components[step.name].model
        raise ScenarioError(
            f"{model} is a Python component, but an SSP contains FMUs; `fmus build {model}` builds "
            "an FMU of it, which needs Python at run time",
            place,
        )
    for group in _connector_signals(fmu):
        if group.first.shape:
            raise ScenarioError(
                f"{group.name} is an array of FMI 3.0, which SSP 1.0 has no connectors for; "
                'expected fmi = "2.0"',
                place,
            )
    return fmu


def _connector_signals(fmu: FmuComponent) -> list[VariableGroup]:
    """The signals that SSP has connectors for: clocks are none."""
    groups = [fmu.groups[p.name] for p in (*fmu.inputs, *fmu.outputs)]
    return [g for g in groups if g.first.type != "Clock"]


def _scalars(group: VariableGroup) -> list[str]:
    return [v.name for v in group.variables]


def _parameters(element: Element, step: Step, fmu: FmuComponent, texts: Mapping[str, Any]) -> None:
    """Values, start values and texts as a parameter set inside the component."""
    given = values_of(fmu, {**step.values, **step.start}, texts)
    if given:
        bindings = SubElement(element, f"{{{SSD}}}ParameterBindings")
        bindings.append(binding(given))


def _connections(edge: Wire | Link, source: Slot, target: Slot) -> Iterator[Element]:
    """One connection for each scalar; gain and offset, units converted, as a transformation."""
    converts = source.unit != target.unit
    for start, end in zip(source.scalars(), target.scalars(), strict=True):
        (a, output), (b, name) = start.split(".", 1), end.split(".", 1)
        connection = Element(
            f"{{{SSD}}}Connection",
            startElement=a, startConnector=output, endElement=b, endConnector=name,
        )  # fmt: skip
        if converts or (edge.gain, edge.offset) != (1.0, 0.0):
            if converts:
                connection.set("suppressUnitConversion", "true")
            SubElement(
                connection,
                f"{{{SSC}}}LinearTransformation",
                factor=repr(edge.gain),
                offset=repr(edge.offset),
            )
        yield connection


# ---- the file -------------------------------------------------------------------------------


def _root(name: str) -> Element:
    for prefix, uri in (("ssc", SSC), ("ssd", SSD), ("ssv", SSV), ("cosim", annotation.NAMESPACE)):
        ElementTree.register_namespace(prefix, uri)
    return Element(f"{{{SSD}}}SystemStructureDescription", version="1.0", name=name)


def _element(name: str, source: str) -> Element:
    kind = "application/x-fmu-sharedlibrary"
    return Element(f"{{{SSD}}}Component", name=name, type=kind, source=source)


def _text(root: Element) -> bytes:
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return text
