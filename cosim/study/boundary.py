"""The boundary of a study: between the runs inside and those beyond it."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import exp, log
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.base.files import write_file
from cosim.record.signals import Array
from cosim.study.axes import Drawn, Listed
from cosim.study.search import record_side
from cosim.study.study import SEED, Study
from cosim.study.table import SweepTable, groups

FILE = "boundary.csv"


@dataclass(frozen=True, slots=True)
class SearchedRegion:
    """The points of one search: `at` (n, axes) in the unit cube and `side` (n,), -1 to 1.

    `chosen`: the values of the listed axes for which it was made. `axes` are those of the cube.
    """

    chosen: Mapping[str, Any]
    axes: Sequence[Drawn]
    at: Array
    side: Array

    def crossings(self) -> tuple[Array, Array]:
        """Places of the boundary (m, axes), and how far they may be off, (m, axes), in the cube.

        One on each edge between neighbours (Delaunay) of which one is inside and one beyond.
        """
        ends = self.edges()
        a, b = self.side[ends[:, 0]], self.side[ends[:, 1]]
        ends = ends[(a < 0.0) != (b < 0.0)]
        low, high = self.at[ends[:, 0]], self.at[ends[:, 1]]
        a, b = self.side[ends[:, 0]], self.side[ends[:, 1]]
        share = (a / (a - b))[:, None]
        return low + share * (high - low), 0.5 * np.abs(high - low)

    def edges(self) -> NDArray[np.intp]:
        """Pairs of neighbours, (m, 2)."""
        if len(self.axes) == 1:
            order = np.argsort(self.at[:, 0])
            return np.stack([order[:-1], order[1:]], axis=1)
        corners = self.simplices()
        pairs = [corners[:, pair] for pair in combinations(range(corners.shape[1]), 2)]
        found: NDArray[np.intp] = np.unique(np.sort(np.concatenate(pairs), axis=1), axis=0)
        return found

    def simplices(self) -> NDArray[np.intp]:
        """The triangles or tetrahedra between the points, (m, axes + 1)."""
        if len(self.at) <= len(self.axes) + 1:
            return np.empty((0, len(self.axes) + 1), np.intp)
        from scipy.spatial import Delaunay

        found: NDArray[np.intp] = Delaunay(self.at).simplices
        return found

    def values(self, at: Array) -> Array:
        """Places in the cube, (m, axes), as values of the axes."""
        return np.stack([_value(axis, u) for axis, u in zip(self.axes, at.T, strict=True)], axis=1)


def regions(study: Study, table: SweepTable) -> list[SearchedRegion]:
    """The points of each search, with the mean side over seeds; none without a boundary."""
    if study.boundary is None or not table.records:
        return []
    drawn = [axis for axis in study.axes if isinstance(axis, Drawn)]
    listed = [a.name for a in study.axes if isinstance(a, Listed) and a.name != SEED]
    found = []
    for chosen, records in groups(table, listed).items():
        sides: dict[tuple[float, ...], list[float]] = {}
        for record in records:
            place = tuple(float(record[axis.name]) for axis in drawn)
            sides.setdefault(place, []).append(record_side(study.boundary, record))
        values = np.array(list(sides), dtype=np.float64).reshape(-1, len(drawn))
        shares: list[Array] = [_share(axis, x) for axis, x in zip(drawn, values.T, strict=True)]
        stacked: Array = np.stack(shares, axis=1)
        at: Array = stacked.round(12)  # what is on the edge of the cube is on it
        mean = np.array([float(np.mean(each)) for each in sides.values()])
        found.append(SearchedRegion(dict(zip(listed, chosen, strict=True)), drawn, at, mean))
    return found


def _value(axis: Drawn, u: Array) -> Array:
    if axis.law == "loguniform":
        return np.exp(log(axis.a) + u * (log(axis.b) - log(axis.a)))
    return axis.a + u * (axis.b - axis.a)


def _share(axis: Drawn, x: Array) -> Array:
    if axis.law == "loguniform":
        return (np.log(x) - log(axis.a)) / (log(axis.b) - log(axis.a))
    return (x - axis.a) / (axis.b - axis.a)


def write(study: Study, table: SweepTable, folder: Path) -> Path | None:
    """Write ``boundary.csv`` of a study with one: its places, and how far each may be off.

    Columns: the listed axes, the searched axes, and ``AXIS.within``: half of the distance between
    the two runs (of a logarithmic axis: the factor of it). Raises RunError with the path.
    """
    if study.boundary is None:
        return None
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    found = regions(study, table)
    names = [axis.name for axis in study.axes if isinstance(axis, Drawn)]
    rows.writerow([*(found[0].chosen if found else ()), *names, *(f"{n}.within" for n in names)])
    for region in found:
        at, off = region.crossings()
        for place, width in zip(region.values(at).tolist(), off.tolist(), strict=True):
            widths = [_width(axis, w) for axis, w in zip(region.axes, width, strict=True)]
            rows.writerow([*region.chosen.values(), *(f"{x:.9g}" for x in (*place, *widths))])
    write_file(folder / FILE, out.getvalue().encode())
    return folder / FILE


def _width(axis: Drawn, u: float) -> float:
    if axis.law == "loguniform":
        return exp(u * (log(axis.b) - log(axis.a)))
    return u * (axis.b - axis.a)


def lines(study: Study, table: SweepTable) -> list[str]:
    """For a terminal: how well each boundary is known."""
    found = []
    for region in regions(study, table):
        at, off = region.crossings()
        who = ", ".join(f"{name} = {value}" for name, value in region.chosen.items())
        text = f"boundary{f' ({who})' if who else ''}: "
        if not len(at):
            inside = "inside" if (region.side < 0.0).all() else "beyond it"
            found.append(f"{text}none between {len(region.at)} points, which are all {inside}")
            continue
        width = float(np.median(np.sqrt((off**2).sum(axis=1))))
        found.append(
            f"{text}{len(at)} places between {len(region.at)} points, half of them within "
            f"{width:.2%} of the ranges"
        )
    return found
