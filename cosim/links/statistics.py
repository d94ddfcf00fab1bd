"""Statistics of a link table: ages of held samples, repetitions, and steps back in time."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import ArrayLike

from cosim.links.grid import Grid
from cosim.links.laws import IntArray

REMEMBERED = 1 << 16  # samples of which it is known exactly whether they were held


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
    """Counts rows as they come. Memory grows with the greatest age, not with the run.

    Exact; only `unused` forgets: a sample held again after 2^16 others were sent counts anew.
    """

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._row = 0
        self._before = np.empty(0, np.int64)  # last row of the chunk before, if it held
        self._counts = np.zeros(0, np.int64)  # (greatest age + 1,), rows by age in ticks
        self._total = 0  # ticks, sum of ages: a Python integer
        self._steps = self._held = self._backwards = self._waiting = 0
        # + 1, so that memory of which nothing is used yet is not touched
        self._seen = np.zeros(REMEMBERED, np.int64)
        self._used, self._newest = 0, -1

    def add(self, rows: ArrayLike) -> None:
        """Count the next rows of the table, (n,) integers."""
        sent = np.asarray(rows, dtype=np.int64)
        tick = self._grid.n_r * np.arange(self._row, self._row + sent.size, dtype=np.int64)
        self._row += sent.size
        received = sent >= 0
        age = tick[received] - self._grid.n_s * sent[received]
        counts = np.bincount(age, minlength=self._counts.size)
        counts[: self._counts.size] += self._counts
        self._counts, self._total = counts, self._total + int(age.sum())
        self._waiting += int(np.count_nonzero(~received))
        self._compare(sent[received])

    def _compare(self, sent: IntArray) -> None:
        step = np.diff(np.concatenate((self._before, sent)))
        self._steps += step.size
        self._held += int(np.count_nonzero(step == 0))
        self._backwards += int(np.count_nonzero(step < 0))
        if sent.size:
            self._before = sent[-1:]
            ordered = np.sort(sent)  # np.unique would import numpy.ma, as long as a short run takes
            different = ordered[np.diff(ordered, prepend=-1) != 0]
            slot = different % REMEMBERED
            self._used += int(np.count_nonzero(self._seen[slot] != different + 1))
            self._seen[slot] = different + 1
            self._newest = max(self._newest, int(different[-1]))

    def result(self) -> LinkStatistics:
        """The statistics of all rows so far."""
        h, received = self._grid.h, int(self._counts.sum())
        reached = np.cumsum(self._counts)

        def age(percent: float) -> float:
            if not received:
                return float("nan")
            rank = max(1, ceil(percent * received / 100))
            return int(np.searchsorted(reached, rank)) * h

        return LinkStatistics(
            rows=self._row,
            age_mean=self._total / received * h if received else float("nan"),
            age_p5=age(5),
            age_p50=age(50),
            age_p95=age(95),
            age_p99=age(99),
            age_maximum=age(100),
            held_percent=_percent(self._held, self._steps),
            backwards_percent=_percent(self._backwards, self._steps),
            waiting_percent=_percent(self._waiting, self._row),
            unused_percent=_percent(self._newest + 1 - self._used, self._newest + 1),
        )


def statistics(rows: ArrayLike, grid: Grid) -> LinkStatistics:
    """The statistics of a whole table, (n,) integers."""
    sent, ages = np.asarray(rows), Ages(grid)
    for start in range(0, sent.size, 1 << 16):
        ages.add(sent[start : start + (1 << 16)])
    return ages.result()


def _percent(part: int, whole: int) -> float:
    return 100.0 * part / whole if whole else 0.0
