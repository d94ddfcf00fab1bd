"""The table of a sweep: the points of a study that have been run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import nan
from typing import Any, final, overload

import numpy as np
from numpy.typing import NDArray

from cosim.record.signals import Array


@final
class Records(Sequence[Mapping[str, Any]]):
    """Rows that are kept by column: each is a mapping made when it is asked for.

    `columns`: float64, Booleans or objects, (n,) each; `missing`: where a column has no value.
    """

    def __init__(
        self,
        columns: Mapping[str, NDArray[Any]],
        missing: Mapping[str, NDArray[np.bool_]] | None = None,
    ) -> None:
        self.columns, self.missing = columns, missing or {}
        self._n = len(next(iter(columns.values()), ()))

    def __len__(self) -> int:
        return self._n

    @overload
    def __getitem__(self, index: int) -> Mapping[str, Any]: ...
    @overload
    def __getitem__(self, index: slice) -> Records: ...
    def __getitem__(self, index: int | slice) -> Mapping[str, Any] | Records:
        if isinstance(index, slice):
            return self.at(np.arange(self._n)[index])
        if not -self._n <= index < self._n:
            raise IndexError(index)
        return {
            name: None if name in self.missing and self.missing[name][index] else _plain(x[index])
            for name, x in self.columns.items()
        }

    def at(self, rows: NDArray[np.intp]) -> Records:
        """The rows with these numbers (m,)."""
        missing = {name: x[rows] for name, x in self.missing.items()}
        return Records({name: x[rows] for name, x in self.columns.items()}, missing)

    def without(self, name: str) -> Records:
        """The rows without a column."""
        return Records({n: x for n, x in self.columns.items() if n != name}, self.missing)

    def numbers(self, name: str) -> Array:
        """A column (n,); NaN where there is no value."""
        if name not in self.columns:
            return np.full(self._n, nan)
        found = self.columns[name].astype(np.float64)
        if name in self.missing:
            found[self.missing[name]] = nan
        return found


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


@dataclass(frozen=True, slots=True)
class SweepTable:
    """Flat records in the order of the study: axes, measures, ``run``, ``stable``, ``reason``, ...

    `axes`: names of the columns that vary; `units`: of each measure, by its name; `points`: total
    number of points.
    """

    axes: tuple[str, ...]
    units: Mapping[str, str]
    records: Sequence[Mapping[str, Any]]
    points: int


def column(records: Sequence[Mapping[str, Any]], name: str) -> Array:
    """A measure (or ``stable``, as 0 and 1) of records, (n,); NaN where it is not there."""
    if isinstance(records, Records):
        return records.numbers(name)
    values = (record.get(name) for record in records)
    return np.array([nan if v is None else float(v) for v in values], dtype=np.float64)


def entries(records: Sequence[Mapping[str, Any]], name: str) -> list[Any]:
    """A column as it is: texts, or the values of an axis."""
    if isinstance(records, Records) and name not in records.missing:
        found: list[Any] = records.columns[name].tolist()
        return found
    return [record[name] for record in records]


def grouped(
    records: Sequence[Mapping[str, Any]], axes: Sequence[str]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(rows (n,), ends (groups,)): the numbers of records, those that agree in these axes together.

    Groups, and records in them, are in the order of the table; a group ends before `ends`.
    """
    n = len(records)
    codes = np.zeros(n, dtype=np.intp)
    for axis in axes:
        numbers: dict[Any, int] = {}
        values = entries(records, axis)
        own = np.fromiter((numbers.setdefault(v, len(numbers)) for v in values), np.intp, n)
        codes = np.unique(codes * max(1, len(numbers)) + own, return_inverse=True)[1].reshape(n)
    _, first, codes = np.unique(codes, return_index=True, return_inverse=True)
    rank = np.empty_like(first)
    rank[np.argsort(first)] = np.arange(len(first))
    codes = rank[codes.reshape(n)]
    return np.argsort(codes, kind="stable"), np.cumsum(np.bincount(codes, minlength=len(first)))


def groups(
    table: SweepTable, axes: Sequence[str]
) -> dict[tuple[Any, ...], Sequence[Mapping[str, Any]]]:
    """Records that agree in these axes, in the order of the table."""
    records = table.records
    rows, ends = grouped(records, axes)
    found: dict[tuple[Any, ...], Sequence[Mapping[str, Any]]] = {}
    for some in np.split(rows, ends[:-1]) if len(rows) else ():
        key = tuple(records[int(some[0])][axis] for axis in axes)
        found[key] = (
            records.at(some) if isinstance(records, Records) else [records[i] for i in some]
        )
    return found
