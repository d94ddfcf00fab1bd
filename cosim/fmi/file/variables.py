"""The variables of a model description (FMI 2.0.5 §2.2.7, 3.0.2 §2.4.7): types, limits, sizes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import isfinite, prod
from typing import Any
from xml.etree.ElementTree import Element

from cosim.base.convert import Struct, field

TYPES2 = ("Real", "Integer", "Boolean", "String", "Enumeration")
TYPES3 = (
    *("Float64", "Float32", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32"),
    *("Int64", "UInt64", "Boolean", "String", "Binary", "Enumeration", "Clock"),
)
TEXTS = ("String", "Binary")
NUMERIC = frozenset(TYPES2 + TYPES3) - {*TEXTS, "Clock"}
CAUSALITIES = (
    *("parameter", "calculatedParameter", "structuralParameter", "input", "output"),
    *("local", "independent", "dependent"),
)
VARIABILITIES = ("constant", "fixed", "tunable", "discrete", "continuous")
#: Scalars one variable may have: more is an error of the description, not a signal.
LARGEST = 1_000_000


class FmuVariable(Struct, frozen=True):
    """One variable: a scalar in FMI 2.0, possibly an array in FMI 3.0.

    `limits` are min and max in `unit`; `items` the names of an enumeration; `dimensions` what
    each extent is: a number, or the value reference of a structural parameter; `clocks` the value
    references of the clocks it belongs to; `is_size`: it is a structural parameter that gives a
    dimension its extent; `attributes` everything as written.
    """

    name: str
    type: str
    reference: int
    causality: str
    variability: str
    initial: str
    shape: tuple[int, ...]
    unit: str
    start: tuple[str, ...]
    description: str
    limits: tuple[float, float] = (float("-inf"), float("inf"))
    items: Mapping[str, int] = field(default_factory=dict)
    clocks: tuple[int, ...] = ()
    is_size: bool = False
    attributes: Mapping[str, str] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Number of scalars."""
        return prod(self.shape)


def variables2(root: Element) -> Iterable[FmuVariable]:
    """The variables of an FMU for FMI 2.0. Raises ValueError or KeyError for what cannot be one."""
    types = {
        t.get("name", ""): child for t in root.iterfind("TypeDefinitions/SimpleType") for child in t
    }
    for element in root.iterfind("ModelVariables/ScalarVariable"):
        name = element.get("name")
        typed = next((child for child in element if child.tag in TYPES2), None)
        if not name or typed is None:
            raise ValueError(f"ScalarVariable {name!r} has no name or no type of {TYPES2}")
        start = typed.get("start")
        yield _variable(
            element,
            typed,
            _declared(types, typed, name),
            shape=(),
            variability="continuous" if typed.tag == "Real" else "discrete",
            start=(start,) if start is not None else (),
        )


def variables3(root: Element, sizes: Mapping[str, int]) -> Iterable[FmuVariable]:
    """The variables of FMI 3.0; `sizes`: of structural parameters by name, if not their starts.

    A structural parameter is a size only where a Dimension refers to it (3.0.2 §2.4.7.5); others
    are of any type. Raises ValueError or KeyError for invalid values, and for a size of a variable
    that is none.
    """
    declared = {t.get("name", ""): t for t in root.iterfind("TypeDefinitions/*")}
    elements = list(root.iterfind("ModelVariables/*"))
    extents = _extents(elements, sizes)
    for element in elements:
        if element.tag not in TYPES3:
            raise ValueError(
                f"variable {element.get('name')!r} is of the unknown type {element.tag!r}"
            )
        name = element.attrib["name"]
        yield _variable(
            element,
            element,
            _declared(declared, element, name),
            shape=tuple(_dimension(d, extents, name) for d in element.iterfind("Dimension")),
            variability="continuous" if element.tag.startswith("Float") else "discrete",
            start=_starts(element, sizes),
            is_size=element.get("valueReference") in extents,
        )


