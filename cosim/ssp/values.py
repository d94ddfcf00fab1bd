"""Parameter sets (SSV) and mappings (SSM) as values by name: SSP 1.0, clauses 5 and 6."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.base.units import BASE, Unit
from cosim.ssp.connections import MapEntries
from cosim.ssp.files import Files
from cosim.ssp.nodes import XmlNode, check

_REALS = ("Real", "Float64", "Float32")
_WHOLE = ("Integer", *(f"{u}Int{n}" for u in ("", "U") for n in (8, 16, 32, 64)))
_NUMBERS = (*_REALS, *_WHOLE, "Boolean", "Enumeration")


@dataclass(frozen=True, slots=True)
class SspValue:
    """A value as written: its `type` (Real, ..., String), entries as text, unit and place.

    `unit`: as its file defines it, or only its name.

    Its transformation is ``factor * value + offset``, after the unit is converted unless
    `suppress`.
    """

    type: str
    entries: tuple[str, ...]
    place: str
    unit: Unit | str | None = None
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


def bound(
    binding: XmlNode, files: Files, inside: Files | None, ignored: list[str]
) -> dict[str, SspValue]:
    """The values of one ParameterBinding by name, prefixed and mapped (SSP 1.0, clause 4.5.1).

    `inside`: the files of the component, for sources with ``sourceBase="component"``; `ignored`
    gets sentences about what is not used. Raises ScenarioError.
    """
    kind = binding.get("type", "application/x-ssp-parameter-set")
    if kind != "application/x-ssp-parameter-set":
        raise ScenarioError(f"parameters of type {kind!r} are not supported", binding.place)
    given = _set(_root(binding, "ParameterValues", "ParameterSet", files, inside))
    prefix = binding.get("prefix")
    values = {prefix + name: value for name, value in given.items()}
    if binding.child("ParameterMapping") is None:
        return values
    mapping = _root(binding, "ParameterMapping", "ParameterMapping", files, inside)
    return _mapped(values, mapping, ignored)


def _root(binding: XmlNode, element: str, root: str, files: Files, inside: Files | None) -> XmlNode:
    """The set or mapping of a binding, from a file or from inside."""
    place = binding.child(element)
    holder = place if element == "ParameterMapping" else binding
    assert holder is not None
    source = holder.get("source")
    if source:
        base = holder.get("sourceBase", "SSD")
        where = {"SSD": files, "component": inside}.get(base)
        if where is None:
            expected = "SSD, and component in a component"
            raise ScenarioError(f"sourceBase is {base!r}; expected {expected}", holder.place)
        return where.open(source, root, holder.place)
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
    texts = [node.need("value") for node in typed.children("Value")]
    if typed.element.get("value") is None and typed.tag != "String":
        raise ScenarioError(f"{typed.tag} has no attribute 'value'", typed.place)
    text = typed.get("value")
    entries = (text,) if typed.tag in ("String", "Binary") else tuple(text.split())
    name = typed.get("unit") if typed.tag in _REALS else ""
    unit = units.get(name, name) if name else None
    return SspValue(typed.tag, tuple(texts) or entries, typed.place, unit)


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


def _mapped(
    values: Mapping[str, SspValue], root: XmlNode, ignored: list[str]
) -> dict[str, SspValue]:
    found = {}
    for entry in root.children("MappingEntry"):
        target = entry.need("target")
        if not entry.get("source"):  # of a template that nobody has filled in
            ignored.append(
                f"the mapping of {target!r} has no source ({entry.place}): it is ignored"
            )
            continue
        source = entry.need("source")
        if source not in values:
            there = ", ".join(sorted(values)) or "none"
            raise ScenarioError(f"no parameter {source!r} (there are: {there})", entry.place)
        found[target] = transformed(values[source], entry)
    return found


def transformation(node: XmlNode) -> tuple[tuple[float, float, bool], MapEntries]:
    """(factor, offset, unit conversion suppressed) of a connection or mapping entry, and the
    entries of a mapping transformation, () if it has none.
    """
    factor, offset = 1.0, 0.0
    table: MapEntries = ()
    for child in node.children():
        if child.tag == "LinearTransformation":
            factor, offset = child.number("factor", 1.0), child.number("offset", 0.0)
        elif child.tag.endswith("MappingTransformation"):
            table = tuple(_entries(child).items())
    return (factor, offset, node.flag("suppressUnitConversion")), table


def _entries(node: XmlNode) -> dict[str, str]:
    return {m.need("source"): m.need("target") for m in node.children("MapEntry")}


def transformed(value: SspValue, entry: XmlNode) -> SspValue:
    """A value after the transformation of a mapping entry, if it has one.

    Raises ScenarioError if the mapping has no entry for the value.
    """
    for child in entry.children():
        if child.tag.endswith("MappingTransformation"):
            table = _entries(child)
            missing = [e for e in value.entries if e not in table]
            if missing:
                raise ScenarioError(f"no entry for {missing[0]!r}", child.place)
            kind = child.tag.removesuffix("MappingTransformation")
            return replace(value, type=kind, entries=tuple(table[e] for e in value.entries))
    return value.through(*transformation(entry)[0])
