"""XML elements with their position in the document, which every error message contains."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from xml.etree import ElementTree

from cosim.base.errors import ScenarioError


@dataclass(frozen=True, slots=True)
class XmlNode:
    """An element and its place, ``FILE at /System[@name='x']/Elements/...``."""

    element: ElementTree.Element
    place: str

    @property
    def tag(self) -> str:
        """Its name without the namespace: SSP 1.0 and 2.0 share theirs."""
        return self.element.tag.rpartition("}")[2]

    def children(self, *path: str) -> Iterator[XmlNode]:
        """The children at the end of `path`; no path: all children."""
        if not path:
            for child in self.element:
                if isinstance(child.tag, str):  # neither comment nor processing instruction
                    yield XmlNode(child, self._inside(child))
            return
        for node in self.children():
            if node.tag == path[0]:
                yield from node.children(*path[1:]) if len(path) > 1 else (node,)

    def _inside(self, child: ElementTree.Element) -> str:
        tag, name = child.tag.rpartition("}")[2], child.get("name")
        step = f"{tag}[@name={name!r}]" if name else tag
        return f"{self.place}{'' if self.place.endswith('/') else '/'}{step}"

    def child(self, *path: str) -> XmlNode | None:
        """The first child at the end of `path`, if there is one."""
        return next(self.children(*path), None)

    def get(self, name: str, default: str = "") -> str:
        """An attribute."""
        return self.element.get(name, default)

    def need(self, name: str) -> str:
        """An attribute that must be there. Raises ScenarioError."""
        if not self.get(name):
            raise ScenarioError(f"{self.tag} has no attribute {name!r}", self.place)
        return self.get(name)

    def number(self, name: str, default: float | None = None) -> float:
        """An attribute that is a finite number, in the unit SSP gives it. Raises ScenarioError."""
        if default is not None and not self.get(name):
            return default
        text = self.need(name)
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not isfinite(value):
            raise ScenarioError(f"{name} is {text!r}; expected a number", self.place)
        return value

    def flag(self, name: str) -> bool:
        """An attribute that is a Boolean, false where it is not given."""
        return self.get(name) in ("true", "1")


def read(path: Path, label: str, root: str) -> XmlNode:
    """The root of an XML file, which must be called `root` and be of SSP 1.0 or 2.0.

    `label` names the file in messages. Raises ScenarioError.
    """
    try:
        element = ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, ValueError, LookupError, OSError) as error:
        raise ScenarioError(f"not well-formed XML: {error}", label) from None
    node = XmlNode(element, f"{label} at /")
    check(node, root)
    return node


def check(node: XmlNode, root: str) -> None:
    """Refuse a root of another name, or of a version that is not known. Raises ScenarioError."""
    if node.tag != root:
        raise ScenarioError(f"found <{node.tag}>, expected <{root}>", node.place)
    version = node.get("version", "1.0")
    if version.split(".")[0] not in ("1", "2"):
        raise ScenarioError(f"version is {version!r}; expected 1.0 or 2.0", node.place)
