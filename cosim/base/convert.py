"""Conversion of parsed data to structs and to numbers in their units; errors name the place."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar, get_args, get_origin

import msgspec

#: Small frozen objects of which a run has very many, made in a tenth of the time of a dataclass.
#: With ``gc=False`` Python's search for garbage skips them: for what is in no cycle of references.
from msgspec import NODEFAULT as NODEFAULT
from msgspec import Struct as Struct
from msgspec import field as field
from msgspec.structs import FieldInfo as FieldInfo
from msgspec.structs import fields as fields

from cosim.base.errors import ScenarioError, UnitError
from cosim.base.names import unknown
from cosim.base.units import Unit, quantity, unit_text

Number = int | float | str
if TYPE_CHECKING:
    Quantity: TypeAlias = float
else:
    #: A field of a struct that a file gives as Number, and :func:`in_units` makes a float.
    Quantity = Number
Value = Any  # number, boolean, text with a unit, or nested lists of these
T = TypeVar("T")
#: Types as msgspec calls them, in the words of TOML.
TYPES = {
    "int": "a whole number",
    "float": "a number",
    "str": "text",
    "bool": "true or false",
    "array": "a list",
    "object": "a table",
    "null": "nothing",
}


def convert_each(table: Mapping[str, Any], kind: type[T], path: Path, key: str) -> dict[str, T]:
    """:func:`convert` for every entry of a table called `key`."""
    places = (f"{key}.{name}" for name in table)
    return dict(zip(table, _convert_all(list(table.values()), kind, path, places), strict=True))


def convert_array(values: Sequence[Any], kind: type[T], path: Path, key: str) -> list[T]:
    """:func:`convert` for every entry of an array called `key`."""
    return _convert_all(values, kind, path, (f"{key}.{i}" for i in range(len(values))))


def _convert_all(
    values: Sequence[Any], kind: type[T], path: Path, places: Iterable[str]
) -> list[T]:
    try:
        return msgspec.convert(values, list[kind])  # type: ignore[valid-type]
    except msgspec.ValidationError:  # again one by one: the first wrong one is named
        return [
            convert(value, kind, path, place) for value, place in zip(values, places, strict=True)
        ]


def convert(value: Any, kind: type[T], path: Path, place: str = "") -> T:
    """Plain data as a struct of `kind`. Raises ScenarioError naming the file and the place."""
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        message, inside = sentence(error, kind, value)
        if isinstance(cause := error.__cause__, ScenarioError):  # of :func:`in_units`
            message = str(cause).removeprefix(f"{cause.place}: ")
            inside += f".{cause.place}"
        at = f"{place}{_with_key(error, kind, value, inside)}".lstrip(".")
        raise ScenarioError(message, f"{path} at {at}" if at else str(path)) from None


def sentence(error: msgspec.ValidationError, kind: Any, value: Any) -> tuple[str, str]:
    """The mistake in `value` for `kind`, with the nearest key there is, and its place."""
    message, _, inside = str(error).partition(" - at `$")
    inside = inside.rstrip("`")
    keys = [key for key in inside.split(".") if key]
    if key := _quoted(r"Object contains unknown field `(.*)`", message):
        structs = _structs_at(kind, keys)
        known = [f.encode_name for t in structs for f in msgspec.structs.fields(t)]
        return unknown(key, known, "key") if known else f"unknown key {key!r}", inside
    if key := _quoted(r"Object missing required field `(.*)`", message):
        return f"the key {key!r} is missing", inside
    if word := _quoted(r"Invalid value '(.*)'", message):
        tags = [str(struct.__struct_config__.tag) for struct in _structs_at(kind, keys[:-1])]
        return unknown(word, tags, "kind"), inside
    if words := _allowed_words(kind, inside.strip(".")) if "enum" in message else ():
        return f"{message}; expected one of {', '.join(map(str, words))}", inside
    return _in_words_of_toml(message, _found(value, inside)), inside


def _with_key(error: msgspec.ValidationError, kind: Any, value: Any, inside: str) -> str:
    """The place with its key where msgspec writes ``[...]``: in a table whose keys are free."""
    before, dots, after = inside.partition("[...]")
    keys = before.strip(".").split(".") if before else []
    for key in _below(value, keys) if dots and "[" not in before else ():
        try:
            msgspec.convert(_only(value, keys, key), kind)
        except msgspec.ValidationError as again:
            if str(again) == str(error):
                return f"{before}.{key}{after}"
    return inside


def _below(value: Any, keys: Sequence[str]) -> Any:
    for key in keys:
        value = value[key]
    return value


def _only(value: Any, keys: Sequence[str], key: str) -> dict[str, Any]:
    """The value, of whose table at `keys` there is one entry."""
    if not keys:
        return {key: value[key]}
    return {**value, keys[0]: _only(value[keys[0]], keys[1:], key)}


def _in_words_of_toml(message: str, found: str) -> str:
    """``Expected `int`, got `str```: "expected a whole number, found 'x'"; others as they are."""
    parts = re.fullmatch(r"Expected `([^`]*)`(.*?)(?:, got `(.*)`)?", message)
    if parts is None:
        return message
    types = [name for name in parts[1].split(" | ") if name != "null"] or ["null"]
    if "float" in types and "int" in types:
        types.remove("int")
    expected = " or ".join(TYPES.get(name, name) for name in types)
    found = found or (TYPES.get(parts[3], parts[3]) if parts[3] else "")
    return f"expected {expected}{parts[2]}" + (f", found {found}" if found else "")


def _found(value: Any, inside: str) -> str:
    """The value at a place such as ``.a[0].b``, "" if it cannot be told."""
    for key, index in re.findall(r"\.([^.\[\]]+)|\[([^\]]*)\]", inside):
        try:
            value = value[int(index) if index else key]
        except (LookupError, TypeError, ValueError):  # "...": of a table whose keys are free
            return ""
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, int | float | str) else ""


def _quoted(pattern: str, message: str) -> str:
    """The word that a message of msgspec quotes, or "" if it is another."""
    found = re.fullmatch(pattern, message)
    return found[1] if found else ""


def _structs_at(kind: Any, keys: Sequence[str]) -> list[type[msgspec.Struct]]:
    """The structs that a table at a place below `kind` may be; none where that cannot be told."""
    for key in keys:
        name = key.partition("[")[0]
        fields = [f for t in _structs(kind) for f in msgspec.structs.fields(t)]
        kind = next((f.type for f in fields if f.encode_name == name), None)
    return _structs(kind)


def _structs(kind: Any) -> list[type[msgspec.Struct]]:
    """The structs that a type is or has, such as those of a union."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return [kind]
    return [struct for part in get_args(kind) for struct in _structs(part)]


