"""Units: every port has one, and every wire is checked.

A unit is a product of powers of known symbols: ``"N.m"``, ``"rad/s"``, ``"N.m.s/rad"``,
``"kg.m2"``, ``"1/s"``, ``"deg"``. ``.`` or ``*`` or ``·`` multiply, everything after ``/`` divides
(each ``/`` its own next factor), a trailing integer or ``^n`` is a power. ``""`` and ``"1"`` are
dimensionless. `rad` is a dimension of its own, as in FMI's ``BaseUnit``, but two units that
differ only by powers of rad still connect: N·m/rad is N·m.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from math import pi

from cosim.base.errors import UnitError
from cosim.base.toml import EXPECTED, is_usable_number

#: Exponents in the order of FMI's BaseUnit.
BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


@dataclass(frozen=True, slots=True)
class Unit:
    """`value in SI = factor * value + offset`, with the exponents of :data:`BASE`."""

    exponents: tuple[int, ...]
    factor: float = 1.0
    offset: float = 0.0


def _unit(factor: float = 1.0, offset: float = 0.0, **powers: int) -> Unit:
    return Unit(tuple(powers.get(base, 0) for base in BASE), factor, offset)


_SYMBOLS = {
    "1": _unit(),
    "%": _unit(0.01),
    "rad": _unit(rad=1),
    "deg": _unit(pi / 180, rad=1),
    "rev": _unit(2 * pi, rad=1),
    "s": _unit(s=1),
    "min": _unit(60.0, s=1),
    "h": _unit(3600.0, s=1),
    "m": _unit(m=1),
    "g": _unit(1e-3, kg=1),
    "kg": _unit(kg=1),
    "A": _unit(A=1),
    "K": _unit(K=1),
    "degC": _unit(1.0, 273.15, K=1),
    "mol": _unit(mol=1),
    "cd": _unit(cd=1),
    "Hz": _unit(s=-1),
    "rpm": _unit(2 * pi / 60, rad=1, s=-1),
    "N": _unit(kg=1, m=1, s=-2),
    "J": _unit(kg=1, m=2, s=-2),
    "W": _unit(kg=1, m=2, s=-3),
    "Pa": _unit(kg=1, m=-1, s=-2),
    "bar": _unit(1e5, kg=1, m=-1, s=-2),
    "V": _unit(kg=1, m=2, s=-3, A=-1),
    "Ohm": _unit(kg=1, m=2, s=-3, A=-2),
    "C": _unit(A=1, s=1),
}
_PREFIXES = {"n": 1e-9, "u": 1e-6, "µ": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3, "M": 1e6, "G": 1e9}
_NOT_PREFIXED = {"1", "%", "min", "h", "deg", "rev", "rpm", "kg", "degC", "bar"}
_FACTOR = re.compile(r"([A-Za-zµ%]+|1)\^?(-?\d+)?$")


@lru_cache(maxsize=512)
def parse(text: str) -> Unit:
    """The unit that a text denotes. Raises UnitError naming the text and the unknown part."""
    exponents = [0] * len(BASE)
    factor, offset = 1.0, 0.0
    bare = text.strip().replace(" ", "")
    if bare.startswith("[") and bare.endswith("]"):  # as some tools write it
        bare = bare[1:-1]
    pieces = re.split(r"([./*·])", bare or "1")
    signs = [1]  # of what is in the parentheses that are open
    for place, piece in enumerate(pieces[::2]):
        sign = (-1 if place and pieces[2 * place - 1] == "/" else 1) * signs[-1]
        inner = piece.lstrip("(")
        signs += [sign] * (len(piece) - len(inner))
        symbols = inner.rstrip(")")
        closed = len(inner) - len(symbols)
        match = _FACTOR.match(symbols)
        if match is None or closed >= len(signs):
            raise UnitError(f"unit {text!r} cannot be read at {piece!r}; expected e.g. 'N.m/rad'")
        signs = signs[: len(signs) - closed]
        symbol, power = _symbol(match[1], text), sign * int(match[2] or 1)
        factor *= symbol.factor**power
        offset = symbol.offset if len(pieces) == 1 else 0.0
        exponents = [e + power * x for e, x in zip(exponents, symbol.exponents, strict=True)]
    if len(signs) > 1:
        raise UnitError(f"unit {text!r} lacks a closing parenthesis")
    return Unit(tuple(exponents), factor, offset)


def is_unit(text: str) -> bool:
    """True if :func:`parse` knows the unit that a text denotes."""
    try:
        parse(text)
    except UnitError:
        return False
    return True


def _symbol(name: str, text: str) -> Unit:
    if name in _SYMBOLS:
        return _SYMBOLS[name]
    prefix, rest = name[0], name[1:]
    if prefix in _PREFIXES and rest in _SYMBOLS and rest not in _NOT_PREFIXED:
        unit = _SYMBOLS[rest]
        return Unit(unit.exponents, unit.factor * _PREFIXES[prefix])
    raise UnitError(f"unknown unit {name!r} in {text!r}{_with_dot(name)}")


def _with_dot(name: str) -> str:
    """A suggestion for two units that are written together: "Nm" is N.m."""
    parts = ((name[:i], name[i:]) for i in range(1, len(name)))
    found = next((f"{a}.{b}" for a, b in parts if is_unit(a) and is_unit(b)), None)
    return f"; did you mean {found!r}?" if found else ""


def conversion(source: str | Unit, target: str | Unit) -> tuple[float, float]:
    """(gain, offset) so that `gain * x + offset` carries x from `source` to `target`.

    Raises UnitError where the two measure different things (powers of rad apart).
    """
    a = parse(source) if isinstance(source, str) else source
    b = parse(target) if isinstance(target, str) else target
    if a.exponents[:-1] != b.exponents[:-1]:
        raise UnitError(f"[{unit_text(source)}] cannot feed [{unit_text(target)}]")
    return a.factor / b.factor, (a.offset - b.offset) / b.factor


def quantity(text: str, unit: str | Unit) -> float:
    """The value of a text such as ``"5 ms"`` in `unit`. Raises UnitError."""
    number, _, suffix = text.strip().partition(" ")
    try:
        value = float(number)
    except ValueError:
        raise UnitError(f"{text!r} is not a number with a unit, like '5 ms'") from None
    if not suffix:
        raise UnitError(
            f"{text!r} has no unit; expected one that fits [{unit_text(unit)}], or a plain number"
        )
    gain, offset = conversion(suffix, unit)
    if not (is_usable_number(value) and is_usable_number(gain * value + offset)):
        raise UnitError(f"{text!r}: expected {EXPECTED}")
    return gain * value + offset


def time_text(seconds: float, digits: int = 4) -> str:
    """A time in the unit of a thousand powers in which it is at least 1: ``600 ms``, ``2.095 s``.

    From 1 s on it is in s, and the smallest unit is ns; `digits` are significant.
    """
    size = abs(float(f"{seconds:.{digits}g}"))
    if not 0 < size < 10**digits:
        return f"{seconds:.0f} s"
    unit, factor = next((u for u in _TIMES if size >= u[1]), _TIMES[-1])
    return f"{seconds / factor:.{digits}g} {unit}"


_TIMES = (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))


def unit_text(unit: str | Unit) -> str:
    """A unit as text: its name, or its powers of :data:`BASE`."""
    if isinstance(unit, str):
        return unit or "1"
    powers = zip(BASE, unit.exponents, strict=True)
    return (
        ".".join(f"{base}{power if power != 1 else ''}" for base, power in powers if power) or "1"
    )


# ---- numbers and units as a person reads them ---------------------------------------------------

#: Symbols as they are printed.
_PRINTED = {"u": "µ", "Ohm": "Ω", "deg": "°", "degC": "°C"}
#: Symbols whose numbers are printed with a prefix of thousands, and prefixes that fit none of them.
_SCALED = {"s", "m", "rad", "N", "J", "W", "Pa", "V", "A", "Hz"}
_SMALL = {"s": 1.0, "Hz": 1.0}
_LARGE = {"s", "rad"}
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def printed_unit(unit: str) -> str:
    """A unit as it is printed: kg.m2 is kg·m², us is µs, and 1 is empty."""
    return _printed(unit, "") if unit not in ("", "1") else ""


def _printed(unit: str, scaled: str) -> str:
    """A unit as it is printed, with `scaled` in place of its first symbol if that is not empty."""

    def symbol(match: re.Match[str]) -> str:
        name = scaled if scaled and match.start() == 0 else match[1]
        name = _PRINTED.get(name, name)
        if len(name) > 1 and name[0] == "u" and name[1:] in _SYMBOLS:
            name = f"µ{_PRINTED.get(name[1:], name[1:])}"
        return name + (match[2] or "").translate(_RAISED)

    text = re.sub(r"([A-Za-zµ%]+)\^?(-?\d+)?", symbol, unit)
    return text.replace(".", "·").replace("*", "·")


def prefixed(greatest: float, unit: str) -> tuple[float, str]:
    """A factor and a printed unit for numbers in `unit` up to `greatest`: 1000 and ms for 0.6, s.

    The factor is a power of 1000, or 1 if the unit has no prefix that a person would use.
    """
    first = _FACTOR.match(re.split(r"[./*·]", unit)[0])
    size = abs(greatest)
    if first is None or first[2] or not 0.0 < size < float("inf"):
        return 1.0, printed_unit(unit)
    name, own = first[1], 1.0
    if name not in _SCALED and name[:1] in _PREFIXES and name[1:] in _SCALED:
        own, name = _PREFIXES[name[0]], name[1:]
    if name not in _SCALED:
        return 1.0, printed_unit(unit)
    size *= own
    prefix = ""
    if size < _SMALL.get(name, 0.1):
        prefix = next((p for p in ("m", "u") if size >= 0.9995 * _PREFIXES[p]), "n")
    elif size >= 999.95 and name not in _LARGE:
        prefix = next((p for p in ("G", "M") if size >= 0.9995 * _PREFIXES[p]), "k")
    if size < 1e-3 * _PREFIXES["n"]:
        prefix = ""
    return own / _PREFIXES.get(prefix, 1.0), _printed(unit, prefix + name)


def readable(value: float, digits: int = 4) -> str:
    """A number without a unit, of so many significant digits; a power of ten if it needs one."""
    text = f"{value:.{digits}g}"
    mantissa, e, exponent = text.partition("e")
    if e and 1.0 <= abs(value) < 1e6:
        return f"{float(text):.0f}"
    return f"{mantissa} × 10{str(int(exponent)).translate(_RAISED)}" if e else text


def engineering(value: float, unit: str, digits: int = 4) -> str:
    """A value with the unit in which a person reads it: ``600 ms``, ``1.2 kN``, ``3.1 mrad``.

    A value that is not finite is a dash.
    """
    if not abs(value) < float("inf"):
        return "–"
    factor, shown = prefixed(value, unit)
    return f"{readable(factor * value, digits)} {shown}".rstrip().replace(" °", "°")


def engineering_range(low: float, high: float, unit: str, digits: int = 4) -> str:
    """An interval with one unit for both ends: ``0.3 to 1.2 s``."""
    factor, shown = prefixed(max(abs(low), abs(high)), unit)
    ends = f"{readable(factor * low, digits)} to {readable(factor * high, digits)}"
    return f"{ends} {shown}".rstrip()
