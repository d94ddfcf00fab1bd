"""MATLAB's ``.mat`` files, version 5, written in pieces.

A variable is a matrix: of numbers, of the characters of a text, or of structs, whose fields are
matrices. It begins with its size, so it is known before anything is written.

Source: MathWorks, MAT-File Format, 2023, chapter 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from struct import pack

from cosim.base.errors import ScenarioError

#: Types of data, and classes of matrices.
_INT8, _INT32, _UINT32, _DOUBLE, _MATRIX, _UTF8 = 1, 5, 6, 9, 14, 16
_STRUCT, _CHAR, _NUMBERS = 2, 4, 6
#: Bytes of a variable, and characters of a name, at most.
LARGEST, LONGEST = (1 << 31) - 1, 63
_HEAD = b"MATLAB 5.0 MAT-file, written by cosim-bridge".ljust(124) + pack("<HH", 0x0100, 0x4D49)


@dataclass(frozen=True, slots=True)
class Matrix:
    """A matrix (rows, columns) of a `kind`; `size`: bytes of its data, which `parts` yields."""

    kind: int
    shape: tuple[int, int]
    size: int
    parts: Callable[[], Iterable[bytes]]


def numbers(shape: tuple[int, int], parts: Callable[[], Iterable[bytes]]) -> Matrix:
    """Numbers of any unit, `shape` (n, m), column after column, of which `parts` yields the bytes.

    They are doubles, little-endian.
    """
    count = 8 * shape[0] * shape[1]

    def tagged() -> Iterator[bytes]:
        yield pack("<II", _DOUBLE, count) if count else _element(_DOUBLE, b"")
        yield from parts()

    return Matrix(_NUMBERS, shape, 8 + count, tagged)


def text(characters: str) -> Matrix:
    """A row of characters, (1, n), without a unit."""
    data = _element(_UTF8, characters.encode())
    shape = (1, len(characters)) if characters else (0, 0)
    return Matrix(_CHAR, shape, len(data), lambda: (data,))


def struct(fields: Mapping[str, Matrix]) -> Matrix:
    """A struct (1, 1), without a unit. Raises ScenarioError for a name that is too long."""
    width = 1 + max(map(len, fields))
    if width > 1 + LONGEST:
        raise ScenarioError(
            f"found the name {max(fields, key=len)!r} of {width - 1} characters; MATLAB takes"
            f" {LONGEST}, expected other signals (--signal)"
        )
    names = b"".join(name.encode("ascii").ljust(width, b"\0") for name in fields)
    head = _element(_INT32, pack("<i", width)) + _element(_INT8, names)
    size = len(head) + sum(8 + len(_heading("", one)) + one.size for one in fields.values())

    def parts() -> Iterator[bytes]:
        yield head
        for one in fields.values():
            yield from _written("", one)

    return Matrix(_STRUCT, (1, 1), size, parts)


def write(path: Path, variables: Mapping[str, Matrix]) -> None:
    """Write variables (n, m), in units of their own, to a file.

    Raises ScenarioError for one that is larger than LARGEST bytes.
    """
    for name, one in variables.items():
        if one.size > LARGEST:
            raise ScenarioError(
                f"{name} has {one.size / 1e9:.3g} GB, and a variable of a .mat file (version 5)"
                " at most 2.1 GB; expected fewer signals (--signal), or a .parquet file, which"
                " MATLAB reads as well"
            )
    with path.open("wb") as file:
        file.write(_HEAD)
        for name, one in variables.items():
            file.writelines(_written(name, one))


def _written(name: str, one: Matrix) -> Iterator[bytes]:
    head = _heading(name, one)
    yield pack("<II", _MATRIX, len(head) + one.size) + head
    yield from one.parts()


def _heading(name: str, one: Matrix) -> bytes:
    """The bytes before the data of a matrix: its kind, shape and name."""
    kind = pack("<IIII", _UINT32, 8, one.kind, 0)
    return kind + _element(_INT32, pack("<ii", *one.shape)) + _element(_INT8, name.encode("ascii"))


def _element(kind: int, data: bytes) -> bytes:
    """Data with its type and size, filled up to 8 bytes."""
    if len(data) <= 4:
        return pack("<I4s", len(data) << 16 | kind, data)
    return pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)
