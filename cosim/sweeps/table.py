"""The table of a sweep: the points of a study that have been run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import nan
from typing import Any

import numpy as np

from cosim.analysis.signals import Array


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
    values = (record.get(name) for record in records)
    return np.array([nan if v is None else float(v) for v in values], dtype=np.float64)


def groups(
    table: SweepTable, axes: Sequence[str]
) -> dict[tuple[Any, ...], list[Mapping[str, Any]]]:
    """Records that agree in these axes, in the order of the table."""
    found: dict[tuple[Any, ...], list[Mapping[str, Any]]] = {}
    for record in table.records:
        found.setdefault(tuple(record[axis] for axis in axes), []).append(record)
    return found
