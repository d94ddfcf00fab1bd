"""The syntax of a requirement: text to a tree, with the column of each part.

From the weakest to the strongest: ``implies``, ``or``, ``and``, ``until``; ``not``, ``always`` and
``eventually``; comparisons, which may be chained (``-1 rad <= arm.q <= 1 rad``); ``+ -``, ``* /``,
the sign. ``until``, ``always`` and ``eventually`` may have an interval: ``within 2 s``, ``within
[1 s, 2 s]``, ``after 2 s``.
"""

from __future__ import annotations

from math import inf
from typing import Literal, TypeAlias, final

from cosim.base.convert import Struct
from cosim.base.errors import UnitError
from cosim.base.units import conversion
from cosim.formulas.tokens import FUNCTIONS, FormulaError, Token, tokens


class Literals(Struct, frozen=True):
    """A number with its unit, or a list of them; `unit` None: there is none."""

    values: tuple[float, ...]
    unit: str | None
    column: int


class Name(Struct, frozen=True):
    """The name of a signal, or of a metric."""

    text: str
    column: int


class Arithmetic(Struct, frozen=True):
    """``+ - * /`` of two expressions, the sign ``neg`` or a function of some."""

    operator: str
    of: tuple[Expression, ...]
    column: int


Expression: TypeAlias = Literals | Name | Arithmetic


class Inequality(Struct, frozen=True):
    """`large` is at least `small`."""

    large: Expression
    small: Expression
    column: int


class TimeInterval(Struct, frozen=True):
    """A closed interval of time from now on, s; `end` inf: to the end of the run."""

    begin: float = 0.0
    end: float = inf

    @property
    def needed(self) -> float:
        """The time that it needs at least, s."""
        return self.begin if self.end == inf else self.end


class Connective(Struct, frozen=True):
    """``and``, ``or``, ``implies`` of two formulas, or ``not`` of one."""

    word: Literal["and", "or", "implies", "not"]
    of: tuple[Formula, ...]
    column: int


class Temporal(Struct, frozen=True):
    """``always`` or ``eventually`` of one formula, or ``until`` of two, in an interval."""

    word: Literal["always", "eventually", "until"]
    interval: TimeInterval
    of: tuple[Formula, ...]
    column: int


Formula: TypeAlias = Inequality | Connective | Temporal
Node: TypeAlias = Expression | Formula

_COMPARISONS = ("<=", "<", ">=", ">")
#: The strengths of operators between two parts.
_STRENGTH = {
    "implies": 1, "or": 2, "and": 3, "until": 4,
    **dict.fromkeys(_COMPARISONS, 6), "+": 7, "-": 7, "*": 8, "/": 8,
}  # fmt: skip
_PREFIX, _SIGN = 5, 9
#: Parts in each other at the most.
_DEEPEST = 100


def read(text: str) -> Formula:
    """The formula that a text denotes. Raises FormulaError with the column."""
    reader = _FormulaReader(text)
    found = reader.part(0)
    if reader.next.kind != "end":
        raise reader.error(f"found {reader.next}, expected an operator or the end")
    return reader.formula(found)


