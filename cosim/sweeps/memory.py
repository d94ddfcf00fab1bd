"""A run recorded in memory: some columns of the signal vector, and nothing on the disk."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import final

import numpy as np

from cosim.analysis.preview import Preview
from cosim.analysis.signals import Array
from cosim.base.errors import CosimError
from cosim.engine.again import RepeatedEngine
from cosim.engine.engine import Engine
from cosim.engine.many import can_join, run_many
from cosim.engine.rewind import can_rewind
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
        return self._x[[self._place[name] for name in self.entries(prefix)]].T

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
    every_row = [_Rows(engine, columns, every) for engine in engines]
    going = dict(enumerate(every_row))
    found: dict[int, Memory | BaseException] = {}
    while going:
        failed = _run_chunk([rows.engine for rows in going.values()], going)
        for i, error in zip(list(going), failed, strict=True):
            if error is not None:
                found[i] = error
                del going[i]
            elif going[i].take():
                found[i] = going.pop(i).memory()
    return [found[i] for i in range(len(engines))]


def _run_chunk(engines: Sequence[Engine], going: Mapping[int, _Rows]) -> list[BaseException | None]:
    buffers = [rows.begin() for rows in going.values()]
    ticks = min(len(buffers[0]), engines[0].plan.ticks - engines[0].tick)
    if len(engines) > 1 or can_join(engines[0]):
        return run_many(engines, ticks, buffers)
    try:
        engines[0].run(ticks, buffers[0])
    except CosimError as error:
        return [error]
    if engines[0].tick < going[next(iter(going))].first + ticks and engines[0].ended is None:
        raise KeyboardInterrupt
    return [None]


class _Rows:
    """The rows of one run: `engine` writes those of a chunk to a buffer, from tick `first` on."""

    def __init__(self, engine: Engine, columns: Sequence[Column], every: int) -> None:
        self.engine, self._columns, self._every = engine, columns, every
        ticks = engine.plan.ticks
        self._ticks = np.arange(0, ticks + 1, every, dtype=np.int64)
        if self._ticks[-1] != ticks:
            self._ticks = np.append(self._ticks, ticks)
        self._index = np.array([column.index for column in columns], dtype=np.intp)
        self._x = np.empty((len(columns), len(self._ticks)))
        rows = max(64, min(_CHUNK_TICKS, _CHUNK_VALUES // max(1, len(columns))))
        self._buffer = np.empty((min(rows, ticks), len(columns)))
        self._filled = self.first = 0
        self._last: Array | None = None
        # without a row of every tick, there is none of the tick in which a component ends the run
        engine.state.every = every if can_rewind(engine.bound) else 1

    def begin(self) -> Array:
        """The buffer for the next chunk, (ticks, columns)."""
        self.first = self.engine.tick
        return self._buffer

    def take(self) -> bool:
        """Keep what is in the buffer; return whether that was the last of it."""
        engine, done = self.engine, self.engine.rows
        if done > engine.tick - self.first:  # it ended in a tick that is recorded already
            self._last = self._buffer[done - 1].copy()
        part = self._buffer[-self.first % self._every : done : self._every]
        self._x[:, self._filled : self._filled + len(part)] = part.T
        self._filled += len(part)
        return engine.tick >= engine.plan.ticks or engine.ended is not None

    def memory(self) -> Memory:
        """All of them, and the signals as they are at the end."""
        engine = self.engine
        ticks = np.append(self._ticks[self._ticks < engine.tick], engine.tick)
        x = self._x[:, : len(ticks)]
        x[:, -1] = engine.signals[self._index] if self._last is None else self._last
        return Memory(self._columns, (ticks * engine.plan.h).astype(np.float64), x)
