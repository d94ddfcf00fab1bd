"""Placeholders in the texts of a table, filled in for all members of a kind at once.

Members are described by columns: the numbers of all members that a word stands for. What has no
placeholder is the same object in every member.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import repeat
from typing import Any, NamedTuple

from cosim.base.errors import ScenarioError

_PLACEHOLDER = re.compile(r"\{(\w+)\}")
#: Of every word its numbers, one for each member.
Words = Mapping[str, Sequence[int]]


class Each(NamedTuple):
    """A value in a table that every member has its own of, as it is."""

    values: Sequence[Any]


def filled(value: Any, words: Words, n: int, place: str) -> list[Any]:
    """`value` for each of `n` members; a text that is only a placeholder becomes a number.

    Raises ScenarioError at `place` for a word that is not among `words`.
    """
    return list(_column(value, words, n, place))


def _column(value: Any, words: Words, n: int, place: str) -> Iterable[Any]:
    """The values of all members; where they are one and the same, a ``repeat`` of it."""
    if isinstance(value, Each):
        return value.values
    if isinstance(value, dict):
        columns = [_column(v, words, n, place) for v in value.values()]
        if not all(isinstance(c, repeat) for c in columns):
            return [dict(zip(value, row, strict=True)) for row in zip(*columns, strict=True)]
    elif isinstance(value, list):
        columns = [_column(v, words, n, place) for v in value]
        if not all(isinstance(c, repeat) for c in columns):
            return [list(row) for row in zip(*columns, strict=True)]
    elif isinstance(value, str) and "{" in value:
        return _texts(value, words, n, place)
    return repeat(value, n)


def _texts(text: str, words: Words, n: int, place: str) -> Iterable[Any]:
    used = _PLACEHOLDER.findall(text)
    for word in used:
        if word not in words:
            known = ", ".join(f"{{{w}}}" for w in words)
            raise ScenarioError(f"found {{{word}}} in {text!r}; expected {known}", place)
    if not used:
        return repeat(text, n)
    if _PLACEHOLDER.fullmatch(text):
        return words[used[0]]
    pattern = _PLACEHOLDER.sub("%d", text.replace("%", "%%"))
    return [pattern % row for row in zip(*(words[word] for word in used), strict=True)]
