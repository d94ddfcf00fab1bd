"""TOML as it is read everywhere: scenarios, deployments, studies, fault scripts, ``--set``.

``--set path=value`` changes one value of a parsed document before it is checked.

The only place that decides which numbers are numbers. None may be infinite or "not a number", nor
so large or small that computing with it leaves the range of float64; whole numbers have 64 bits, as
TOML has it.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

from cosim.base.errors import ScenarioError
from cosim.base.files import regular
from cosim.base.names import hint, unknown

#: Magnitudes of numbers other than 0: their products with others still are float64.
LEAST, MOST = 1e-150, 1e150
#: Tables in each other; no document of ours has ten.
DEEPEST = 50
#: Tables whose entries may say ``like = "NAME"``: they take the keys of that entry of the table.
LIKE = ("components", "nodes", "buses", "motors", "controllers", "operators")
#: Tables of an entry that are joined key by key; any other key of its own replaces the other's.
JOINED = ("sizes", "options", "parameters", "start", "inputs")
EXPECTED = f"a finite number, 0 or of a magnitude from {LEAST:g} to {MOST:g}"


def read(path: Path, what: str = "a file (.toml)") -> dict[str, Any]:
    """A TOML file as plain data; `what` it is expected to be. Raises ScenarioError."""
    return parse(read_text(path, what), str(path))


def read_text(path: Path, what: str = "a file (.toml)") -> str:
    """The text of a file. Raises ScenarioError."""
    try:
        return regular(path).read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ScenarioError(f"{path}: no such file; expected {what}") from None
    except IsADirectoryError:
        raise ScenarioError(f"{path}: is a folder; expected {what}") from None
    except UnicodeDecodeError as error:
        raise ScenarioError(
            f"{path}: cannot be read: not UTF-8 text (byte {error.start}); expected {what}"
        ) from None
    except (OSError, ValueError) as error:  # ValueError: no path
        raise ScenarioError(f"{path}: cannot be read: {error}") from None


def parse(text: str, place: str) -> dict[str, Any]:
    """TOML as plain data, ``like`` expanded; `place`: where it comes from. Raises ScenarioError."""
    try:
        found = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # ValueError: also a number of 5000 digits
        raise ScenarioError(f"{place}: not valid TOML: {error}") from None
    check_depth(found, place)
    check_numbers(found, place)
    expand_like(found, place)
    return found


def expand_like(document: dict[str, Any], place: str) -> None:
    """Put the keys of the other entry into each entry with ``like``, which is removed.

    Raises ScenarioError at `place` for a name that is not in the same table, and for a circle.
    """
    for key in LIKE:
        table = document.get(key)
        if isinstance(table, dict):
            document[key] = {name: _entry(table, name, f"{place} at {key}") for name in table}


def _entry(entries: dict[str, Any], name: str, place: str) -> Any:
    """The entry `name` with the keys of all entries that it is like, directly or through others."""
    chain = [name]
    while isinstance(entry := entries[chain[-1]], dict) and "like" in entry:
        chain.append(_other(entry["like"], entries, f"{place}.{chain[-1]}.like"))
        if chain.index(chain[-1]) < len(chain) - 1:
            circle = " -> ".join(chain)
            raise ScenarioError(f"entries are like each other: {circle}", f"{place}.{name}.like")
    if len(chain) == 1:
        return entry
    found: dict[str, Any] = {}
    for key in reversed(chain):
        own = {k: v for k, v in deepcopy(entries[key]).items() if k != "like"}
        for k in JOINED:
            if isinstance(own.get(k), dict) and isinstance(found.get(k), dict):
                own[k] = found[k] | own[k]
        found |= own
    return found


def _other(name: Any, entries: dict[str, Any], place: str) -> str:
    if not isinstance(name, str):
        raise ScenarioError(f"found {name!r}; expected the name of another entry", place)
    if not isinstance(entries.get(name), dict):
        raise ScenarioError(unknown(name, entries, "entry of the same table"), place)
    return name


def check_depth(data: Any, place: str) -> None:
    """Refuse plain data of more than :data:`DEEPEST` levels. Raises ScenarioError."""
    level = [data]
    for _ in range(DEEPEST):
        within = [x.values() if isinstance(x, dict) else x for x in level]
        level = [v for some in within for v in some if isinstance(v, dict | list)]
        if not level:
            return
    raise ScenarioError(f"found more than {DEEPEST} tables in each other", place)


def plain(data: Any) -> Any:
    """Data with the numbers and lists of Python where `data` has those of NumPy; else the same."""
    from numpy import generic, ndarray  # a file has none of these

    return _plain(data, (generic, ndarray))


def _plain(data: Any, foreign: tuple[Any, ...]) -> Any:
    if isinstance(data, foreign):
        return data.tolist()
    if isinstance(data, dict):
        found = {key: _plain(value, foreign) for key, value in data.items()}
        return data if all(found[key] is value for key, value in data.items()) else found
    if isinstance(data, list | tuple):
        entries = [_plain(value, foreign) for value in data]
        return data if all(a is b for a, b in zip(entries, data, strict=True)) else entries
    return data


def check_numbers(data: Any, place: str, path: str = "") -> None:
    """Refuse numbers in plain data that are none to compute with. Raises ScenarioError."""
    if isinstance(data, dict):
        for key, value in data.items():
            check_numbers(value, place, f"{path}.{key}" if path else str(key))
    elif isinstance(data, list):
        for i, value in enumerate(data):
            check_numbers(value, place, f"{path}[{i}]")
    elif isinstance(data, int | float) and not isinstance(data, bool):
        check_number(data, f"{place} at {path}" if path else place)


def check_number(value: float, place: str) -> None:
    """Refuse a number, in any unit, that is not :func:`is_usable_number`. Raises ScenarioError."""
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise ScenarioError("found a whole number of more than 64 bits", place)
    if not is_usable_number(value):
        raise ScenarioError(f"found {value!r}; expected {EXPECTED}", place)


def is_usable_number(value: float) -> bool:
    """True if a number, in any unit, is finite and of a size that one can compute with."""
    return value == 0 or LEAST <= abs(value) <= MOST  # neither is NaN


def changed(document: Mapping[str, Any], settings: Sequence[str]) -> dict[str, Any]:
    """A copy of the document with these settings. Raises ScenarioError as :func:`change`."""
    found = deepcopy(dict(document))
    for setting in settings:
        change(found, setting)
    return found


def change(document: dict[str, Any], setting: str) -> None:
    """Apply a setting such as ``components.master.period=0.002``; the value is TOML, or else text.

    Raises ScenarioError if it is not of the form path=value, or if the path leads nowhere.
    """
    key, equals, text = setting.partition("=")
    if not equals or not key.strip():
        raise ScenarioError(f"--set {setting!r}: expected path=value")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        value = text.strip()
    check_numbers(value, f"--set {setting!r}")
    *parents, last = parts(key.strip())
    node: Any = document
    for depth, part in enumerate(parents):
        node = _child(node, part, ".".join(parents[:depth]), setting)
    if isinstance(node, list):
        node[_index(node, last, setting)] = value
    elif isinstance(node, dict):
        node[last] = value
    else:
        raise ScenarioError(f"--set {setting!r}: {'.'.join(parents)} is not a table")


def parts(key: str) -> list[str]:
    """The names of a path, as TOML reads a key: ``nodes."arm.control".step`` has three."""
    try:
        found: Any = tomllib.loads(f"{key} = 0")
    except (ValueError, RecursionError):
        return key.split(".")
    names: list[str] = []
    while isinstance(found, dict) and len(found) == 1:
        (name, found), *_ = found.items()
        names.append(name)
    return names


def _child(node: Any, part: str, above: str, setting: str) -> Any:
    if isinstance(node, list):
        return node[_index(node, part, setting)]
    if not isinstance(node, dict):
        raise ScenarioError(f"--set {setting!r}: {above} is not a table")
    if part not in node and above in ("", "components", "metrics", "figures"):
        known = ", ".join(sorted(node)) or "none"
        raise ScenarioError(
            f"--set {setting!r}: no {part!r} in {above or 'the file'}{hint(part, node)} "
            f"(there are: {known})"
        )
    return node.setdefault(part, {})


def _index(node: Sequence[Any], part: str, setting: str) -> int:
    if not part.isdigit() or int(part) >= len(node):
        raise ScenarioError(
            f"--set {setting!r}: {part!r} is not a valid index; expected an integer below "
            f"{len(node)}"
        )
    return int(part)


def as_toml(value: Any) -> str:
    """A value as TOML text, as a setting takes it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, list):
        return "[" + ", ".join(as_toml(v) for v in value) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{as_toml(k)} = {as_toml(v)}" for k, v in value.items()) + "}"
    return repr(value)
