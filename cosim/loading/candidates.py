"""Words that a shell offers for the value of an option; read from files only, without NumPy."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

#: Tables of a scenario that may be absent, with keys that are often set.
_USUAL = ("run.seed", "run.start", "run.step", "run.stop", "run.record.every")
_SIGNAL = re.compile(r"[A-Za-z_]\w*\.[A-Za-z_]\w*(?:\[[\d,]+\])?")


def candidates(words: Sequence[str]) -> list[str]:
    """The values that fit the option before the last of `words`, which begin with that word.

    `words`: those behind ``cosim``. Empty where files are meant.
    """
    if not words:
        return []
    before, begun = words[:-1], words[-1]
    option = before[-1] if before else ""
    scenario = next((Path(word) for word in before[1:] if word.endswith(".toml")), None)
    found: Iterator[str] = iter(())
    if before[:1] == ["delays"] and not begun.startswith("-"):
        found = _presets()
    elif option == "--deploy" and scenario is not None:
        found = (path.stem for path in sorted((scenario.parent / "deploy").glob("*.toml")))
    elif option == "--set" and scenario is not None:
        found = _settings(_read(scenario), begun)
    elif option == "--record" and scenario is not None:
        found = _signals(_read(scenario))
    return [word for word in dict.fromkeys(found) if word.startswith(begun)]


def _read(path: Path) -> Mapping[str, Any]:
    from cosim.base import toml
    from cosim.base.errors import CosimError

    try:
        return toml.read(path)
    except CosimError:
        return {}


def _presets() -> Iterator[str]:
    from cosim.links.presets import PRESETS

    yield from PRESETS


def _settings(document: Mapping[str, Any], begun: str) -> Iterator[str]:
    """``PATH=`` of every value of a document; of a preset of a link each value."""
    if begun.endswith("delay.name=") or "delay.name=" in begun:
        path = begun.partition("=")[0]
        yield from (f"{path}={name}" for name in _presets())
        return
    yield from (f"{path}=" for path in (*_paths(document, ""), *_USUAL))


def _paths(node: Any, path: str) -> Iterator[str]:
    """The paths of the values of a document; an entry of a list of tables by its number."""
    if isinstance(node, Mapping):
        for key, value in node.items():
            yield from _paths(value, f"{path}.{key}" if path else str(key))
    elif isinstance(node, list) and any(isinstance(value, Mapping) for value in node):
        for number, value in enumerate(node):
            yield from _paths(value, f"{path}.{number}")
    else:
        yield path


def _signals(document: Mapping[str, Any]) -> Iterator[str]:
    """The signals that a document names, and all of each component."""
    components = document.get("components", {})
    yield from (f"{name}.*" for name in components)
    yield from (t for t in sorted(_texts(document)) if t.partition(".")[0] in components)
    yield "all"


def _texts(node: Any) -> set[str]:
    if isinstance(node, Mapping):
        return {text for value in node.values() for text in _texts(value)}
    if isinstance(node, list):
        return {text for value in node for text in _texts(value)}
    return {node} if isinstance(node, str) and _SIGNAL.fullmatch(node) else set()
