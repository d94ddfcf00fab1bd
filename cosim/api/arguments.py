"""Arguments of the Python interface: each has a type, and a wrong one is named in a sentence."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from inspect import signature
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from cosim.base.errors import ScenarioError


def _is_whole(value: Any) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool)


def _is_texts(value: Any) -> bool:
    several = isinstance(value, Sequence) and not isinstance(value, str | bytes)
    return several and all(isinstance(x, str) for x in value)


def _is_changes(value: Any) -> bool:
    return isinstance(value, Mapping) and all(isinstance(key, str) for key in value)


def _is_time(value: Any) -> bool:
    return isinstance(value, Real | str) and not isinstance(value, bool)


def _is_path(value: Any) -> bool:
    return isinstance(value, str | Path)


def _takes(value: Any, count: int) -> bool:
    """True if `value` is a function of `count` arguments, or one that does not tell its own."""
    if not callable(value):
        return False
    try:
        known = signature(value)
    except (TypeError, ValueError):
        return True
    try:
        known.bind(*range(count))
    except TypeError:
        return False
    return True


#: What each kind of argument takes, and the words for it.
_KINDS: Mapping[str, tuple[Callable[[Any], bool], str]] = {
    "path": (_is_path, "a path"),
    "scenario": (
        lambda value: _is_path(value) or _is_changes(value),
        "the path of a scenario, or a dict with its keys",
    ),
    "changes": (_is_changes, 'a dict of values by path, as {"run.stop": "2 s"}'),
    "whole": (_is_whole, "a whole number"),
    "count": (lambda value: _is_whole(value) and value >= 1, "a whole number of at least 1"),
    "time": (_is_time, 'a number of seconds or a text with a unit, as "500 ms"'),
    "quantity": (_is_time, "a number or a text with a unit"),
    "ports": (
        lambda value: isinstance(value, Mapping),
        'a dict of units by name, as {"q": "rad"}',
    ),
    "parameters": (
        lambda value: (
            _is_changes(value) and all(isinstance(x, tuple) and len(x) == 2 for x in value.values())
        ),
        'a dict of (default, unit) by name, as {"k": (10.0, "N.m/rad")}',
    ),
    "kind": (lambda value: value in ("sampled", "continuous"), '"sampled" or "continuous"'),
    "texts": (_is_texts, "a list of names"),
    "text": (lambda value: isinstance(value, str), "a name"),
    "flag": (lambda value: isinstance(value, bool), "True or False"),
    "of two": (lambda f: _takes(f, 2), "a function of two numbers: ticks done, ticks in all"),
    "of one": (lambda f: _takes(f, 1), "a function of one argument: a row of the table"),
}


def expect(call: str, kinds: Mapping[str, str], given: Mapping[str, Any]) -> None:
    """Refuse arguments of a wrong type. Raises ScenarioError that names the argument of `call`.

    `kinds`: of each argument, with "?" behind it where None stands for the default.
    """
    for name, kind in kinds.items():
        value = given[name]
        if value is None and kind.endswith("?"):
            continue
        right, words = _KINDS[kind.removesuffix("?")]
        if not right(value):
            shown = repr(value)
            shown = shown if len(shown) <= 60 else f"{shown[:57]}..."
            raise ScenarioError(f"found {name} = {shown}, expected {words}", f"cosim.{call}")
