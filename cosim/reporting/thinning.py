"""Fewer points for the same picture."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import final

import numpy as np
from numpy.typing import NDArray

from cosim.record import Run
from cosim.record.piecewise import RunRows, extent, pieces
from cosim.record.signals import Array, Signals


def thin(y: NDArray[np.float64], most: int = 4000) -> NDArray[np.intp]:
    """Indices, ascending, of at most `most` (≥ 4) of the n samples that keep every extreme.

    The samples are cut into equal stretches; the first smallest and the first largest of each
    stay, and the first and last sample of all. A stretch with a NaN keeps one, so that gaps stay
    gaps. `y`: (n,).
    """
    n = len(y)
    if n <= most:
        return np.arange(n)
    count = (most - 2) // 2
    edges = np.linspace(0, n, count + 1).astype(np.intp)
    width = int(np.diff(edges).max())
    # one row a stretch; short stretches repeat their last sample
    index = np.minimum(edges[:-1, None] + np.arange(width), edges[1:, None] - 1)
    rows, values = np.arange(count), y[index]
    low, high = index[rows, values.argmin(axis=1)], index[rows, values.argmax(axis=1)]
    return np.unique(np.concatenate(([0], low, high, [n - 1])))


@final
class Thinned:
    """:func:`thin` of `count` samples that come in pieces.

    `rows`, ascending, and their values `y`, (m,); `greatest`: the largest finite magnitude of all.
    """

    def __init__(self, count: int, most: int = 4000) -> None:
        self._count, self._at = count, 0
        stretches = max(1, (most - 2) // 2) if count > most else count
        self._edges = np.linspace(0, count, stretches + 1).astype(np.intp)
        self._kept: dict[int, float] = {}
        self._low = self._high = -1  # rows of the stretch that is not complete
        self._values: dict[int, float] = {}
        self._whole = count <= most
        self._arrays: list[Array] = []
        self.greatest = 0.0

    def add(self, y: Array) -> None:
        """Take the next samples, (n,)."""
        finite = np.abs(y[np.isfinite(y)])
        self.greatest = max(self.greatest, float(finite.max()) if finite.size else 0.0)
        if self._whole:
            self._arrays.append(np.array(y))
            return
        begin, end = self._at, self._at + len(y)
        first = int(np.searchsorted(self._edges, begin, side="right")) - 1
        for stretch in range(first, len(self._edges) - 1):
            a, b = int(self._edges[stretch]), int(self._edges[stretch + 1])
            if a >= end:
                break
            if a >= begin:
                self._low = self._high = -1
            part = y[max(a, begin) - begin : min(b, end) - begin]
            if len(part):
                self._extend(part, max(a, begin))
            if b <= end:
                self._keep(self._low, self._high)
        if not begin and len(y):
            self._kept[0] = float(y[0])
        if end == self._count and len(y):
            self._kept[end - 1] = float(y[-1])
        self._at = end

    def _extend(self, part: Array, at: int) -> None:
        """Take a part of a stretch; a NaN comes before all others, and the first of equals."""
        for row, is_low in ((int(part.argmin()), True), (int(part.argmax()), False)):
            known, value = self._low if is_low else self._high, float(part[row])
            if known >= 0:
                old = self._values[known]
                beyond = value < old if is_low else value > old
                if old != old or not (beyond or value != value):
                    continue
            self._values[at + row] = value
            if is_low:
                self._low = at + row
            else:
                self._high = at + row

    def _keep(self, *rows: int) -> None:
        self._kept |= {row: self._values[row] for row in rows}
        self._values = {}

    @property
    def rows(self) -> NDArray[np.intp]:
        """Numbers of the samples that are kept, ascending, (m,)."""
        return np.arange(self._count) if self._whole else np.array(sorted(self._kept), np.intp)

    @property
    def y(self) -> Array:
        """Their values, (m,)."""
        if self._whole:
            return np.concatenate([np.empty(0), *self._arrays])
        return np.array([self._kept[row] for row in sorted(self._kept)])


def thinned(
    run: Signals, names: Sequence[str], most: int = 4000, until: float = inf
) -> dict[str, Thinned]:
    """The samples of scalars that keep every extreme, by name: at most `most` of each.

    `until`: the time of the last one, s.
    """
    count = extent(run)[0]
    if until < inf:
        count = sum(int((piece.t <= until).sum()) for piece in pieces(run, ()))
    found = {name: Thinned(count, most) for name in names}
    for piece in pieces(run, names):
        rows = slice(0, int((piece.t <= until).sum()))
        for name, kept in found.items():
            kept.add(piece.array(name)[rows, 0])
    return found


def drawable(run: Signals, names: Sequence[str]) -> Signals:
    """Signals for a picture: of a long run only rows that keep every extreme of each scalar."""
    if not isinstance(run, Run) or not run.is_long:
        return run
    kept = [samples.rows for samples in thinned(run, names).values()]
    return RunRows(run, names, np.unique(np.concatenate(kept)))
