"""A link as a table: sample times of both ends, law and rule, and the stream of rows.

What an engine needs before the run is declared (`history`, `minimum_delay_ticks`); during the run
it asks for rows in chunks of any size. Memory does not grow with the run.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import RunError, ScenarioError
from cosim.base.struct import Struct
from cosim.links.grid import Grid
from cosim.links.laws import Delays, Law
from cosim.links.random_numbers import generator
from cosim.links.semantics import Rule

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
        raise ScenarioError(f"{length} rows; more than {INDEX_MAXIMUM} samples are sent or read")
