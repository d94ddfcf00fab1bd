"""Tokens of the text of a requirement: numbers with units, names of signals, words, operators."""

from __future__ import annotations

import re
from typing import Literal

from cosim.base.convert import Struct
from cosim.base.errors import ScenarioError, UnitError
from cosim.base.units import is_unit, parse

Kind = Literal["number", "unit", "name", "word", "operator", "end"]
#: Words of formulas, and functions of expressions.
WORDS = ("and", "or", "not", "implies", "always", "eventually", "until", "within", "after")
FUNCTIONS = ("abs", "norm", "max", "min")

_SPACE = re.compile(r"\s*")
_NUMBER = re.compile(r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_SYMBOL = r"[A-Za-zµ%]+(?:\^?\d+)?"
_UNIT = re.compile(rf"{_SYMBOL}(?:[./*·](?:{_SYMBOL}|1))*(?![\w(\[])")
_NAME = re.compile(r"[A-Za-z_]\w*(?:\.\w+|\[\d[\d, ]*\])*")
_QUOTED = re.compile(r"'([^']*)'")
_OPERATOR = re.compile(r"<=|>=|==|!=|[<>+*/()\[\],-]")


class Token(Struct, frozen=True):
    """A token and the column where it begins, counted from 1."""

    kind: Kind
    text: str
    column: int

    def __str__(self) -> str:
        return "the end" if self.kind == "end" else repr(self.text)


class FormulaError(ScenarioError):
    """A requirement that cannot be read; the message has the column and the text."""

    def __init__(self, message: str, column: int, text: str) -> None:
        super().__init__(f"{message}, at column {column} of {text!r}")


def tokens(text: str) -> list[Token]:
    """The tokens of a text, the last of which is the end. Raises FormulaError."""
    found: list[Token] = []
    at = 0
    while True:
        at += len(_SPACE.match(text, at)[0])  # type: ignore[index]
        if at == len(text):
            return [*found, Token("end", "", at + 1)]
        token, at = _token(text, at, found)
        found.append(token)


def _token(text: str, at: int, before: list[Token]) -> tuple[Token, int]:
    """The token at an index behind other tokens, and the index behind it."""
    if _may_have_unit(before):
        unit = _unit(text, at)
        if unit:
            return Token("unit", unit, at + 1), at + len(unit)
    if quoted := _QUOTED.match(text, at):
        return Token("name", quoted[1], at + 1), quoted.end()
    if number := _NUMBER.match(text, at):
        return Token("number", number[0], at + 1), number.end()
    if name := _NAME.match(text, at):
        kind: Kind = "word" if name[0] in (*WORDS, *FUNCTIONS) else "name"
        return Token(kind, name[0], at + 1), name.end()
    if operator := _OPERATOR.match(text, at):
        return Token("operator", operator[0], at + 1), operator.end()
    raise FormulaError(f"found {text[at]!r}, expected a formula", at + 1, text)


def _may_have_unit(before: list[Token]) -> bool:
    """True behind a number, and behind a list of numbers that is not an interval."""
    if not before or before[-1].text != "]":
        return bool(before) and before[-1].kind == "number"
    opening = max(i for i, token in enumerate(before) if token.text == "[")
    return opening == 0 or before[opening - 1].text != "within"


def _unit(text: str, at: int) -> str:
    """The unit behind a number, "" if there is none. Raises FormulaError for an unknown one.

    In ``2 rad/arm.dq`` the unit is rad: the longest text that is one, before a signal.
    """
    found = _UNIT.match(text, at)
    whole = _NAME.match(text, at)
    if found is None and (whole is None or whole[0] in (*WORDS, *FUNCTIONS)):
        shorter = re.match(_SYMBOL, text[at:])
        return shorter[0] if shorter and shorter[0] == "%" else ""
    longest = found[0] if found is not None else ""
    if longest in WORDS:
        return ""
    if longest and is_unit(longest):
        return longest
    most = re.match(r"[\w%µ^.·*/]*", text[at:])
    unit = most[0] if most else ""
    while (cut := max(unit.rfind(c) for c in "*/")) > 0:
        rest, unit = unit[cut + 1 :], unit[:cut]
        if "." in rest and is_unit(unit):
            return unit
    try:
        parse(longest or (whole[0] if whole else ""))
    except UnitError as error:
        raise FormulaError(str(error), at + 1, text) from None
    return longest