def _variable(
    element: Element, typed: Element, declared: Element | None, **found: Any
) -> FmuVariable:
    inherited = {} if declared is None else declared.attrib
    attributes = {**inherited, **typed.attrib, **element.attrib}
    if "name" not in attributes or not (name := element.attrib["name"]):
        raise ValueError("a variable has no name")
    causality = element.get("causality", "local")
    variability = element.get("variability", found["variability"])
    for word, known in ((causality, CAUSALITIES), (variability, VARIABILITIES)):
        if word not in known:
            raise ValueError(f"variable {name!r}: {word!r} is not one of {', '.join(known)}")
    reference = int(element.attrib["valueReference"])
    if not 0 <= reference < 2**32:
        raise ValueError(f"variable {name!r}: valueReference {reference} is not a 32-bit number")
    if prod(found["shape"]) > LARGEST:
        raise ValueError(f"variable {name!r} has more than {LARGEST} entries: {found['shape']}")
    return FmuVariable(
        name=name,
        type=typed.tag,
        reference=reference,
        causality=causality,
        variability=variability,
        initial=element.get("initial", ""),
        shape=found["shape"],
        unit=attributes.get("unit", ""),
        start=_checked(name, typed.tag, found["start"]),
        description=element.get("description", ""),
        limits=limits_of(name, attributes),
        items=_items(name, declared),
        clocks=tuple(int(r) for r in element.get("clocks", "").split()),
        is_size=found.get("is_size", False),
        attributes=attributes,
    )


def _declared(types: Mapping[str, Element], typed: Element, name: str) -> Element | None:
    wanted = typed.get("declaredType")
    if wanted is None:
        return None
    if wanted not in types:
        raise ValueError(f"variable {name!r}: no type {wanted!r} is defined")
    return types[wanted]


def _items(name: str, declared: Element | None) -> dict[str, int]:
    if declared is None or not declared.tag.startswith("Enumeration"):
        return {}
    try:
        return {item.attrib["name"]: int(item.attrib["value"]) for item in declared.iter("Item")}
    except (KeyError, ValueError) as error:
        raise ValueError(f"variable {name!r}: its enumeration cannot be read: {error}") from None


def limits_of(name: str, attributes: Mapping[str, str]) -> tuple[float, float]:
    """Least and greatest value, in the variable's unit. Raises ValueError."""
    try:
        low, high = float(attributes.get("min", "-inf")), float(attributes.get("max", "inf"))
    except ValueError:
        raise ValueError(f"variable {name!r}: min or max is not a number") from None
    if not low <= high:
        raise ValueError(f"variable {name!r}: min {low:g} is above max {high:g}")
    return low, high


def _checked(name: str, kind: str, start: tuple[str, ...]) -> tuple[str, ...]:
    """Start values as written, those of numbers being some; () for one that is NaN or infinite.

    Raises ValueError.
    """
    if kind in NUMERIC:
        for text in start:
            try:
                finite = isfinite(number(text))
            except ValueError:
                raise ValueError(f"variable {name!r}: start {text!r} is not a number") from None
            if not finite:
                return ()
    return start


def number(text: str) -> float:
    """A value as the model description writes it, in its unit: ``"true"`` is 1.

    Raises ValueError.
    """
    words = {"true": 1.0, "false": 0.0}
    return words[text] if text in words else float(text)


def _starts(element: Element, sizes: Mapping[str, int]) -> tuple[str, ...]:
    if element.tag in TEXTS:
        return tuple(s.get("value", "") for s in element.iterfind("Start"))
    given = sizes.get(element.get("name", ""))
    return (str(given),) if given is not None else tuple(element.get("start", "").split())


def _extents(elements: Sequence[Element], sizes: Mapping[str, int]) -> dict[str, int]:
    """Structural parameters that dimensions refer to, by value reference. Raises ValueError."""
    extents: dict[str, int] = {}
    used = {d.get("valueReference") for e in elements for d in e.iterfind("Dimension")}
    known = set()
    for element in elements:
        reference = element.get("valueReference", "")
        if element.get("causality") == "structuralParameter" and reference in used:
            name = element.get("name", "")
            known.add(name)
            text = element.get("start", "")
            if name not in sizes and not text.isdecimal():
                raise ValueError(f"structural parameter {name!r}: start {text!r} is not a size")
            extents[reference] = sizes.get(name, int(text or 0))
    for name in sizes:
        if name not in known:
            there = ", ".join(sorted(known)) or "none"
            raise ValueError(f"no structural parameter {name!r} is a size (there are: {there})")
    return extents


def _dimension(element: Element, extents: Mapping[str, int], name: str) -> int:
    start, reference = element.get("start"), element.get("valueReference", "")
    if start is not None and start.isdecimal():
        return int(start)
    if start is None and reference in extents:
        return extents[reference]
    raise ValueError(
        f"variable {name!r}: dimension {start if start is not None else reference!r} is neither a "
        "size nor the value reference of a structural parameter"
    )
