"""Values of an FMU's variables: ports and parameters made of them, ranges, names, texts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal

from cosim.base.component import Parameter, Port
from cosim.base.errors import FmuError
from cosim.fmi.file.intervals import written
from cosim.fmi.file.ports import VariableGroup
from cosim.fmi.file.variables import NUMERIC, TEXTS, FmuVariable, number

_KINDS: Mapping[str, Literal["real", "integer", "boolean"]] = {
    "Real": "real", "Float64": "real", "Float32": "real", "Boolean": "boolean",
}  # fmt: skip
#: Least and greatest value, and whether it is a whole number, of what has no limits.
UNLIMITED = float("-inf"), float("inf"), False
#: What the whole numbers of a type may be. 64-bit ones are carried exactly up to 2^53 only.
_RANGES = {
    **{f"Int{n}": (-(2.0 ** (n - 1)), 2.0 ** (n - 1) - 1) for n in (8, 16, 32)},
    **{f"UInt{n}": (0.0, 2.0**n - 1) for n in (8, 16, 32)},
    "Integer": (-(2.0**31), 2.0**31 - 1),
    "Int64": (-(2.0**53), 2.0**53),
    "UInt64": (0.0, 2.0**53),
    "Enumeration": (-(2.0**53), 2.0**53),
    "Float32": (-3.4028234663852886e38, 3.4028234663852886e38),
    "Boolean": (0.0, 1.0),
}


def port(group: VariableGroup, *, fed: bool = False, optional: bool = False) -> Port:
    """An output, or with `fed` an input: it holds its start value where nothing is wired to it.

    `optional`: that this is normal.
    """
    v = group.first
    if v.type in TEXTS:
        start = (0.0,) * group.size if fed else ()  # the number of the empty text
        return Port(group.name, group.shape, "1", v.description, start, optional)
    start = tuple(start_numbers(group)) if fed else ()
    low = min(v.limits[0] for v in group.variables)
    high = max(v.limits[1] for v in group.variables)
    unit = v.unit or "1"
    return Port(
        group.name, group.shape, unit, v.description, start, optional, low, high, group.base
    )


def parameter(group: VariableGroup) -> Parameter:
    """A parameter, the start value of a variable that has one, or the interval of a clock."""
    v = group.first
    if v.type == "Clock":
        interval = written(v, group.name).seconds
        return Parameter(group.name, (interval,) * group.size, group.shape, "s", v.description)
    kind: Literal["real", "integer", "boolean"] = _KINDS.get(v.type, "integer")
    return Parameter(
        group.name, tuple(start_numbers(group)), group.shape, v.unit or "1", v.description, kind,
        group.base,
    )  # fmt: skip


def settable(group: VariableGroup) -> bool:
    """True if a scenario may set it before the start; sizes are set otherwise."""
    v = group.first
    if v.type == "Clock":
        return can_set_interval(v)
    if v.type not in NUMERIC or v.variability == "constant":
        return False
    return (
        v.causality == "parameter"
        or (v.causality == "structuralParameter" and not v.is_size)
        or (
            v.causality in ("local", "output")
            and v.initial in ("exact", "approx")
            and bool(v.start)
        )
    )


def can_set_interval(clock: FmuVariable) -> bool:
    """True if an importer may set the interval of a clock (FMI 3.0.2 §2.2.8)."""
    periodic = clock.attributes.get("intervalVariability") in ("fixed", "tunable")
    states = "intervalDecimal" in clock.attributes or "intervalCounter" in clock.attributes
    return clock.causality == "input" and periodic and states


def tunable(v: FmuVariable) -> bool:
    """True if it is a parameter that may change while the FMU runs."""
    return v.causality == "parameter" and v.variability == "tunable" and v.type in NUMERIC


def in_updates(v: FmuVariable) -> bool:
    """True if it may be set and got within a step, in an intermediate update (FMI 3.0)."""
    return v.attributes.get("intermediateUpdate") in ("true", "1")


def start_numbers(group: VariableGroup) -> list[float]:
    """Start values of all scalars, in the variable's unit, or zeros where none are declared."""
    return [number(t) for t in group.start or ("0",) * group.size]


