"""Files that a description refers to: in its archive, in an FMU of it, or in an archive inside."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from urllib.parse import unquote, urlsplit

from cosim.base.errors import ScenarioError
from cosim.ssp import nodes
from cosim.ssp.archive import ROOT, archive_member, unpack
from cosim.ssp.nodes import XmlNode

_ROOT = "SystemStructureDescription"


@dataclass(frozen=True, slots=True)
class Files:
    """The unpacked `folder` of the archive called `label`; sources are relative to `base` in it."""

    folder: Path
    label: str
    base: str = ""
    loaded: dict[Path, XmlNode] = field(default_factory=dict)

    def path(self, source: str, place: str) -> Path:
        """The file that a relative URI names. Raises ScenarioError at `place`."""
        return archive_member(self.folder, source, place, self.base)

    def open(self, source: str, root: str, place: str) -> XmlNode:
        """The root of another file of the archive. Raises ScenarioError."""
        path = self.path(source, place)
        if path not in self.loaded:
            self.loaded[path] = nodes.read(path, f"{self.label}:{source}", root)
        return self.loaded[path]


@dataclass(frozen=True, slots=True)
class SspDescription:
    """A system in a description with the `root`, whose sources are in `files`."""

    root: XmlNode
    system: XmlNode
    files: Files


def nested(given: SspDescription, component: XmlNode) -> SspDescription:
    """The system that a component of a description refers to, by its source (SSP 1.0, 4.5.2).

    ``inner.ssp``, ``inner.ssp#Variant.ssd``, ``inner.ssd``, or ``#id`` for a system of the same
    description. Raises ScenarioError.
    """
    source, place = component.need("source"), component.place
    uri = urlsplit(source)
    if not uri.path:
        return SspDescription(given.root, _by_id(given.root, uri.fragment, place), given.files)
    path = given.files.path(source, place)
    if component.get("type") == "application/x-ssp-package":
        name = unquote(uri.fragment) or ROOT
        files = Files(unpack(path), f"{given.files.label}:{uri.path}")
    else:
        base = PurePosixPath(given.files.base, unquote(uri.path)).parent
        files = Files(given.files.folder, given.files.label, str(base), given.files.loaded)
        name = path.name
    root = files.open(name, _ROOT, place)
    if uri.fragment and component.get("type") != "application/x-ssp-package":
        return SspDescription(root, _by_id(root, uri.fragment, place), files)
    system = root.child("System")
    if system is None:
        raise ScenarioError("no <System>", root.place)
    return SspDescription(root, system, files)


def _by_id(root: XmlNode, identifier: str, place: str) -> XmlNode:
    for system in _systems(root):
        if system.get("id") == identifier:
            return system
    raise ScenarioError(f"no system of this description has the id {identifier!r}", place)


def _systems(node: XmlNode) -> Iterator[XmlNode]:
    for child in (*node.children("System"), *node.children("Elements", "System")):
        yield child
        yield from _systems(child)
