"""Engines that run together: their plans differ in numbers only (``batch.c``).

Each has its own signals and fails or ends on its own, with the results of :meth:`Engine.run`. The
steps of all instances of an FMU are done at once, which is quicker where it steps several at a time
in vector lanes.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Mapping, Sequence

from cosim.base.errors import CosimError
from cosim.base.interrupts import stop_on_signal
from cosim.engine.binding import Vector
from cosim.engine.bulk_steps import stride
from cosim.engine.engine import Engine
from cosim.engine.reset import can_rewind, structure
from cosim.native import enums, shared

#: Engines that run together at most (``MANY``).
MOST = 16


def together(engines: Mapping[int, Engine]) -> list[list[int]]:
    """Engines that :func:`can_join`, by number, in groups that can run together."""
    groups: dict[bytes, list[int]] = {}
    for number, engine in engines.items():
        groups.setdefault(structure(engine.bound), []).append(number)
    return [group[i : i + MOST] for group in groups.values() for i in range(0, len(group), MOST)]


def can_join(engine: Engine) -> bool:
    """True if it can run together with others, and that may be quicker."""
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
    numbers = stride(engines[0].bound), records[0].shape[1]

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
    """Advance as far as the tables of all reach; who fails or ends is `running` no more.

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
    shared.library().engine_run_many(pointers, len(running), n, *numbers, results)
    for i, result in zip(list(running), results, strict=True):
        if result != enums.EngineResult.OK:
            failed[i] = engines[i].finish(result)
            running.remove(i)
