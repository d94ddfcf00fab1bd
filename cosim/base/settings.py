"""``--set path=value``: one value of a parsed document changed, before it is checked."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from typing import Any

from cosim.base import toml
from cosim.base.errors import ScenarioError
from cosim.base.names import hint


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
    toml.check_numbers(value, f"--set {setting!r}")
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
