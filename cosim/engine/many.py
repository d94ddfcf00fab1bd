"""Engines that run together: their plans differ in numbers only (``many.h``).

Each has its own signals and fails or ends on its own, with the results of :meth:`Engine.run`. The
steps of all instances of an FMU are done at once, which is quicker where it steps several at a time
in vector lanes.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Mapping, Sequence
from math import gcd

import numpy as np

from cosim.base.errors import CosimError
from cosim.base.interrupts import stop_on_signal
from cosim.engine.binding import Vector
from cosim.engine.engine import Engine
from cosim.engine.rewind import can_rewind, structure
from cosim.native import structs
from cosim.native.structs import Code

#: Engines that run together at most (``MANY``).
MOST = 16


def together(engines: Mapping[int, Engine]) -> list[list[int]]:
    """Engines that :func:`can_join`, by number, in groups that can run together."""
    groups: dict[bytes, list[int]] = {}
    for number, engine in engines.items():
        groups.setdefault(structure(engine.bound), []).append(number)
    return [group[i : i + MOST] for group in groups.values() for i in range(0, len(group), MOST)]


def can_join(engine: Engine) -> bool:
    """Whether it can run together with others, and that may be quicker."""
    bound = engine.bound
    return engine.ended is None and can_rewind(bound) and any(u.steps for u in bound.units)


def run_many(
    engines: Sequence[Engine], ticks: int, records: Sequence[Vector], every: int
) -> list[BaseException | None]:
    """Run `ticks` ticks of engines at the same tick; their rows, of every `every`-th tick, become
    columns of `records`, (signals, rows) each.

    What :meth:`Engine.run` would raise, of each. Raises KeyboardInterrupt.
    """
    failed: list[BaseException | None] = [None] * len(engines)
    running = list(range(len(engines)))
    for engine, record in zip(engines, records, strict=True):
        engine.record_into(record)
        engine.state.every = every
    end = engines[0].tick + ticks
    numbers = stride(engines[0]), records[0].shape[1]

    def stop() -> None:
        for engine in engines:
            engine.stop()

    with stop_on_signal(stop):
        while running and engines[running[0]].tick < end:
            _advance(engines, running, end, numbers, failed)
    return failed


def _advance(
    engines: Sequence[Engine],
    running: list[int],
    end: int,
    numbers: tuple[int, int],
    failed: list[BaseException | None],
) -> None:
    """As far as the tables of all reach; who fails or ends is `running` no more.

    `numbers`: ticks at once, and how far columns of a record are apart.
    """
    n = end - engines[running[0]].tick
    for i in list(running):
        try:
            n = min(n, engines[i].prepare(n))
        except CosimError as error:
            failed[i] = error
            running.remove(i)
    pointers = (c.c_void_p * len(running))(*(c.addressof(engines[i].state) for i in running))
    results = (c.c_int32 * len(running))()
    structs.library().engine_run_many(pointers, len(running), n, *numbers, results)
    for i, result in zip(list(running), results, strict=True):
        if result != structs.EngineResult.OK:
            failed[i] = engines[i].finish(result)
            running.remove(i)


def stride(engine: Engine) -> int:
    """How many ticks ``engine_run_many`` can run as one; 1: each of them alone.

    Components that are stepped in each tick are stepped so often one after the other. So nothing
    else may come behind their steps in a tick, or read what they give before the next stride.
    """
    plan, units = engine.plan, engine.bound.units
    n = gcd(engine.state.every, *(op.period for op in plan.operations if op.period > 1))
    stepped = False
    given = np.zeros(plan.n_signals, dtype=bool)
    for unit in units:
        if unit.period == 1:
            given[unit.output : unit.output + unit.output_count] = True
    for op in plan.operations:
        if op.code == Code.STEP and op.period == 1 and units[op.index].steps:
            stepped = True
        elif stepped or op.first:
            return 1
        elif op.period == 1 and op.code != Code.RECORD:
            held = op.code in (Code.COPY, Code.SCALE)
            if not held or given[op.source : op.source + op.count].any():
                return 1
    return n
