"""The scenario that fails, as a file that stands alone: TOML that a person can read and change."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from cosim.base.toml import changed
from cosim.falsify.evaluation import Problem
from cosim.falsify.paths import Candidate, as_law
from cosim.links.segments import Segment
from cosim.study.axes import literal

#: Columns of a line.
WIDTH = 100
_BARE = re.compile(r"[A-Za-z0-9_-]+$")
#: Tables of the scenario that name files relative to it.
_FILES = ("components", "links", "topology", "graphs", "bus")


def failing_document(
    problem: Problem, document: Mapping[str, Any], candidate: Candidate, folder: Path
) -> dict[str, Any]:
    """The scenario `document` with the network and values of a candidate, for a file in `folder`.

    Links that the candidate leaves at their nominal delay are constant.
    """
    found = changed(document, problem.settings(candidate))
    paths = problem.kept(candidate)
    for channel, path in zip(problem.channels, paths, strict=True):
        law = as_law(channel.law(path), channel.nominal, candidate.ticks)
        delay: dict[str, Any] = {"law": "constant", "delay": _seconds(channel.nominal)}
        if law.segments:
            delay = {"law": "segments", "delay": _seconds(channel.nominal)}
            speeds = {"rise": law.rise, "fall": law.fall}
            delay |= {k: v for k, v in speeds.items() if v is not None}
            delay["segments"] = [_segment(x) for x in law.segments]
        for i in channel.links:
            found["links"][i].pop("loss", None)
            found["links"][i]["delay"] = delay
    found.pop("falsify", None)
    for key in _FILES:
        if key in found:
            found[key] = _moved(found[key], problem.path.parent, folder)
    return found


def _segment(x: Segment) -> dict[str, Any]:
    value = {"lost": True} if x.delay is None else {"delay": _seconds(x.delay)}
    return {"from": _seconds(x.begin), "to": _seconds(x.end), **value}


def _seconds(value: float) -> str:
    """``750 ms``, ``1.2 s``."""
    if 0 < value < 1:
        return f"{round(1e3 * value, 6):g} ms" if round(1e3 * value, 6) < 1e5 else f"{value!r} s"
    return f"{value:.10g} s"


def _moved(data: Any, old: Path, new: Path) -> Any:
    """The same for a file in another folder: names of files that are in `old` lead there."""
    if isinstance(data, dict):
        return {k: _moved(v, old, new) for k, v in data.items()}
    if isinstance(data, list):
        return [_moved(v, old, new) for v in data]
    if isinstance(data, str) and data and len(data) < 1000:
        kind, colon, name = data.partition(":") if data.startswith("mujoco:") else ("", "", data)
        if not Path(name).is_absolute() and (old / name).is_file():
            return f"{kind}{colon}{os.path.relpath(old / name, new)}"
    return data


def text(document: Mapping[str, Any], comments: Sequence[str] = ()) -> str:
    """A document as TOML, behind lines of comment."""
    head = [f"# {line}".rstrip() for line in comments]
    plain = {k: v for k, v in document.items() if not _is_nested(v)}
    lines = [f"{_key(k)} = {_value(v)}" for k, v in plain.items()]
    for key, value in document.items():
        if key not in plain:
            lines += _table((key,), value)
    return "\n".join([*head, *([""] if head else []), *lines]).rstrip() + "\n"


def _table(path: tuple[str, ...], value: Any) -> Iterator[str]:
    """A table, or an array of them, with the tables in it."""
    if isinstance(value, list):
        for entry in value:
            yield from _entries(path, entry, "[[", "]]")
    else:
        yield from _entries(path, value, "[", "]")


def _entries(
    path: tuple[str, ...], table: Mapping[str, Any], left: str, right: str
) -> Iterator[str]:
    name = ".".join(map(_key, path))
    always = path in (("components",), ("figures",), ("bus",), ("graphs",))
    nested = {k: v for k, v in table.items() if _is_nested(v) and (always or not _fits(k, v))}
    plain = {k: v for k, v in table.items() if k not in nested}
    if plain or not nested or left == "[[":
        yield ""
        yield f"{left}{name}{right}"
    for k, v in plain.items():
        yield f"{_key(k)} = {_value(v)}"
    for k, v in nested.items():
        yield from _table((*path, k), v)


def _is_nested(value: Any) -> bool:
    return isinstance(value, dict) or (
        isinstance(value, list) and bool(value) and all(isinstance(x, dict) for x in value)
    )


def _fits(key: str, value: Any) -> bool:
    return len(f"{key} = {_inline(value)}") <= WIDTH or (
        isinstance(value, list) and all(len(_inline(x)) < WIDTH and not _deep(x) for x in value)
    )


def _deep(table: Mapping[str, Any]) -> bool:
    return any(isinstance(x, dict | list) for x in table.values())


def _value(value: Any) -> str:
    """A value, in several lines if it is a long list."""
    inline = _inline(value)
    if len(inline) <= WIDTH - 10 or not isinstance(value, list) or not value:
        return inline
    return "[\n" + "".join(f"    {_inline(x)},\n" for x in value) + "]"


def _inline(value: Any) -> str:
    if isinstance(value, Mapping):
        inside = ", ".join(f"{_key(k)} = {_inline(v)}" for k, v in value.items())
        return f"{{ {inside} }}" if inside else "{}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_inline, value))}]"
    return literal(value)


def _key(name: str) -> str:
    return name if _BARE.match(name) else literal(name)
