"""Arrays of the engine's structs, filled in by columns."""

from __future__ import annotations

import ctypes as c
from collections.abc import Hashable, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.native import structs
from cosim.schedule.operations import Operation

Numbers = NDArray[np.int64]
#: Structs in memory, one after the other: an entry for each, with the fields of C.
Rows = NDArray[np.void]
#: Bytes of a line of the processor's cache.
LINE = 64


@cache
def row_type(struct: Hashable) -> np.dtype[np.void]:
    """The type of a struct of C in NumPy."""
    found: np.dtype[np.void] = np.dtype(struct)  # type: ignore[call-overload]
    return found


def rows_of(array: c.Array[Any]) -> Rows:
    """An array of structs, as a view (n,)."""
    struct: Any = array._type_
    kind = row_type(struct)
    return np.frombuffer(memoryview(array), kind) if len(array) else np.empty(0, kind)


def address_of(array: NDArray[np.float64]) -> int:
    """The address of numbers (n,) or (rows, n) of any unit, which NumPy gives slowly."""
    if not array.size:  # it has no buffer
        return array.ctypes.data
    return c.addressof(c.c_char.from_buffer(array.data))


def in_lines(size: int) -> NDArray[np.float64]:
    """`size` zeros without a unit, (size,), which begin with a line of the cache."""
    room = np.zeros(size + LINE // 8)
    return room[-room.ctypes.data % LINE // 8 :][:size]


def ranges(starts: Numbers, counts: Numbers) -> Numbers:
    """Ranges, one after the other: `counts` (n,) numbers each, from `starts` (n,) on."""
    before = np.cumsum(counts) - counts
    found: Numbers = np.arange(int(counts.sum())) + np.repeat(starts - before, counts)
    return found


def operation_rows(operations: Sequence[Operation]) -> Rows:
    """The operations as an array of C structs, (n,)."""
    found = np.zeros(len(operations), np.dtype(structs.OperationStruct))
    for name, _ in structs.OperationStruct._fields_:
        found[name] = [getattr(op, name) for op in operations]
    return found


def segments(period: Numbers, first: Numbers, apart: NDArray[np.bool_], tick: int) -> Rows:
    """Consecutive operations (n,) that are due together from `tick` on, in order.

    `period`, `first`: ticks `first`, `first + period`, ... after `tick`. `apart` (n,): those that
    belong to something else than the one before.
    """
    new = apart.copy()
    new[:1] = True
    new[1:] |= (np.diff(period) != 0) | (np.diff(first) != 0)
    start = np.flatnonzero(new)
    found = np.zeros(len(start), np.dtype(structs.SegmentStruct))
    found["period"], found["next"] = period[start], first[start] + tick
    found["first"], found["last"] = start, np.append(start[1:], len(period))
    return found


def stretches(
    places: Numbers, signals: Numbers, late: NDArray[np.bool_], owner: Numbers
) -> tuple[Rows, Numbers]:
    """The entries `places` (n,) of a row as C has them, and the owner of each stretch.

    `signals`, `late`, `owner`: of all entries of the row: which it is, whether it is written after
    the row is, and to whom it belongs.
    """
    source, after, of = signals[places], late[places], owner[places]
    new = np.ones(len(places), bool)
    new[1:] = (np.diff(places) != 1) | (np.diff(source) != 1)
    new[1:] |= (after[1:] != after[:-1]) | (np.diff(of) != 0)
    first = np.flatnonzero(new)
    found = np.zeros(len(first), np.dtype(structs.StretchStruct))
    found["place"], found["source"], found["late"] = places[first], source[first], after[first]
    found["count"] = np.diff(np.append(first, len(places)))
    return found, of[first]
