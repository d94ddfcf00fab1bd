"""Statistics of a link table: ages of held samples, repetitions, and steps back in time."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from math import gcd

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cosim.links.grid import Grid
from cosim.links.laws import FloatArray, IntArray
from cosim.links.table import TableSpec

BLOCK = 1 << 16  # rows worked on at once; they stay in the cache
GATHERED = 1 << 17  # rows of all tables that are counted at once: each time costs the same


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
    """Counts rows of links with the same periods as they come. Exact.

    `history`: how far back the samples are that a row may newly hold, as a table declares it; None:
    as far as one likes. Memory grows with the greatest age and `history`, or else with the run.
    """

    def __init__(self, grid: Grid, links: int = 1, history: int | None = None) -> None:
        self._grid, self._unit = grid, gcd(grid.n_r, grid.n_s)
        self._row = 0
        self._before = np.full(links, -1)  # the last sample that a row held
        self._counts = np.zeros((links, 0), np.int64)  # (links, ages), rows by age in units
        self._steps, self._held, self._backwards, self._waiting, self._used = np.zeros(
            (5, links), np.int64
        )
        self._newest = np.full(links, -1)
        self._history = history
        self._first = 0  # the sample that the first column of `_seen` is about
        self._seen = np.zeros((links, 0), np.bool_)  # whether a row has held it

    def add(self, rows: ArrayLike) -> None:
        """Count the next rows of the tables, (links, n) integers, or (n,) of a single link."""
        sent = np.atleast_2d(np.asarray(rows))
        links, n = sent.shape
        if not n:
            return
        tick = self._grid.n_r * np.arange(self._row, self._row + n, dtype=np.int64)
        self._row += n
        self._remember(int(tick[-1]) // self._grid.n_s + 1)
        together = max(1, BLOCK // n)
        for first in range(0, links, together):
            part = slice(first, first + together)
            self._add(part, sent[part].astype(np.int64), tick)

    def _remember(self, end: int) -> None:
        """Make room for the samples before `end`, and forget those that no new row can hold."""
        kept = self._seen
        if self._history is not None:
            last = self._first + kept.shape[1]
            forgotten = max(0, last - self._history - self._first)
            self._first, kept = self._first + forgotten, kept[:, forgotten:]
        self._seen = np.zeros((len(kept), max(kept.shape[1], end - self._first)), np.bool_)
        self._seen[:, : kept.shape[1]] = kept

    def _add(self, links: slice, sent: IntArray, tick: IntArray) -> None:
        received = sent >= 0
        self._waiting[links] += np.count_nonzero(~received, axis=1)
        self._newest[links] = np.maximum(self._newest[links], sent.max(axis=1))
        self._count_ages(links, (tick - self._grid.n_s * sent) // self._unit, received)
        earlier = np.concatenate((self._before[links, None], sent), axis=1)
        if not received.all():  # rows that hold nothing are passed over
            at = np.where(earlier >= 0, np.arange(earlier.shape[1]), 0)
            earlier = np.take_along_axis(earlier, np.maximum.accumulate(at, axis=1), axis=1)
        self._before[links] = earlier[:, -1]
        compared = received & (earlier[:, :-1] >= 0)
        step = np.where(compared, sent - earlier[:, :-1], 1)
        self._steps[links] += np.count_nonzero(compared, axis=1)
        self._held[links] += np.count_nonzero(step == 0, axis=1)
        self._backwards[links] += np.count_nonzero(step < 0, axis=1)
        seen = self._seen[links]
        known = np.count_nonzero(seen, axis=1)
        link, row = np.nonzero(sent >= self._first)
        seen[link, sent[link, row] - self._first] = True
        self._used[links] += np.count_nonzero(seen, axis=1) - known

    def _count_ages(self, links: slice, age: IntArray, received: NDArray[np.bool_]) -> None:
        ages = max(self._counts.shape[1], int(age.max(where=received, initial=-1)) + 1)
        if ages > self._counts.shape[1]:
            grown = np.zeros((len(self._counts), ages), np.int64)
            grown[:, : self._counts.shape[1]] = self._counts
            self._counts = grown
        if ages:
            place = (np.arange(len(age))[:, None] * ages + age)[received]
            counted = np.bincount(place, minlength=len(age) * ages)
            self._counts[links] += counted.reshape(len(age), ages)

    def result(self) -> LinkStatistics:
        """The statistics of all rows so far, of a single link."""
        return self.results()[0]

    def results(self) -> list[LinkStatistics]:
        """The statistics of all rows so far, of each link."""
        received = self._counts.sum(axis=1)
        some, reached = received > 0, np.cumsum(self._counts, axis=1)

        def known(values: FloatArray) -> list[float]:
            found: list[float] = np.where(some, values, np.nan).tolist()
            return found

        def age(percent: int) -> list[float]:
            rank = np.maximum(1, -(-percent * received // 100))
            return known((reached < rank[:, None]).sum(axis=1) * self._unit * self._grid.h)

        total = self._counts @ np.arange(self._counts.shape[1]) * self._unit
        mean = known(total / np.maximum(received, 1) * self._grid.h)
        shares = [
            _percent(self._held, self._steps), _percent(self._backwards, self._steps),
            _percent(self._waiting, np.full(len(received), self._row)),
            _percent(self._newest + 1 - self._used, self._newest + 1),
        ]  # fmt: skip
        columns = [mean, *map(age, (5, 50, 95, 99, 100)), *shares]
        return [LinkStatistics(self._row, *each) for each in zip(*columns, strict=True)]


class TableAges:
    """Counts the rows of many tables, by name, as they come.

    Tables with the same periods are counted `together`: they must have equal numbers of rows then.
    """

    def __init__(self, tables: Mapping[str, TableSpec], *, together: bool) -> None:
        self._names, groups = list(tables), dict[Hashable, list[int]]()
        for i, (name, table) in enumerate(tables.items()):
            key = (table.grid, table.history) if together else name
            groups.setdefault(key, []).append(i)
        specs = list(tables.values())
        self._groups = [
            (members, Ages(specs[members[0]].grid, len(members), specs[members[0]].history))
            for members in groups.values()
        ]
        self._parts, self._size = list[Sequence[NDArray[np.int32]]](), 0

    def add(self, parts: Sequence[NDArray[np.int32]]) -> None:
        """Take the next rows of each table; they must not change afterwards."""
        self._parts.append(parts)
        self._size += sum(map(len, parts))
        if self._size >= GATHERED:
            self._count()

    def results(self) -> dict[str, LinkStatistics]:
        """The statistics of all rows so far, by name."""
        self._count()
        found: dict[int, LinkStatistics] = {}
        for members, ages in self._groups:
            found |= zip(members, ages.results(), strict=True)
        return {name: found[i] for i, name in enumerate(self._names)}

    def _count(self) -> None:
        for members, ages in self._groups if self._parts else ():
            each = [np.stack([parts[i] for i in members]) for parts in self._parts]
            ages.add(np.concatenate(each, axis=1))
        self._parts.clear()
        self._size = 0


def statistics(rows: ArrayLike, grid: Grid) -> LinkStatistics:
    """The statistics of a whole table, (n,) integers."""
    sent, ages = np.asarray(rows), Ages(grid)
    for start in range(0, sent.size, BLOCK):
        ages.add(sent[start : start + BLOCK])
    return ages.result()


def _percent(part: IntArray, whole: IntArray) -> list[float]:
    found: list[float] = np.where(whole > 0, 100.0 * part / np.maximum(whole, 1), 0.0).tolist()
    return found
