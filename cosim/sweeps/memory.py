"""A run recorded in memory: some columns of the signal vector, and nothing on the disk."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np

from cosim.analysis.preview import Preview
from cosim.analysis.signals import Array
from cosim.base.errors import CosimError
from cosim.engine.again import RepeatedEngine
from cosim.engine.engine import Engine
from cosim.engine.many import can_join, run_many
from cosim.record import Column
from cosim.schedule.plan import Plan

#: Ticks in a chunk at the most, and values a chunk may hold: it should stay in the cache.
_CHUNK_TICKS, _CHUNK_VALUES = 8192, 1 << 18


@final
class Memory:
    """Recorded signals, as metrics read them (:class:`cosim.analysis.signals.Signals`).

    `x`: (columns, n), the rows at the times `t` (n,), s.
    """

    def __init__(self, columns: Sequence[Column], t: Array, x: Array) -> None:
        self._names = Preview({c.name: c.unit for c in columns})
        self._place = {c.name: i for i, c in enumerate(columns)}
        self._t, self._x = t, x

    @property
    def t(self) -> Array:
        """Time of each row, (n,), s."""
        return self._t

    def entries(self, prefix: str) -> tuple[str, ...]:
        """Names of a signal's entries, (m,). Raises ScenarioError for one that is not there."""
        return self._names.entries(prefix)

    def array(self, prefix: str) -> Array:
        """Entries of a signal, (n, m)."""
        places = [self._place[name] for name in self.entries(prefix)]
        first, n = places[0], len(places)
        if places == list(range(first, first + n)):
            return self._x[first : first + n].T
        return self._x[places].T

    def unit(self, prefix: str) -> str:
        """Unit of a signal."""
        return self._names.unit(prefix)


def record(plan: Plan, columns: Sequence[Column], every: int = 1) -> Memory:
    """Run a plan from start to stop; every `every`-th tick of `columns`, and the last one.

    Where an FMU ends the simulation, the last one is that.
    8 bytes a column and row. Raises CosimError as the engine does; KeyboardInterrupt if something
    stopped it.
    """
    with RepeatedEngine() as repeated:
        engine = repeated.begin(plan, [column.index for column in columns])
        found = record_many([engine], columns, every)[0]
    if isinstance(found, BaseException):
        raise found
    return found


def record_many(
    engines: Sequence[Engine], columns: Sequence[Column], every: int = 1
) -> list[Memory | BaseException]:
    """The same of engines at tick 0 that record `columns`, and of what they raise.

    More than one can run together (:func:`cosim.engine.many.together`).
    """
    going = {i: _Rows(engine, columns, every) for i, engine in enumerate(engines)}
    found: dict[int, Memory | BaseException] = {}
    while going:
        for i, error in zip(list(going), _run_chunk(list(going.values())), strict=True):
            if error is not None:
                found[i] = error
                del going[i]
            elif going[i].take():
                found[i] = going.pop(i).memory()
    return [found[i] for i in range(len(engines))]


def _run_chunk(going: Sequence[_Rows]) -> list[BaseException | None]:
    first, engine = going[0], going[0].engine
    buffers = [rows.begin() for rows in going]
    ticks = min(len(buffers[0]) * first.every, engine.plan.ticks - engine.tick)
    if first.joins:
        return run_many([rows.engine for rows in going], ticks, buffers)
    ticks = min(len(buffers[0]), ticks)
    try:
        engine.run(ticks, buffers[0])
    except CosimError as error:
        return [error]
    if engine.tick < first.first + ticks and engine.ended is None:
        raise KeyboardInterrupt
    return [None]


class _Rows:
    """The rows of one run: `engine` writes those of a chunk to a buffer, from tick `first` on.

    `joins`: whether it runs together with others, and writes the rows that are wanted only. A
    component of another one may end it in a tick between them, whose row is then the last.
    """

    def __init__(self, engine: Engine, columns: Sequence[Column], every: int) -> None:
        self.engine, self.every, self.joins = engine, every, can_join(engine)
        self._columns = columns
        ticks = engine.plan.ticks
        self._ticks = np.arange(0, ticks + 1, every, dtype=np.int64)
        if self._ticks[-1] != ticks:
            self._ticks = np.append(self._ticks, ticks)
        self._x = np.empty((len(columns), len(self._ticks)))
        rows = max(64, min(_CHUNK_TICKS, _CHUNK_VALUES // max(1, len(columns))))
        self._buffer = np.empty((min(rows, ticks), len(columns)))
        self._filled = self.first = 0
        self._last: Array | None = None
        engine.state.every = every if self.joins else 1

    def begin(self) -> Array:
        """The buffer for the next chunk, (rows, columns)."""
        self.first = self.engine.tick
        return self._buffer

    def take(self) -> bool:
        """Keep what is in the buffer; return whether that was the last of it."""
        engine, done = self.engine, self.engine.rows
        part = self._buffer[:done]
        if not self.joins:
            if done > engine.tick - self.first:  # it ended in a tick that is recorded already
                self._last = part[-1].copy()
            part = part[-self.first % self.every :: self.every]
        self._x[:, self._filled : self._filled + len(part)] = part.T
        self._filled += len(part)
        return engine.tick >= engine.plan.ticks or engine.ended is not None

    def memory(self) -> Memory:
        """All of them, and the signals as they are at the end."""
        engine = self.engine
        ticks = np.append(self._ticks[self._ticks < engine.tick], engine.tick)
        x = self._x[:, : len(ticks)]
        index = [column.index for column in self._columns]
        x[:, -1] = engine.signals[index] if self._last is None else self._last
        return Memory(self._columns, (ticks * engine.plan.h).astype(np.float64), x)
