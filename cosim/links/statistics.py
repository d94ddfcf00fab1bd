"""Statistics of a link table: ages of held samples, repetitions, and steps back in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cosim.links.grid import Grid
from cosim.links.laws import IntArray
from cosim.native import shared, structs

AGES = np.dtype(structs.AgesStruct)
PERCENTS = (5, 50, 95, 99, 100)


@dataclass(frozen=True, slots=True)
class LinkStatistics:
    """Ages in s (nan where nothing was ever held), shares in percent.

    The age of row r is (n_r·r - n_s·j)·h; percentiles are ages that occurred (the smallest that
    is not exceeded by that share of the rows). `held`, `backwards`: rows that hold the same, or
    an older sample than the row before, of the rows after the first that held something.
    `waiting`: rows that hold nothing yet. `unused`: sent samples that no row ever held, of those
    sent up to the newest that was held.
    """

    rows: int
    age_mean: float
    age_p5: float
    age_p50: float
    age_p95: float
    age_p99: float
    age_maximum: float
    held_percent: float
    backwards_percent: float
    waiting_percent: float
    unused_percent: float


class Ages:
    """Counts rows of many tables as they come, exactly, in C (``ages.c``). Memory grows with the
    greatest ages, not with the run.

    `histories`: a row that differs from the row before holds one of so many samples, counted from
    the newest sent.
    """

    def __init__(self, grids: Sequence[Grid], histories: Sequence[int]) -> None:
        n = len(grids)
        self._h = np.array([x.h for x in grids])
        periods = np.array([(x.n_s, x.n_r) for x in grids], np.int64).reshape(n, 2)
        self._part = np.gcd(*periods.T)  # ticks
        self._state = np.zeros(n, AGES)
        self._state["n_s"], self._state["n_r"] = periods.T // self._part
        self._state["newest"] = self._state["before"] = -1
        size = np.array([1 << (x - 1).bit_length() for x in histories], np.int64)
        self._seen = np.full(int(size.sum()), -1, np.int32)
        self._state["last"] = size - 1
        self._state["seen"] = self._seen.ctypes.data + 4 * (np.cumsum(size) - size)
        self._counts = np.zeros(0, np.int64)
        self._sizes = np.zeros(n, np.int64)

    def add(self, rows: NDArray[np.int32], counts: IntArray) -> None:
        """Count the next rows of all tables, one after the other, `counts` (tables,) each."""
        state, library = self._state, shared.library()
        state["rows"] = rows.ctypes.data + rows.itemsize * (np.cumsum(counts) - counts)
        state["n"] = counts
        library.ages_reach(state.ctypes.data, len(state))
        if (state["n_counts"] > self._sizes).any():
            self._grow(
                np.where(state["n_counts"] > self._sizes, 2 * state["n_counts"], self._sizes)
            )
        library.ages_count(state.ctypes.data, len(state))

    def _grow(self, sizes: IntArray) -> None:
        """Make room for ages below `sizes` (tables,)."""
        firsts, old = np.cumsum(sizes) - sizes, np.cumsum(self._sizes) - self._sizes
        counts = np.zeros(int(sizes.sum()), np.int64)
        counts[np.arange(self._counts.size) + np.repeat(firsts - old, self._sizes)] = self._counts
        self._counts, self._sizes = counts, sizes
        self._state["counts"] = counts.ctypes.data + counts.itemsize * firsts
        self._state["n_counts"] = sizes

    def results(self) -> list[LinkStatistics]:
        """The statistics of all rows so far, of each table."""
        x = {name: self._state[name] for name in AGES.names or ()}
        received = x["row"] - x["waiting"]
        ranks = np.maximum(np.ceil(np.outer(received, PERCENTS) / 100), 1).astype(np.int64)
        ranks[received == 0] = 0
        ages = np.empty_like(ranks)
        shared.library().ages_ranks(
            self._state.ctypes.data,
            len(received),
            ranks.ctypes.data,
            len(PERCENTS),
            ages.ctypes.data,
        )
        seconds = (ages * self._part[:, None]) * self._h[:, None]
        seconds[received == 0] = np.nan
        steps = np.maximum(received - 1, 0)
        columns = [
            x["row"],
            self._means(received),
            *seconds.T,
            _percent(x["held"], steps),
            _percent(x["backwards"], steps),
            _percent(x["waiting"], x["row"]),
            _percent(x["newest"] + 1 - x["used"], x["newest"] + 1),
        ]
        return [LinkStatistics(*row) for row in zip(*(c.tolist() for c in columns), strict=True)]

    def _means(self, received: IntArray) -> NDArray[np.float64]:
        """The mean ages, (tables,), s; nan where nothing is held."""
        firsts = np.cumsum(self._sizes) - self._sizes
        age = np.arange(self._counts.size) - np.repeat(firsts, self._sizes)
        sums = np.concatenate(([0], np.cumsum(age * self._counts)))
        total = (sums[firsts + self._sizes] - sums[firsts]) * self._part
        means: NDArray[np.float64] = total / np.maximum(received, 1) * self._h
        means[received == 0] = np.nan
        return means


def statistics(rows: ArrayLike, grid: Grid) -> LinkStatistics:
    """The statistics of a whole table, (n,) integers. Raises ValueError if it is of the future."""
    sent = np.ascontiguousarray(rows, np.int32)
    newest = grid.n_r * np.arange(sent.size, dtype=np.int64) // grid.n_s
    back = (newest - sent)[sent >= 0]
    if (back < 0).any():
        raise ValueError("a row holds a sample that was not sent yet")
    ages = Ages((grid,), (int(back.max(initial=0)) + 1,))
    ages.add(sent, np.array([sent.size]))
    return ages.results()[0]


def _percent(part: IntArray, whole: IntArray) -> NDArray[np.float64]:
    return np.where(whole > 0, 100.0 * part / np.maximum(whole, 1), 0.0)