@final
class _FormulaReader:
    """Reads a text from left to right; `next`: the first token that has not been read."""

    def __init__(self, text: str) -> None:
        self._text, self._tokens, self._place, self._depth = text, tokens(text), 0, 0

    @property
    def next(self) -> Token:
        return self._tokens[self._place]

    def error(self, message: str, column: int = 0) -> FormulaError:
        return FormulaError(message, column or self.next.column, self._text)

    def _take(self) -> Token:
        self._place += 1
        return self._tokens[self._place - 1]

    def _taken(self, text: str) -> bool:
        if self.next.text != text or self.next.kind not in ("operator", "word"):
            return False
        self._place += 1
        return True

    def _expect(self, text: str) -> None:
        if not self._taken(text):
            raise self.error(f"found {self.next}, expected {text!r}")

    # ---- operators ---------------------------------------------------------------------------

    def part(self, least: int) -> Node:
        """A part whose operators have at least the strength `least`."""
        self._depth += 1
        if self._depth > _DEEPEST:
            raise self.error(f"more than {_DEEPEST} parts in each other")
        left = self._first()
        while self.next.kind in ("operator", "word"):
            word = self.next.text
            if word in ("==", "!="):
                raise self.error(f"found {word!r}; expected e.g. abs(a - b) <= 0.01 rad")
            strength = _STRENGTH.get(word, 0)
            if not strength or strength < least:
                break
            left = self._joined(left, self._take(), strength)
        self._depth -= 1
        return left

    def _joined(self, left: Node, token: Token, strength: int) -> Node:
        word, column = token.text, token.column
        if word in _COMPARISONS:
            return self._compared(left, token)
        if word == "until":
            interval = self._interval()
            both = self.formula(left), self.formula(self.part(strength + 1))
            return Temporal("until", interval, both, column)
        if word in ("implies", "or", "and"):
            right = self.part(strength + (word != "implies"))
            both = self.formula(left), self.formula(right)
            return Connective(word, both, column)  # type: ignore[arg-type]
        return Arithmetic(
            word, (self._expression(left), self._expression(self.part(strength + 1))), column
        )

    def _compared(self, left: Node, token: Token) -> Formula:
        """A comparison, or several in a chain."""
        middle = self._expression(self.part(_STRENGTH["+"]))
        first, column = self._expression(left), token.column
        ends = (middle, first) if token.text.startswith("<") else (first, middle)
        found = Inequality(*ends, column)
        if self.next.text in _COMPARISONS:
            return Connective("and", (found, self._compared(middle, self._take())), column)
        return found

    def _first(self) -> Node:
        token = self._take()
        match token.kind, token.text:
            case "word", ("not" | "always" | "eventually") as word:
                interval = self._interval() if word != "not" else TimeInterval()
                of = (self.formula(self.part(_PREFIX)),)
                if word == "not":
                    return Connective("not", of, token.column)
                return Temporal(word, interval, of, token.column)
            case "word", function if function in FUNCTIONS:
                return self._call(token)
            case "operator", "-":
                return Arithmetic("neg", (self._expression(self.part(_SIGN)),), token.column)
            case "operator", "(":
                inner = self.part(0)
                self._expect(")")
                return inner
            case "operator", "[":
                return self._list(token)
            case "number", number:
                return Literals((float(number),), self._unit(), token.column)
            case "name", name:
                return Name(name, token.column)
        self._place -= 1
        raise self.error(f"found {token}, expected a signal, a number or a formula")

    def _call(self, token: Token) -> Arithmetic:
        self._expect("(")
        of = [self._expression(self.part(_STRENGTH["+"]))]
        while self._taken(","):
            of.append(self._expression(self.part(_STRENGTH["+"])))
        self._expect(")")
        if len(of) > 1 and token.text in ("abs", "norm"):
            raise self.error(f"{token.text} takes one argument, found {len(of)}", token.column)
        return Arithmetic(token.text, tuple(of), token.column)

    def _list(self, token: Token) -> Literals:
        """``[40, -60] deg``."""
        values = [self._number()]
        while self._taken(","):
            values.append(self._number())
        self._expect("]")
        return Literals(tuple(values), self._unit(), token.column)

    def _number(self) -> float:
        sign = -1.0 if self._taken("-") else 1.0
        if self.next.kind != "number":
            raise self.error(f"found {self.next}, expected a number")
        return sign * float(self._take().text)

    def _unit(self) -> str | None:
        return self._take().text if self.next.kind == "unit" else None

    # ---- intervals ---------------------------------------------------------------------------

    def _interval(self) -> TimeInterval:
        if self._taken("after"):
            return TimeInterval(self._time())
        if not self._taken("within"):
            return TimeInterval()
        column = self.next.column
        if not self._taken("["):
            return TimeInterval(0.0, self._time())
        begin = self._time()
        self._expect(",")
        end = self._time()
        self._expect("]")
        if not begin <= end:
            raise self.error(f"the interval from {begin:g} s to {end:g} s is empty", column)
        return TimeInterval(begin, end)

    def _time(self) -> float:
        column = self.next.column
        value, unit = self._number(), self._unit()
        if unit is None and value:
            raise self.error(f"{value:g} has no unit; expected a time, like 2 s", column)
        try:
            gain = conversion(unit, "s")[0] if unit else 1.0
        except UnitError as error:
            raise self.error(f"expected a time: {error}", column) from None
        if value < 0:
            raise self.error(f"found {value:g} {unit}, expected a time from now on", column)
        return gain * value

    # ---- kinds -------------------------------------------------------------------------------

    def formula(self, node: Node) -> Formula:
        """The node, which has to be a formula."""
        if isinstance(node, Inequality | Connective | Temporal):
            return node
        raise self.error("found a number, expected a comparison (<= or >=)", node.column)

    def _expression(self, node: Node) -> Expression:
        if isinstance(node, Literals | Name | Arithmetic):
            return node
        raise self.error("found a comparison, expected a number or a signal", node.column)


def names(node: Node) -> list[Name]:
    """The names in a tree, from left to right."""
    if isinstance(node, Name):
        return [node]
    if isinstance(node, Literals):
        return []
    if isinstance(node, Inequality):
        return sorted([*names(node.large), *names(node.small)], key=lambda name: name.column)
    found: list[Name] = []
    for part in node.of:
        found += names(part)
    return found


def comparisons(formula: Formula) -> list[Inequality]:
    """The comparisons in a formula, from left to right."""
    if isinstance(formula, Inequality):
        return [formula]
    found: list[Inequality] = []
    for part in formula.of:
        found += comparisons(part)
    return found
