"""Reads row groups of a Parquet file that has no footer yet, as :mod:`cosim.record.groups` writes.

The footer, which contains the positions of all parts, is written last. But the pages follow each
other, and each has a header (Thrift's compact protocol, ``parquet.thrift``: PageHeader) with the
numbers of values and bytes. Together with the numbers of columns and of rows per group, this is
enough to read them.
"""

from __future__ import annotations

import mmap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import ScenarioError

#: Fields of a PageHeader, and of its DataPageHeader.
_TYPE, _FULL, _PACKED, _DATA, _COUNT = 1, 2, 3, 5, 1
_DATA_PAGE = 0


def groups(path: Path, columns: int, rows: int, count: int) -> Iterator[NDArray[np.float64]]:
    """Yield the first `count` row groups (columns, rows), in the units of the columns.

    Raises ScenarioError if the file does not contain them.
    """
    import pyarrow as pa

    if not count:
        return
    try:
        with path.open("rb") as file:
            at = 4  # behind "PAR1"
            for _ in range(count):
                found = np.empty((columns, rows))
                begin = at - at % mmap.ALLOCATIONGRANULARITY  # what was read before leaves memory
                with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ, offset=begin) as data:
                    at -= begin
                    for column in found:
                        at = _column(pa, data, at, column)
                at += begin
                yield found
    except (OSError, ValueError, IndexError, KeyError, TypeError) as error:
        raise ScenarioError(f"cannot be read: {error}", str(path)) from error


def _column(pa: Any, data: mmap.mmap, at: int, column: NDArray[np.float64]) -> int:
    """Fill one column from the pages at `at`; the place behind them."""
    done = 0
    while done < column.size:
        header, at = _struct(data, at)
        if header[_TYPE] != _DATA_PAGE:
            raise ValueError(f"found a page of type {header[_TYPE]} at byte {at}, expected data")
        packed = data[at : at + header[_PACKED]]
        at += header[_PACKED]
        page = pa.Codec("snappy").decompress(packed, header[_FULL], asbytes=True)
        values = np.frombuffer(page, "<f8", header[_DATA][_COUNT])
        column[done : done + values.size] = values
        done += values.size
    return at


# ---- Thrift's compact protocol ------------------------------------------------------------------


def _varint(data: mmap.mmap, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        shift += 7
        if byte < 0x80:
            return value, at


def _struct(data: mmap.mmap, at: int) -> tuple[dict[int, Any], int]:
    """The fields of a struct by their numbers, and the place behind it."""
    fields: dict[int, Any] = {}
    number = 0
    while (head := data[at]) != 0:
        at += 1
        step, kind = head >> 4, head & 15
        if step:
            number += step
        else:
            raw, at = _varint(data, at)
            number = raw >> 1 ^ -(raw & 1)
        fields[number], at = _value(data, at, kind)
    return fields, at + 1


def _value(data: mmap.mmap, at: int, kind: int) -> tuple[Any, int]:
    match kind:
        case 1 | 2:  # true, false
            return kind == 1, at
        case 4 | 5 | 6:  # integers of 16, 32, 64 bits
            raw, at = _varint(data, at)
            return raw >> 1 ^ -(raw & 1), at
        case 8:  # bytes
            size, at = _varint(data, at)
            return data[at : at + size], at + size
        case 12:
            return _struct(data, at)
    raise ValueError(f"found a field of kind {kind} at byte {at}, expected a page header")