def _range(group: VariableGroup) -> tuple[float, float, bool]:
    """Least and greatest value of its type, and whether values are whole numbers."""
    low, high = _RANGES.get(group.first.type, UNLIMITED[:2])
    return low, high, group.first.type not in ("Real", "Float64", "Float32")


def limits(group: VariableGroup) -> tuple[float, float, bool]:
    """Least and greatest value of a variable, in its unit, and whether it is a whole number."""
    low, high, whole = _range(group)
    least, most = group.first.limits
    return max(low, least), min(high, most), whole


def check_range(group: VariableGroup, values: Sequence[float]) -> None:
    """Refuse a value outside of min and max, or of the range of the type. Raises FmuError.

    Values and limits are in the unit of the variable.
    """
    low, high, whole = _range(group)
    least, most = group.first.limits
    for value in values:
        if value < least:
            raise FmuError(f"{group.name} = {value:g} is below its minimum {least:g}")
        if value > most:
            raise FmuError(f"{group.name} = {value:g} is above its maximum {most:g}")
        if not low <= value <= high or (whole and value != int(value)):
            raise FmuError(
                f"{group.name} = {value:g} is not a valid {group.first.type}; expected "
                f"{'a whole number' if whole else 'a number'} from {low:.17g} to {high:.17g}"
            )


def item(group: VariableGroup, name: str) -> int:
    """The number of an enumeration's item. Raises FmuError naming the items there are."""
    items = group.first.items
    if name not in items:
        there = ", ".join(items) or "none are defined"
        raise FmuError(f"{group.name} has no item {name!r}; expected one of: {there}")
    return items[name]


def item_numbers(group: VariableGroup, value: Any) -> Any:
    """A value, or nested lists of them, with names of items replaced by their numbers.

    Raises FmuError naming the items there are.
    """
    if isinstance(value, list | tuple):
        return [item_numbers(group, v) for v in value]
    return item(group, value) if isinstance(value, str) else value


def sizes_among(variables: Iterable[FmuVariable], given: Mapping[str, Any]) -> dict[str, int]:
    """The given values that are sizes of arrays. Raises FmuError for no size."""
    found = {}
    for v in variables:
        if v.is_size and v.name in given:
            value = given[v.name]
            if not isinstance(value, int) or isinstance(value, bool) or value < 0:
                raise FmuError(f"{v.name} is a size; expected a whole number, found {value!r}")
            found[v.name] = value
    return found


def has_text(groups: Mapping[str, VariableGroup], name: str) -> bool:
    """True if `name` is a String or Binary variable."""
    return name in groups and groups[name].first.type in TEXTS


def texts_for(
    groups: Mapping[str, VariableGroup], given: Mapping[str, str | Sequence[str]], name: str
) -> list[tuple[VariableGroup, tuple[str, ...]]]:
    """String and Binary variables with the values they start from. Raises FmuError."""
    found = []
    for key, value in given.items():
        if not has_text(groups, key):
            there = ", ".join(k for k in groups if has_text(groups, k)) or "none"
            raise FmuError(f"{name}: no String or Binary variable {key!r} (there are: {there})")
        group = groups[key]
        texts = (value,) * group.size if isinstance(value, str) else tuple(value)
        if len(texts) != group.size:
            raise FmuError(f"{name}: {key} has {group.size} entries, found {len(texts)}")
        found.append((group, texts))
    return found


class NumberedTexts:
    """Texts (Binary: hexadecimal), each known by its number, in the order of their appearance.

    A number is a whole number from 0, which is the empty text. Nothing is forgotten in a run.
    """

    def __init__(self) -> None:
        self._texts = [""]
        self._numbers = {"": 0}

    def number(self, text: str) -> float:
        """The number of a text, without a unit."""
        found = self._numbers.get(text)
        if found is None:
            found = self._numbers[text] = len(self._texts)
            self._texts.append(text)
        return float(found)

    def all(self) -> list[str]:
        """All texts, in the order of their numbers."""
        return list(self._texts)

    def take(self, texts: Sequence[str]) -> None:
        """Know these `texts` by their places, and no others."""
        self._texts = list(texts)
        self._numbers = {text: i for i, text in enumerate(texts)}

    def text(self, number: float) -> str:
        """The text of a number (without a unit)."""
        return self._texts[int(number)]
