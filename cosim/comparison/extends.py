"""A variants file that extends another: what the published studies change of the shipped one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cosim.base import toml
from cosim.base.errors import ScenarioError

#: Files that may extend each other in a row.
_DEEPEST = 4


def document(path: Path, depth: int = _DEEPEST) -> dict[str, Any]:
    """A variants file as plain data, combined with the files that it extends.

    ``extends = "FILE"``, relative to the file: tables of both are joined, entries of the file
    before those of the other; any other key of the file replaces that of the other. Raises
    ScenarioError, also if files extend each other in a circle.
    """
    data = toml.read(path, "a variants file")
    given = data.pop("extends", None)
    if given is None:
        return data
    if not isinstance(given, str) or depth == 0:
        found = repr(given) if depth else f"more than {_DEEPEST} files in a row"
        raise ScenarioError(f"expected another variants file, found {found}", f"{path} at extends")
    joined = document(path.parent / given, depth - 1)
    for key, value in data.items():
        known = joined.get(key)
        both = isinstance(value, dict) and isinstance(known, dict)
        joined[key] = {**known, **value} if both and known is not None else value
    return joined
