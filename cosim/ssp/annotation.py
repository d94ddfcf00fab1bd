"""Content of a scenario that SSP cannot express: an annotation in the SSD, as JSON.

It holds the run (step, seed, algorithm, what is recorded), components' periods and kinds, links,
topology, metrics, figures. Components, wires and values are read from the SSD itself, so that what
another tool changes there counts. A link replaces the connections to its input, and the delay
FMUs that stand for it in tools without links.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from cosim.base.errors import ScenarioError
from cosim.scenario.spec import Scenario, as_data
from cosim.ssp.nodes import XmlNode

TYPE = "cosim-bridge.scenario"
NAMESPACE = "urn:cosim-bridge:scenario:1"
#: Keys of a component's table that the SSD tells itself.
TOLD = ("model", "fmi", "sizes", "options", "preset", "parameters", "start", "inputs")
_TABLES = ("title", "links", "events", "topology", "metrics", "figures", "analysis", "require")


def write(parent: ElementTree.Element, content: Mapping[str, Any], common: str) -> None:
    """Append the annotation to <Annotations>; `common`: the namespace of its elements."""
    outer = ElementTree.SubElement(parent, f"{{{common}}}Annotation", type=TYPE)
    inner = ElementTree.SubElement(outer, f"{{{NAMESPACE}}}Scenario")
    inner.text = json.dumps(content, sort_keys=True, ensure_ascii=False)


def content(scenario: Scenario, files: dict[str, bytes]) -> dict[str, Any]:
    """The part of a scenario that an SSD does not tell; files that it names are added to `files`,
    by their names in the archive. Raises ScenarioError for two different ones of the same name.
    """
    data = as_data(scenario)
    said = {k: v for k, v in data.items() if k not in ("path", "components")}
    said["components"] = {name: missing_in_ssd(table) for name, table in data["components"].items()}
    for table in said["components"].values():
        for given in table.get("inputs", {}).values():
            given["table"] = given["table"] and _packed(scenario, given["table"], files)
    for link in said["links"]:
        if "file" in (link["delay"] or {}):
            link["delay"]["file"] = _packed(scenario, link["delay"]["file"], files)
    topology = said.get("topology")
    if topology and not isinstance(topology["graphs"], str):
        topology["graphs"] = [_packed(scenario, graph, files) for graph in topology["graphs"]]
    return said


def _packed(scenario: Scenario, name: str, files: dict[str, bytes]) -> str:
    path = scenario.path.parent / name
    if not path.is_file():
        return name
    packed = f"resources/links/{path.name}"
    if files.setdefault(packed, path.read_bytes()) != path.read_bytes():
        raise ScenarioError(f"two different files have the name {path.name!r}", str(path))
    return packed


def missing_in_ssd(table: Mapping[str, Any]) -> dict[str, Any]:
    """The part of a component's table that the SSD does not tell: tables and points that feed
    inputs, and sizes, where they are an FMU's.
    """
    said = {k: v for k, v in table.items() if k not in TOLD and v is not None}
    played = {k: x for k, x in table["inputs"].items() if isinstance(x, dict) and not x["from"]}
    if played:
        said["inputs"] = played
    if str(table["model"]).endswith(".fmu") and table.get("sizes"):
        said["sizes"] = table["sizes"]
    return said


def read(root: XmlNode) -> dict[str, Any] | None:
    """The annotation of an SSD, if it has one. Raises ScenarioError."""
    for node in root.children("Annotations", "Annotation"):
        if node.get("type") == TYPE:
            inner = node.child("Scenario")
            try:
                said = json.loads((inner.element.text if inner is not None else "") or "")
            except ValueError as error:
                raise ScenarioError(f"not valid JSON: {error}", node.place) from None
            if not isinstance(said, dict):
                raise ScenarioError("expected an object", node.place)
            return said
    return None


def apply(said: Mapping[str, Any], made: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The document `made` from the SSD with what the annotation adds."""
    components = made["components"]
    for name in said.get("delays", ()):
        components.pop(name, None)
    for name, table in said.get("components", {}).items():
        if name in components:
            played = table.pop("inputs", {})
            components[name] |= table
            components[name]["inputs"] |= played
            for given in played.values():
                given["table"] = given["table"] and _file(folder, given["table"])
    made["run"] |= said.get("run", {})
    made |= {key: said[key] for key in _TABLES if said.get(key)}
    for link in made.get("links", ()):
        component, _, port = str(link.get("to", "")).partition(".")
        if component in components:
            _unfeed(components[component]["inputs"], port)
        _locate(link.get("delay", {}), folder)
    topology = made.get("topology")
    if topology and isinstance(topology.get("graphs"), list):
        topology["graphs"] = [_file(folder, graph) for graph in topology["graphs"]]
    return made


def _unfeed(inputs: dict[str, Any], port: str) -> None:
    """Forget the wires to an input that a link feeds: to it, or to entries of it."""
    head = f"{port[:-1]}," if port.endswith("]") else f"{port}["
    for key in [k for k in inputs if k == port or k.startswith(head)]:
        del inputs[key]


def _locate(delay: dict[str, Any], folder: Path) -> None:
    if isinstance(delay.get("file"), str):
        delay["file"] = _file(folder, delay["file"])


def _file(folder: Path, name: str) -> str:
    """A file that was packed; anything else keeps its name."""
    return str(folder / name) if (folder / name).is_file() else name
