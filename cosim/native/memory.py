"""Memory of C that can be saved: numbers of structs, and bytes at addresses, in pieces.

Another process that makes the same structs has the same pieces at other addresses. Of structs all
numbers are saved, and no pointers.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.native import structs

#: A piece: its name, its entries, and the fields of these that are saved.
Piece = tuple[str, NDArray[np.void], tuple[str, ...]]


def unit_pieces(name: str, unit: structs.UnitStruct) -> Iterator[Piece]:
    """The pieces of an FMU that C steps, beside those of the FMU itself."""
    if unit.typed:
        yield from _typed(name, unit.typed)
    if unit.exchange:
        yield from _exchange(name, unit.exchange)


def save(piece: Piece) -> bytes:
    """The values of a piece."""
    return b"".join(view.tobytes() for view in _views(piece))


def restore(piece: Piece, data: bytes) -> None:
    """Write such values into a piece. Raises ValueError if they are of another size."""
    views = _views(piece)
    if len(data) != size(piece):
        raise ValueError(f"{piece[0]} has {len(data)} bytes")
    at = 0
    for view in views:
        view[...] = np.frombuffer(data, view.dtype, view.size, at).reshape(view.shape)
        at += view.nbytes


def size(piece: Piece) -> int:
    """The number of bytes of a piece."""
    return sum(view.nbytes for view in _views(piece))


def _views(piece: Piece) -> list[NDArray[Any]]:
    """The arrays whose values are saved, one after the other."""
    _, rows, fields = piece
    return [rows[name] for name in fields] if fields else [rows]


def _typed(name: str, address: int) -> Iterator[Piece]:
    """An FMU with other types, events or clocks."""
    typed = structs.TypedStruct.from_address(address)
    yield array(f"{name}.typed", structs.TypedStruct, address, 1)
    held = (structs.AccessStruct * typed.n_discrete).from_address(typed.discrete or 0)
    for i, access in enumerate(held if typed.n_discrete else ()):
        yield whole(f"{name}.held.{i}", access.held, 8 * access.count)
    if typed.n_clocks:
        yield array(f"{name}.clocks", structs.TickerStruct, typed.clocks, typed.n_clocks)
    if typed.n_partitions:
        count = typed.n_partitions
        yield array(f"{name}.partitions", structs.PartitionStruct, typed.partitions, count)
    if typed.n_clocks + typed.n_triggered:
        yield whole(f"{name}.active", typed.active, typed.n_clocks + typed.n_triggered)


def _exchange(name: str, address: int) -> Iterator[Piece]:
    """The solver of an FMU for model exchange: vectors of its states, and of its indicators."""
    x = structs.ExchangeStruct.from_address(address)
    yield array(f"{name}.solver", structs.ExchangeStruct, address, 1)
    size = 7 * x.n_states + 4 * x.n_indicators
    if size:
        yield whole(f"{name}.solver.memory", x.memory, 8 * size)


def whole(name: str, address: int, size: int) -> Piece:
    """A piece of `size` bytes at an address."""
    return name, np.frombuffer(memoryview((c.c_uint8 * size).from_address(address)), np.uint8), ()


def array(name: str, struct: Any, address: int, count: int) -> Piece:
    """A piece: the numbers of `count` structs at an address."""
    kind = _number_type(struct)
    memory = (c.c_uint8 * (count * kind.itemsize)).from_address(address)
    return name, np.frombuffer(memoryview(memory), kind), kind.names or ()


def numbers(name: str, struct: Any, rows: NDArray[np.void]) -> Piece:
    """A piece: the numbers of structs in an array, (n,)."""
    return name, rows, _number_type(struct).names or ()


@cache
def _number_type(struct: Any) -> np.dtype[np.void]:
    """The fields of a struct that are no pointers, nor have any."""
    fields = [(name, kind) for name, kind in struct._fields_ if not _has_pointer(kind)]
    return np.dtype({
        "names": [name for name, _ in fields],
        "formats": [kind for _, kind in fields],
        "offsets": [getattr(struct, name).offset for name, _ in fields],
        "itemsize": c.sizeof(struct),
    })  # fmt: skip


def _has_pointer(kind: Any) -> bool:
    while issubclass(kind, c.Array):
        kind = kind._type_
    if issubclass(kind, c.Structure):
        return any(_has_pointer(field[1]) for field in kind._fields_)
    return kind is c.c_void_p or issubclass(kind, c._Pointer)
