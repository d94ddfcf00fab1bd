"""Parameter sets (SSV) and mappings (SSM) as values by name: SSP 1.0, clauses 5 and 6."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from cosim.base.errors import ScenarioError, UnitError
from cosim.base.units import BASE, Unit, parse
from cosim.ssp.archive import archive_member
from cosim.ssp.nodes import XmlNode, check, read

_NUMBERS = ("Real", "Integer", "Boolean", "Enumeration")


@dataclass(frozen=True, slots=True)
class SspValue:
    """A value as written: its `type` (Real, ..., String), entries as text, unit and place.

    Its transformation is ``factor * value + offset``, after the unit is converted unless
    `suppress`.
    """

    type: str
    entries: tuple[str, ...]
    place: str
    unit: Unit | None = None
    factor: float = 1.0
    offset: float = 0.0
    suppress: bool = False

    def through(self, factor: float, offset: float, suppress: bool) -> SspValue:
        """The same after one more linear transformation."""
        if (factor, offset, suppress) == (1.0, 0.0, False):
            return self
        return replace(
            self,
            factor=factor * self.factor,
            offset=factor * self.offset + offset,
            suppress=self.suppress or suppress,
        )


@dataclass(frozen=True, slots=True)
class Files:
    """Where what an SSD refers to is: the unpacked `folder` of the archive called `label`."""

    folder: Path
    label: str
    loaded: dict[Path, XmlNode] = field(default_factory=dict)

    def open(self, source: str, root: str, place: str) -> XmlNode:
        """The root of another file of the archive. Raises ScenarioError."""
        path = archive_member(self.folder, source, place)
        if path not in self.loaded:
            self.loaded[path] = read(path, f"{self.label}:{source}", root)
        return self.loaded[path]


def bound(binding: XmlNode, files: Files) -> dict[str, SspValue]:
    """The values of one ParameterBinding by name, mapped and prefixed. Raises ScenarioError."""
    kind = binding.get("type", "application/x-ssp-parameter-set")
    if kind != "application/x-ssp-parameter-set":
        raise ScenarioError(f"parameters of type {kind!r} are not supported", binding.place)
    values = _set(_root(binding, "ParameterValues", "ParameterSet", files))
    mapping = binding.child("ParameterMapping")
    if mapping is not None:
        values = _mapped(values, _root(binding, "ParameterMapping", "ParameterMapping", files))
    prefix = binding.get("prefix")
    return {prefix + name: value for name, value in values.items()}


def _root(binding: XmlNode, element: str, root: str, files: Files) -> XmlNode:
    """The set or mapping of a binding, from a file or from inside."""
    place = binding.child(element)
    holder = place if element == "ParameterMapping" else binding
    assert holder is not None
    source = holder.get("source")
    if source:
        if holder.get("sourceBase", "SSD") != "SSD":
            raise ScenarioError('sourceBase other than "SSD" is not supported', holder.place)
        return files.open(source, root, holder.place)
    inner = place.child(root) if place is not None else None
    if inner is None:
        raise ScenarioError(f"neither a source nor a {root} inside", binding.place)
    check(inner, root)
    return inner


def _set(root: XmlNode) -> dict[str, SspValue]:
    units = _units(root)
    found = {}
    for parameter in root.children("Parameters", "Parameter"):
        name = parameter.need("name")
        typed = next(
            (c for c in parameter.children() if c.tag in (*_NUMBERS, "String", "Binary")), None
        )
        if typed is None:
            raise ScenarioError("has no known type", parameter.place)
        found[name] = _given(typed, units)
    return found


def _given(typed: XmlNode, units: Mapping[str, Unit]) -> SspValue:
    if typed.element.get("value") is None and typed.tag != "String":
        raise ScenarioError(f"{typed.tag} has no attribute 'value'", typed.place)
    text = typed.get("value")
    entries = (text,) if typed.tag in ("String", "Binary") else tuple(text.split())
    name, unit = typed.get("unit"), None
    if name and typed.tag == "Real":
        try:
            unit = units[name] if name in units else parse(name)
        except UnitError as error:
            raise ScenarioError(str(error), typed.place) from None
    return SspValue(typed.tag, entries, typed.place, unit)


def _units(root: XmlNode) -> dict[str, Unit]:
    """Units as a file defines them; one that is not used is not looked at."""
    units = {}
    for unit in root.children("Units", "Unit"):
        given = unit.child("BaseUnit")
        if given is not None:
            powers = tuple(int(given.number(name, 0.0)) for name in BASE)
            factor, offset = given.number("factor", 1.0), given.number("offset", 0.0)
            units[unit.need("name")] = Unit(powers, factor, offset)
    return units


def _mapped(values: Mapping[str, SspValue], root: XmlNode) -> dict[str, SspValue]:
    found = {}
    for entry in root.children("MappingEntry"):
        source, target = entry.need("source"), entry.need("target")
        if source not in values:
            there = ", ".join(sorted(values)) or "none"
            raise ScenarioError(f"no parameter {source!r} (there are: {there})", entry.place)
        found[target] = transformed(values[source], entry)
    return found


def linear(node: XmlNode) -> tuple[float, float, bool]:
    """(factor, offset, unit conversion suppressed) of a connection or mapping entry.

    Raises ScenarioError for a transformation that is not linear.
    """
    factor, offset = 1.0, 0.0
    for child in node.children():
        if child.tag == "LinearTransformation":
            factor, offset = child.number("factor", 1.0), child.number("offset", 0.0)
        elif child.tag.endswith("MappingTransformation"):
            raise ScenarioError(f"a {child.tag} on a connection is not supported", child.place)
    return factor, offset, node.flag("suppressUnitConversion")


def transformed(value: SspValue, entry: XmlNode) -> SspValue:
    """A value after the transformation of a mapping entry, if it has one.

    Raises ScenarioError if the mapping has no entry for the value.
    """
    for child in entry.children():
        if child.tag.endswith("MappingTransformation"):
            table = {m.need("source"): m.need("target") for m in child.children("MapEntry")}
            missing = [e for e in value.entries if e not in table]
            if missing:
                raise ScenarioError(f"no entry for {missing[0]!r}", child.place)
            kind = child.tag.removesuffix("MappingTransformation")
            return replace(value, type=kind, entries=tuple(table[e] for e in value.entries))
    return value.through(*linear(entry))
