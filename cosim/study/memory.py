"""A run recorded in memory: some columns of the signal vector, and nothing on the disk."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np

from cosim.base.errors import CosimError
from cosim.engine.batch import can_join, run_many
from cosim.engine.engine import Engine
from cosim.engine.reuse import RepeatedEngine
from cosim.measure.declared_metrics import Preview
from cosim.record import Column
from cosim.record.signals import Array
from cosim.schedule.plan import Plan

#: Ticks in a chunk at the most, and values a chunk may hold: it should stay in the cache.
_CHUNK_TICKS, _CHUNK_VALUES = 8192, 1 << 18


@final
class Memory:
    """Recorded signals, as metrics read them (:class:`cosim.record.signals.Signals`).

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


class Rooms:
    """Arrays of the last runs, in which the next ones of the same size are recorded."""

    def __init__(self) -> None:
        self._arrays: dict[int, Array] = {}

    def array(self, number: int, shape: tuple[int, int]) -> Array:
        """The array of run `number` of those together, `shape`: (signals, recorded ticks)."""
        found = self._arrays.get(number)
        if found is None or found.shape != shape:
            found = self._arrays[number] = np.empty(shape)
        return found


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
    engines: Sequence[Engine], columns: Sequence[Column], every: int = 1, rooms: Rooms | None = None
) -> list[Memory | BaseException]:
    """The same of engines at tick 0 that record `columns`, and of what they raise.

    More than one can run together (:func:`cosim.engine.batch.together`). With `rooms`, the
    results of the last call are overwritten: use them before the next one.
    """
    plan = engines[0].plan
    ticks = np.append(np.arange(0, plan.ticks, every, dtype=np.int64), plan.ticks)
    rooms = rooms or Rooms()
    recorded = [rooms.array(i, (len(columns), len(ticks))) for i in range(len(engines))]
    found: Sequence[Array | BaseException | None]
    if can_join(engines[0]):
        found = run_many(engines, plan.ticks, recorded, every)
    else:
        found = [_run_alone(engines[0], every, recorded[0])]
    t = (plan.start + ticks * plan.h).astype(np.float64)
    index = [column.index for column in columns]
    memories: list[Memory | BaseException] = []
    for engine, x, last in zip(engines, recorded, found, strict=True):
        if isinstance(last, BaseException):
            memories.append(last)
            continue
        rows = int(np.searchsorted(ticks, engine.tick))
        x[:, rows] = engine.signals[index] if last is None else last
        ends = t if rows == len(t) - 1 else np.append(t[:rows], plan.time(engine.tick))
        memories.append(Memory(columns, ends, x[:, : rows + 1]))
    return memories


def _run_alone(engine: Engine, every: int, x: Array) -> Array | CosimError | None:
    """Record an engine that gives a row for each tick, in `x` (columns, n).

    Returns the last row, if a component ended the run in a tick whose row was recorded already.
    """
    rows = max(64, min(_CHUNK_TICKS, _CHUNK_VALUES // max(1, len(x))))
    buffer = np.empty((min(rows, engine.plan.ticks), len(x)))
    filled, last = 0, None
    while engine.tick < engine.plan.ticks and engine.ended is None:
        first = engine.tick
        ticks = min(len(buffer), engine.plan.ticks - first)
        try:
            done = engine.run(ticks, buffer)
        except CosimError as error:
            return error
        if engine.tick < first + ticks and engine.ended is None:
            raise KeyboardInterrupt
        if done > engine.tick - first:
            last = buffer[done - 1].copy()
        part = buffer[-first % every : done : every]
        x[:, filled : filled + len(part)] = part.T
        filled += len(part)
    return last
