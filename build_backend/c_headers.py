"""The structs, enumerators and functions that C headers declare.

A reader of the C that our headers are written in, not of all C: structs and enums without bit
fields, scalars of ``stdint.h``, pointers, arrays, and the functions that a library exports
(``API``). Both branches of ``#if`` are read; bodies of functions are skipped. Anything else in a
struct or an enum raises HeaderError.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

#: Words without a meaning for the layout of memory.
_WORDS = re.compile(r"\b(?:const|volatile|static|extern|struct|BUS_API|API)\b")
_NOISE = re.compile(r"/\*.*?\*/|//[^\n]*|^[ \t]*#(?:[^\n]*\\\n)*[^\n]*", re.S | re.M)
_ENUM = re.compile(r"enum\s*(\w*)\s*\{(.*)\}", re.S)
_STRUCT = re.compile(r"typedef struct\s*\w*\s*\{(.*)\}\s*(\w+)", re.S)
_CALLED = re.compile(r"typedef[^(]*\(\s*\*\s*(\w+)\s*\)\s*\(.*\)", re.S)
_FUNCTION = re.compile(r"(?:BUS_)?API\s+(.*?)(\w+)\s*\((.*)\)", re.S)
_MEMBER = re.compile(r"(\**)\s*(\w*)((?:\s*\[[^]]*\])*)")
_POINTED = re.compile(r"[^(]*\(\s*\*\s*(\w+)\s*\)\s*\(.*\)", re.S)


class HeaderError(ValueError):
    """A declaration is not of the kind that this module reads."""


@dataclass(frozen=True)
class Member:
    """A member of a struct, a parameter, or (without a name) a result.

    `type`: its name in C, "" of a function. `pointers`: how many times it points to that. `shape`:
    of the array that it is.
    """

    name: str
    type: str
    pointers: int = 0
    shape: tuple[int, ...] = ()


@dataclass(frozen=True)
class Struct:
    """``typedef struct { ... } name;`` in the header `header`."""

    name: str
    members: tuple[Member, ...]
    header: str


@dataclass(frozen=True)
class Enum:
    """``enum tag { ... };``, without a tag "": constants. `flags`: values are written as shifts."""

    tag: str
    values: dict[str, int]
    flags: bool
    header: str


@dataclass
class Declarations:
    """Everything that some files declare, in their order: each struct after those it contains."""

    structs: list[Struct] = field(default_factory=list)
    enums: list[Enum] = field(default_factory=list)
    functions: dict[str, tuple[Member, list[Member]]] = field(default_factory=dict)
    constants: dict[str, int] = field(default_factory=dict)


def read(
    headers: Sequence[Path], others: Sequence[Path] = (), include: Path = Path()
) -> Declarations:
    """Declarations of `headers` and the exported functions of `others`, which may be C files.

    Constants of headers in the folder `include` may be used. Raises HeaderError.
    """
    found = Declarations()
    for header in _in_order(headers, include):
        own = header in headers
        for statement in _statements(_text(header)):
            try:
                _declare(found, statement, header.name, own)
            except (HeaderError, ArithmeticError, NameError, SyntaxError) as error:
                line = " ".join(statement.split())[:90]
                raise HeaderError(f"{header}: {error}, in: {line}") from error
    for other in others:
        for statement in _statements(_text(other)):
            _function(found, statement)
    return found


def _text(file: Path) -> str:
    """A file without comments and lines for the preprocessor."""
    return _NOISE.sub(" ", file.read_text(encoding="utf-8"))


def _in_order(headers: Sequence[Path], include: Path) -> list[Path]:
    """The headers and what they include, each behind all that it includes."""
    found: list[Path] = []

    def visit(header: Path) -> None:
        if header in found:
            return
        for name in re.findall(r'^#include "(\w+\.h)"', header.read_text(encoding="utf-8"), re.M):
            for folder in (header.parent, include, include / "bus"):
                if (folder / name).is_file():
                    visit(folder / name)
                    break
        found.append(header)

    for header in sorted(headers):
        visit(header)
    return found


def _statements(text: str) -> Iterator[str]:
    """Declarations at the outer level; of the definition of a function its head."""
    start = depth = 0
    for match in re.finditer(r"[{};]", text):
        what, head = match[0], text[start : match.start()].strip()
        depth += (what == "{") - (what == "}")
        declares = re.match(r"(typedef\s+)?(enum|struct)\b[^(]*$", head.split("{")[0])
        if depth == 0 and (what == ";" or (what == "}" and not declares)):
            yield head.split("{")[0].strip() if what == "}" else head
            start = match.end()


def _declare(found: Declarations, statement: str, header: str, own: bool) -> None:
    if enum := _ENUM.fullmatch(statement):
        values = _values(enum[2], found.constants)
        found.constants |= values
        if own:
            found.enums.append(Enum(enum[1], values, "<<" in enum[2], header))
    elif not own:
        return
    elif struct := _STRUCT.fullmatch(statement):
        lines = (line for line in struct[1].split(";") if line.strip())
        members = tuple(m for line in lines for m in _members(line, found.constants))
        found.structs.append(Struct(struct[2], members, header))
    else:
        _function(found, statement)


def _values(text: str, known: dict[str, int]) -> dict[str, int]:
    """The enumerators of an enum, by name."""
    values: dict[str, int] = {}
    following = 0
    for part in filter(str.strip, text.split(",")):
        name, _, expression = (piece.strip() for piece in part.partition("="))
        value = _number(expression, known | values) if expression else following
        values[name], following = value, value + 1
    return values


def _number(expression: str, known: dict[str, int]) -> int:
    """The value of a constant expression of whole numbers."""
    text = re.sub(r"\b(\d\w*?)[uUlL]+\b", r"\1", expression).replace("/", "//")
    return int(eval(text, {"__builtins__": {}}, dict(known)))


def _members(line: str, known: dict[str, int]) -> list[Member]:
    """The members that one declaration makes: ``const int64_t *a, b[2]``."""
    if pointed := _POINTED.fullmatch(line.strip()):
        return [Member(pointed[1], "", 1)]
    kind, _, rest = _WORDS.sub(" ", line).strip().replace("*", " * ").partition(" ")
    members = []
    for part in rest.split(","):
        match = _MEMBER.fullmatch(part.replace(" ", ""))
        if match is None or not match[2]:
            raise HeaderError(f"found {' '.join(part.split())!r}, expected a member")
        shape = tuple(_number(size, known) for size in re.findall(r"\[([^]]*)\]", match[3]))
        members.append(Member(match[2], kind, len(match[1]), shape))
    return members


def _function(found: Declarations, statement: str) -> None:
    """An exported function; one with ``...`` is not called here."""
    match = _FUNCTION.fullmatch(statement)
    if match is None or "..." in match[3]:
        return
    arguments = [_parameter(part) for part in match[3].split(",") if part.strip() != "void"]
    found.functions.setdefault(match[2], (_parameter(f"{match[1]} "), arguments))


def _parameter(text: str) -> Member:
    """A parameter; an array is a pointer. Without a name: a result."""
    words = _WORDS.sub(" ", text).replace("*", " * ").replace("[", " [").split()
    pointers = words.count("*") + sum(word.startswith("[") for word in words)
    names = [word for word in words if word.isidentifier()]
    return Member(names[1] if len(names) > 1 else "", names[0], pointers)
