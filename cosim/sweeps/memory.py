"""A run recorded in memory: some columns of the signal vector, and nothing on the disk."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np

from cosim.analysis.preview import Preview
from cosim.analysis.signals import Array
from cosim.engine.engine import Engine
from cosim.record import Column
from cosim.schedule.plan import Plan

#: Ticks in a chunk at the most, and signals a chunk may hold: it should stay in the cache.
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
    index = np.array([column.index for column in columns], dtype=np.intp)
    ticks = np.arange(0, plan.ticks + 1, every, dtype=np.int64)
    if ticks[-1] != plan.ticks:
        ticks = np.append(ticks, plan.ticks)
    x = np.empty((len(index), len(ticks)))
    rows = max(64, min(_CHUNK_TICKS, _CHUNK_VALUES // max(1, plan.n_signals)))
    buffer = np.empty((rows, plan.n_signals))
    filled = 0
    with Engine(plan) as engine:
        engine.initialize()
        last = engine.signals
        while engine.tick < plan.ticks and engine.ended is None:
            first, n = engine.tick, min(rows, plan.ticks - engine.tick)
            done = engine.run(n, buffer)
            if engine.tick < first + n and engine.ended is None:
                raise KeyboardInterrupt
            if done > engine.tick - first:  # it ended in a tick that is recorded already
                last = buffer[done - 1]
            part = buffer[-first % every : done : every]
            x[:, filled : filled + len(part)] = part[:, index].T
            filled += len(part)
        ticks = np.append(ticks[ticks < engine.tick], engine.tick)
        x = x[:, : len(ticks)]
        x[:, -1] = last[index]
    return Memory(columns, (ticks * plan.h).astype(np.float64), x)
