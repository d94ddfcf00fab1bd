"""A link as a table: sample times of both ends, law and rule, and the stream of rows.

What an engine needs before the run is declared (`history`, `minimum_delay_ticks`); during the run
it asks for rows in chunks of any size. Memory does not grow with the run. :class:`Ages` counts the
ages of the samples that rows hold, their repetitions and steps back in time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cosim.base.convert import Struct
from cosim.base.errors import RunError, ScenarioError
from cosim.base.random_numbers import generator
from cosim.links.laws import Delays, IntArray, Law
from cosim.links.semantics import Grid, Rule
from cosim.native import shared, structs

INDEX_MAXIMUM = 2**31 - 1  # a row is an int32


class RowStream(Protocol):
    """The rows of one link, in order."""

    def take(self, n: int) -> NDArray[np.int32]:
        """The next `n` rows, (n,): the sample held at each look, -1: none yet."""


class TableSpec(Protocol):
    """The description of a table, drawn from a law or stored in a file."""

    @property
    def name(self) -> str:
        """The link's name."""

    @property
    def grid(self) -> Grid:
        """Periods of sender and receiver, and the base step."""

    @property
    def history(self) -> int:
        """The number of samples, the newest included, that must be kept so that every new row is
        there.

        A row that equals the one before needs none: the receiver keeps what it holds.
        """

    @property
    def minimum_delay_ticks(self) -> int:
        """No row holds a sample sent fewer ticks before; 0: the link orders like a wire."""

    def check(self, length: int) -> None:
        """Refuse a run of `length` rows that it cannot serve. Raises ScenarioError."""

    def stream(self, length: int | None = None) -> TableStream:
        """The rows from the first on. Raises ScenarioError if there are fewer than `length`."""

    def facts(self) -> dict[str, Any]:
        """The metadata of the table."""


class DrawnTable(Struct, frozen=True, gc=False):
    """A table that a law and a rule make from a seed; `name` keeps apart links of one seed.

    The order in which links are listed does not matter: the generator depends on (seed, name).
    Raises ScenarioError where law and rule contradict each other.
    """

    name: str
    grid: Grid
    law: Law
    rule: Rule
    seed: int

    def __post_init__(self) -> None:
        """Check that the law suits the rule. Raises ScenarioError."""
        if self.seed < 0:
            raise ScenarioError(f"seed {self.seed}; expected 0 or more")
        if self.law.maximum / self.grid.h > INDEX_MAXIMUM:
            raise ScenarioError(
                f"a delay of {self.law.maximum:g} s is more than {INDEX_MAXIMUM} ticks"
            )
        self.rule.check(self.law, self.grid)

    def of(self, name: str, seed: int) -> DrawnTable:
        """The same with other random numbers: only its `name` and `seed` differ."""
        return DrawnTable(name, self.grid, self.law, self.rule, seed)

    @property
    def history(self) -> int:
        """Samples to keep: those sent in the last `greatest` ticks and the newest."""
        return self.rule.greatest(self.law, self.grid) // self.grid.n_s + 1

    @property
    def minimum_delay_ticks(self) -> int:
        """Least age of a sample at a look, ticks."""
        return self.rule.least(self.law, self.grid)

    def check(self, length: int) -> None:
        """Refuse a run that outlasts the law or int32. Raises ScenarioError."""
        check_indices(self.grid, length)
        period, asked = self.rule.asks(self.grid, length)
        limit = self.law.limit(period)
        if limit is not None and asked > limit:
            raise ScenarioError(
                f"the delays end after {limit} samples ({float(limit * period):g} s), the run asks"
                f" for {asked} ({float(asked * period):g} s); expected a shorter run, or"
                " repeat = true"
            )

    def stream(self, length: int | None = None) -> TableStream:
        """The rows, drawn from the start."""
        from cosim.links.drawing import TableDrawing  # not needed to only look at a table

        if length is not None:
            self.check(length)
        return TableStream(TableDrawing((self,)), length)

    def delays(self) -> Delays:
        """The delays that the rule asks for, drawn by NumPy from the start."""
        period, _ = self.rule.asks(self.grid, 0)
        return self.law.stream(period, generator(self.seed, self.name))

    def facts(self) -> dict[str, Any]:
        """Name, periods (ticks), base step (s), law, semantics, seed."""
        return {
            "name": self.name,
            "sender_period": self.grid.n_s,
            "receiver_period": self.grid.n_r,
            "h": self.grid.h,
            "delay": self.law.facts(),
            **self.rule.facts(),
            "seed": self.seed,
        }


class TableStream:
    """Rows in order, in chunks whose sizes do not change them."""

    def __init__(self, rows: RowStream, length: int | None = None) -> None:
        self._rows, self._row = rows, 0
        self._length = INDEX_MAXIMUM if length is None else length

    @property
    def row(self) -> int:
        """The next row."""
        return self._row

    def rows(self, n: int) -> NDArray[np.int32]:
        """The next `n` rows, (n,): the sent sample held at each look, -1: none yet.

        Raises RunError beyond the length the stream was opened for.
        """
        if self._row + n > self._length:
            raise RunError(
                f"rows {self._row} to {self._row + n} of a link table opened for {self._length}"
            )
        self._row += n
        return self._rows.take(n)


def check_indices(grid: Grid, length: int) -> None:
    """Refuse a run whose rows or samples exceed int32. Raises ScenarioError."""
    if max(length, grid.sent(length)) > INDEX_MAXIMUM:
        raise ScenarioError(
            f"found {length} samples that are sent or read until run.stop, expected at most "
            f"{INDEX_MAXIMUM}; stop the run earlier, or give the link a longer period"
        )


AGES = np.dtype(structs.AgesStruct)
PERCENTS = (5, 50, 95, 99, 100)


class LinkStatistics(Struct, frozen=True):
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
