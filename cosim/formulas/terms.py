"""Expressions of a requirement with their units, and their values on recorded rows, in SI.

A value is (m, n): entries of a vector or one number, and a row a time, or (m, 1) if it is constant.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import inf

import numpy as np

from cosim.base.convert import Struct
from cosim.base.errors import ScenarioError, UnitError
from cosim.base.units import Unit, conversion, parse, unit_text
from cosim.formulas.syntax import Arithmetic, Expression, Inequality, Literals, Name
from cosim.formulas.tokens import FormulaError
from cosim.formulas.windows import Array

#: The rows of a signal or the value of a metric, (m, n), in its own unit.
Lookup = Callable[[str], Array]


class Known(Struct, frozen=True):
    """A signal or metric: the number of its entries and its unit."""

    size: int
    unit: str


class Term(Struct, frozen=True):
    """An expression: `kind` is ``constant``, ``signal``, or the operator or function of `of`.

    `exponents` of its unit as in :data:`cosim.base.units.BASE`; `size`: of its vector; `unit`: that
    of the signal or number whose dimension it has, or ""; `bare`: without any unit. A constant
    has `values` in SI, a signal a `name` whose numbers `gain * x + offset` are in SI.
    """

    kind: str
    exponents: tuple[int, ...]
    size: int
    unit: str = ""
    of: tuple[Term, ...] = ()
    name: str = ""
    gain: float = 1.0
    offset: float = 0.0
    values: tuple[float, ...] = ()
    bare: bool = False

    @property
    def constant(self) -> float | None:
        """The largest magnitude of a constant, SI; None if it depends on signals."""
        if self.kind == "constant":
            return max(map(abs, self.values))
        if not self.of or any(term.constant is None for term in self.of):
            return None
        return float(np.abs(value(self, _nothing)).max())

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the signals that it reads."""
        return (self.name,) if self.name else tuple(n for term in self.of for n in term.names)


def _nothing(name: str) -> Array:
    raise AssertionError(name)


def value(term: Term, lookup: Lookup) -> Array:
    """The value of a term, (m, n) or (m, 1), SI."""
    if term.kind == "constant":
        return np.array(term.values)[:, None]
    if term.kind == "signal":
        x = lookup(term.name)
        if term.gain != 1.0 or term.offset:
            x = term.gain * x + term.offset
        return x
    return _VALUES[term.kind]([value(part, lookup) for part in term.of])


def _norm(of: Sequence[Array]) -> Array:
    return np.asarray(np.sqrt(np.einsum("ij,ij->j", of[0], of[0])))[None]


def _extreme(combine: np.ufunc) -> Callable[[Sequence[Array]], Array]:
    """The extreme of the entries of one vector, or entry by entry of several."""

    def extreme(of: Sequence[Array]) -> Array:
        if len(of) == 1:
            return np.asarray(combine.reduce(of[0], axis=0))[None]
        found = of[0]
        for other in of[1:]:
            found = combine(found, other)
        return found

    return extreme


_VALUES: Mapping[str, Callable[[Sequence[Array]], Array]] = {
    "neg": lambda of: -of[0],
    "+": lambda of: of[0] + of[1],
    "-": lambda of: of[0] - of[1],
    "*": lambda of: of[0] * of[1],
    "/": lambda of: of[0] / of[1],
    "abs": lambda of: np.abs(of[0]),
    "norm": _norm,
    "max": _extreme(np.maximum),
    "min": _extreme(np.minimum),
}


# ---- from the syntax ----------------------------------------------------------------------------


