"""The rows of drawn tables, of many at a time, by ``tables.c``.

C draws constant and uniform delays and independent losses, with the random numbers of NumPy.
Delays of other laws are drawn by NumPy and handed over. What a rule makes of them is C's.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import RunError
from cosim.base.random_numbers import entropy
from cosim.links.laws import Constant, Law, Uniform, draws_per_sample
from cosim.links.semantics import QueueSemantics
from cosim.native import shared
from cosim.native.enums import QueueBit, RuleCode
from cosim.native.structs import PacketStruct, TableStruct

if TYPE_CHECKING:
    from fractions import Fraction

    from cosim.links.laws import Delays
    from cosim.links.semantics import Grid, Rule

#: Rows for which NumPy draws delays at once: they stay in the cache.
BLOCK = 1 << 14
#: Packets on their way for which a table has memory as soon as there are any, at least.
ROOM = 64
RULES = {
    "signal": RuleCode.SIGNAL,
    "last-arrival": RuleCode.LAST_ARRIVAL,
    "newest-stamp": RuleCode.NEWEST_STAMP,
    "fifo": RuleCode.FIFO,
    "playout": RuleCode.PLAYOUT,
    "queue": RuleCode.QUEUE,
}
TABLE, PACKET = np.dtype(TableStruct), np.dtype(PacketStruct)
IntArray = NDArray[np.int64]


class Drawable(Protocol):
    """The members that drawing needs of a :class:`cosim.links.table.DrawnTable`."""

    @property
    def name(self) -> str:
        """The name of the link."""

    @property
    def grid(self) -> Grid:
        """Periods of sender and receiver."""

    @property
    def law(self) -> Law:
        """The law of the delays."""

    @property
    def rule(self) -> Rule:
        """The rule that chooses the sample that is held."""

    @property
    def seed(self) -> int:
        """The seed of its random numbers, used together with the name."""

    def delays(self) -> Delays:
        """The delays that the rule asks for, drawn by NumPy from the start."""


class TableDrawing:
    """Rows of `tables`, from the first on, in chunks whose sizes do not change them."""

    def __init__(self, tables: Sequence[Drawable]) -> None:
        self._tables, self._library = tuple(tables), shared.library()
        found: dict[tuple[object, ...], int] = {}
        kinds: list[TableStruct] = []
        which = np.empty(len(tables), np.int64)
        for i, x in enumerate(tables):
            key = id(x.law), id(x.rule), x.grid.n_s, x.grid.n_r, x.grid.h
            which[i] = kind = found.setdefault(key, len(kinds))
            if kind == len(kinds):
                kinds.append(begun(x))
        some = memoryview((TableStruct * max(1, len(kinds)))(*kinds))
        self._state = np.frombuffer(some, TABLE)[which]
        drawn = self._state["samples"] > 0
        self._given = {i: tables[i].delays() for i in np.flatnonzero(~drawn).tolist()}
        random = (self._state["width"] > 0) | (self._state["lost"] > 0)
        self._seed(np.flatnonzero(drawn & random))
        self._most = self._state["capacity"].copy()  # (tables,), packets on their way, at most
        self._packets = np.empty(0, PACKET)
        self._state["capacity"] = 0

    def _seed(self, places: IntArray) -> None:
        if not places.size:
            return
        parts = [entropy(x.seed, x.name) for x in (self._tables[i] for i in places.tolist())]
        words = np.frombuffer(b"".join(parts), "<u4").astype(np.uint32)
        ends = np.cumsum([len(x) // 4 for x in parts], dtype=np.int64)
        some = self._state[places]
        self._library.tables_seed(some.ctypes.data, len(some), words.ctypes.data, ends.ctypes.data)
        self._state[places] = some

    def _make_room(self, capacity: IntArray) -> None:
        """Memory for so many packets on their way, (tables,)."""
        packets = np.empty(int(capacity.sum()), self._packets.dtype)
        firsts = np.cumsum(capacity) - capacity
        old = (self._state["pending"] - self._packets.ctypes.data) // packets.itemsize
        for i in np.flatnonzero(self._state["n_pending"]):
            n = self._state["n_pending"][i]
            packets[firsts[i] :][:n] = self._packets[old[i] :][:n]
        self._packets, self._state["capacity"] = packets, capacity
        self._state["pending"] = packets.ctypes.data + firsts * packets.itemsize

    def fill(self, rows: NDArray[np.int32], firsts: IntArray, counts: IntArray) -> None:
        """Write the next `counts` (tables,) rows of each table, from `firsts` (tables,) in `rows`
        on.

        Raises RunError, also for a delay that its law rules out.
        """
        state = self._state
        need = state["n_pending"] + counts * state["n_r"] // state["n_s"] + 1
        need = np.minimum(need, self._most)
        if (need > state["capacity"]).any():
            more = np.minimum(np.maximum(2 * need, ROOM), self._most)
            self._make_room(np.where(need > state["capacity"], more, state["capacity"]))
        state["rows"] = rows.ctypes.data + firsts * rows.itemsize
        state["n"] = counts
        for i, delays in self._given.items():
            self._fill_given(i, delays, int(counts[i]))
        if len(self._given) < len(self._tables):
            self._draw(0, len(self._tables))

    def take(self, n: int) -> NDArray[np.int32]:
        """The next `n` rows of each table, one table after the other, (tables · n,)."""
        counts = np.full(len(self._tables), n, np.int64)
        rows = np.empty(n * len(self._tables), np.int32)
        self.fill(rows, np.cumsum(counts) - counts, counts)
        return rows

    def _fill_given(self, i: int, delays: Delays, count: int) -> None:
        table, state = self._tables[i], self._state[i : i + 1]
        for first in range(0, count, BLOCK):
            n, row = min(BLOCK, count - first), int(state["row"][0])
            (_, before), (_, after) = (table.rule.asks(table.grid, r) for r in (row, row + n))
            T = np.ascontiguousarray(delays.take(after - before), np.float64)
            state["delays"], state["n"] = T.ctypes.data, n
            self._draw(i, i + 1)
            state["rows"] += 4 * n
        state["n"] = 0

    def _draw(self, first: int, end: int) -> None:
        """The rows asked for of the tables from `first` to before `end`."""
        state = self._state[first:end]
        wrong = self._library.tables_rows(state.ctypes.data, len(state))
        if wrong >= 0:
            name = self._tables[first + wrong].name
            raise RunError(f"link {name}: a delay that its law rules out")


def begun(table: Drawable) -> TableStruct:
    """A table at its first row; `samples` is 0 if NumPy draws its delays; `capacity`: packets that
    can be on their way at a time.
    """
    grid, rule = table.grid, table.rule.facts()
    code = RULES[rule["semantics"]]
    state = TableStruct(h=grid.h, n_s=grid.n_s, n_r=grid.n_r, rule=code, held=-1)
    state.buffer = grid.ticks(rule.get("playout", 0.0))
    if rule["semantics"] not in ("signal", "playout"):
        state.capacity = grid.ticks(table.law.maximum) // grid.n_s + 1
    if isinstance(table.rule, QueueSemantics):
        state.depth = table.rule.depth
        state.queue = QueueBit.DROP_NEWEST * (table.rule.drop == "newest")
        state.queue |= QueueBit.TAKE_ALL * (table.rule.take == "all")
        # twice, so that packets that leave make room for many that come before memory is moved
        state.capacity = 2 * (state.capacity + table.rule.longest(table.law, grid))
    _set_law(state, table.law, table.rule.asks(grid, 0)[0])
    return state


def _set_law(state: TableStruct, law: Law, period: Fraction) -> None:
    """Describe a law to C, if it is one that C draws."""
    if isinstance(law, Constant):
        state.low = state.high = law.delay
        state.samples = state.rest = 1  # one draw for all samples
    elif isinstance(law, Uniform):
        state.low, state.width, state.high = law.low, law.high - law.low, law.high
        ratio = draws_per_sample(law.hold, period)
        state.draws, state.samples = ratio.numerator, ratio.denominator
        state.rest = state.samples  # the first one for sample 0
    else:
        from cosim.links.losses import Independent, Lossy

        if isinstance(law, Lossy) and isinstance(law.loss, Independent):
            if not law.delay.loses_packets:
                _set_law(state, law.delay, period)
            state.lost = law.loss.p if state.samples else 0.0