def _allowed_words(kind: Any, key: str) -> tuple[str, ...]:
    """The words a table's key may have, or, without a key, a value: where it is one of some."""
    tables = [t for t in (kind, *get_args(kind)) if isinstance(t, type)]
    fields = [f for t in tables if issubclass(t, msgspec.Struct) for f in msgspec.structs.fields(t)]
    types = [f.type for f in fields if f.encode_name == key] if key else [kind]
    types = [t for found in types for t in (found, *get_args(found))]
    return tuple(word for t in types if get_origin(t) is Literal for word in get_args(t))


def number(value: Number, unit: str | Unit, place: str) -> float:
    """A value in `unit`: a number as it is, or a text with a unit that fits.

    Raises ScenarioError if the text is not a quantity in such a unit.
    """
    if isinstance(value, str):
        try:
            return quantity(value, unit)
        except UnitError as error:
            raise ScenarioError(f"{error} (expected [{unit_text(unit)}])", place) from None
    return float(value)


def in_units(struct: msgspec.Struct, **units: str) -> None:
    """Make these quantities of a struct floats in their units, in its ``__post_init__``.

    Raises ScenarioError at the key, to which :func:`convert` adds the file and the place.
    """
    for key, unit in units.items():
        value = number(getattr(struct, key), unit, key)
        msgspec.structs.force_setattr(struct, key, value)


def numbers(
    value: Value, shape: tuple[int, ...], unit: str | Unit | tuple[str, ...], place: str
) -> tuple[float, ...]:
    """Flattened values, in `unit`, for a signal of `shape`; a single value applies to all entries.

    A tuple has a unit for each entry.
    Raises ScenarioError if the nesting does not match the shape, or an entry is not a number.
    """
    if not isinstance(value, list | tuple):
        if isinstance(value, bool | int | float | str):
            if isinstance(unit, tuple):
                return tuple(number(value, each, place) for each in unit)
            return (number(value, unit, place),) * prod(shape)
        raise ScenarioError(f"expected a number, found {value!r}", place)
    if not shape or len(value) != shape[0]:
        expected = f"{list(shape)}" if shape else "a single number"
        raise ScenarioError(f"expected shape {expected}, found {len(value)} entries", place)
    n = prod(shape[1:])
    return tuple(
        x
        for i, item in enumerate(value)
        for x in numbers(
            item,
            shape[1:],
            unit[i * n : (i + 1) * n] if isinstance(unit, tuple) else unit,
            f"{place}[{i}]",
        )
    )