class Binder(Struct, frozen=True):
    """Turns expressions of `text` into terms; `known` finds a signal by its name.

    `known` raises ScenarioError for a name that is not there.
    """

    text: str
    known: Callable[[str], Known]

    def term(self, node: Expression) -> Term:
        """The term of an expression. Raises FormulaError for units and sizes that do not fit."""
        if isinstance(node, Literals):
            return self._constant(node)
        if isinstance(node, Name):
            return self._signal(node)
        of = tuple(self.term(part) for part in node.of)
        if node.operator in ("abs", "neg"):
            return self._like(node.operator, of, of[0].size)
        if node.operator in ("max", "min", "norm"):
            size = 1 if len(of) == 1 else self._size(node, of)
            self._same(node.column, of)
            return self._like(node.operator, of, size)
        if node.operator in ("+", "-"):
            self._same(node.column, of)
            return self._like(node.operator, of, self._size(node, of))
        return self._product(node, of)

    def margin(self, node: Inequality) -> Term:
        """`large - small` of a comparison."""
        of = self.term(node.large), self.term(node.small)
        ordered = of if node.large.column < node.small.column else of[::-1]
        self._same(node.column, ordered)
        shown = Arithmetic("-", (node.large, node.small), node.column)
        return self._like("-", of, self._size(shown, of))

    def _constant(self, node: Literals) -> Term:
        unit = parse(node.unit or "1")
        values = tuple(unit.factor * x + unit.offset for x in node.values)
        return Term(
            "constant",
            unit.exponents,
            len(values),
            node.unit or "",
            values=values,
            bare=node.unit is None,
        )

    def _signal(self, node: Name) -> Term:
        try:
            known = self.known(node.text)
            unit = parse(known.unit)
        except (ScenarioError, UnitError) as error:
            raise FormulaError(str(error), node.column, self.text) from None
        gain, offset = conversion(unit, Unit(unit.exponents))
        return Term(
            "signal", unit.exponents, known.size, known.unit, name=node.text, gain=gain,
            offset=offset,
        )  # fmt: skip

    def _like(self, kind: str, of: tuple[Term, ...], size: int) -> Term:
        """A term with the unit of those that it is made of."""
        first = next((term for term in of if not term.bare), of[0])
        named = sorted((term for term in of if term.unit), key=lambda x: x.constant is not None)
        unit = named[0].unit if named else ""
        bare = all(term.bare for term in of)
        return Term(kind, first.exponents, size, unit, of, bare=bare)

    def _product(self, node: Arithmetic, of: tuple[Term, ...]) -> Term:
        sign = 1 if node.operator == "*" else -1
        pairs = zip(of[0].exponents, of[1].exponents, strict=True)
        exponents = tuple(a + sign * b for a, b in pairs)
        unit = of[0].unit if of[1].bare else of[1].unit if of[0].bare and sign == 1 else ""
        bare = all(term.bare for term in of)
        return Term(node.operator, exponents, self._size(node, of), unit, of, bare=bare)

    def _size(self, node: Arithmetic, of: Sequence[Term]) -> int:
        sizes = sorted({term.size for term in of} - {1})
        if len(sizes) > 1:
            raise FormulaError(
                f"found vectors of size {sizes[0]} and {sizes[1]}, expected equal sizes",
                node.column, self.text,
            )  # fmt: skip
        return sizes[0] if sizes else 1

    def _same(self, column: int, of: Sequence[Term]) -> None:
        """Refuse terms of different dimensions; powers of rad apart, and 0 has any."""
        first = next((term for term in of if not term.bare), of[0])
        for term in of:
            if term.exponents[:-1] != first.exponents[:-1]:
                if term.bare and term.constant == 0.0:
                    continue
                found = f"found [{shown_unit(first)}] and [{shown_unit(term)}], expected one unit"
            elif not term.bare or not any(first.exponents) or term.constant == 0.0:
                continue
            if term.bare:
                found = f"a number has no unit; expected one that fits [{shown_unit(first)}]"
            raise FormulaError(found, column, self.text)


def shown_unit(term: Term) -> str:
    """The unit in which numbers of a term are told."""
    return term.unit or unit_text(Unit(term.exponents))


# ---- ranges -------------------------------------------------------------------------------------

Range = tuple[float, float]


def span(term: Term, ranges: Callable[[str], Sequence[Range]]) -> list[Range]:
    """The range of each entry of a term, SI, by interval arithmetic.

    `ranges`: those of each entry of a signal in its own unit.
    """
    if term.kind == "constant":
        return [(x, x) for x in term.values]
    if term.kind == "signal":
        return [(term.gain * a + term.offset, term.gain * b + term.offset)
                for a, b in ranges(term.name)]  # fmt: skip
    of = [span(part, ranges) for part in term.of]
    if term.kind == "norm":
        lows, highs = zip(*map(_magnitude, of[0]), strict=True)
        return [(float(np.sqrt(np.sum(np.square(lows)))), float(np.sqrt(np.sum(np.square(highs)))))]
    if term.kind in ("max", "min"):
        pick = max if term.kind == "max" else min
        rows = [of[0]] if len(of) == 1 else [list(row) for row in zip(*_wide(of), strict=True)]
        return [(pick(a for a, _ in row), pick(b for _, b in row)) for row in rows]
    if len(of) == 1:
        return [_magnitude(x) if term.kind == "abs" else (-x[1], -x[0]) for x in of[0]]
    return [_pair(term.kind, a, b) for a, b in zip(*_wide(of), strict=True)]


def _wide(of: Sequence[list[Range]]) -> list[list[Range]]:
    """Operands with the size of the longest."""
    size = max(map(len, of))
    return [x * size if len(x) == 1 else x for x in of]


def _magnitude(x: Range) -> Range:
    low, high = x
    return (0.0 if low <= 0.0 <= high else min(abs(low), abs(high))), max(abs(low), abs(high))


def _pair(kind: str, a: Range, b: Range) -> Range:
    if kind == "+":
        return a[0] + b[0], a[1] + b[1]
    if kind == "-":
        return a[0] - b[1], a[1] - b[0]
    if kind == "/":
        if b[0] <= 0.0 <= b[1]:
            return -inf, inf
        b = (1.0 / b[1], 1.0 / b[0])
    found = [x * y if x and y else 0.0 for x in a for y in b]
    return min(found), max(found)
