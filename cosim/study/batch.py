"""Runs of one scenario, several at a time: what they have in common is made once.

A worker keeps some places. Each has components and an engine of its own, which stay from one run
to the next as long as only numbers change (:mod:`cosim.engine.reuse`). Runs whose engines can join
(:mod:`cosim.engine.batch`) are made together, one in each place; the results are those of runs
alone, to the bit. Points of a study (:mod:`cosim.study.run_point`) and candidates of a search
(:mod:`cosim.falsify.evaluation`) say how they are prepared and measured.
"""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from cosim.base.clock import stopwatch
from cosim.engine.batch import can_join, together
from cosim.engine.engine import Engine
from cosim.engine.reset import can_rewind
from cosim.engine.reuse import RepeatedEngine
from cosim.record import Column
from cosim.scenario.kept import KeptComponents
from cosim.scenario.models import LoadedComponent
from cosim.schedule.plan import Plan
from cosim.study.memory import Memory, Rooms, record_many

#: Runs that are made together: with AVX-512, eight instances are a vector.
PLACES = 8

#: Loads a component, as :func:`cosim.scenario.models.load_component` does.
Load = Callable[..., LoadedComponent]


class PreparedRun(Protocol):
    """A plan, and what is recorded: `columns` in every `every`-th tick."""

    @property
    def plan(self) -> Plan:
        """The plan of the run."""

    @property
    def columns(self) -> Sequence[Column]:
        """The recorded columns."""

    @property
    def every(self) -> int:
        """The ticks from one recorded row to the next."""


ItemT = TypeVar("ItemT")
ResultT = TypeVar("ResultT")
PreparedT = TypeVar("PreparedT", bound=PreparedRun)
_TakenT = TypeVar("_TakenT", contravariant=True)
_GivenT = TypeVar("_GivenT", covariant=True)


class Runs(Protocol[_TakenT, PreparedT, _GivenT]):
    """The runs of one scenario; equal if places made for one serve the other."""

    def prepare(self, item: _TakenT, last: PreparedT | None, load: Load) -> PreparedT:
        """The run of an item, after the `last` one in its place, which it may have in part.

        Raises CosimError, or whatever a component raises.
        """

    def measured(self, item: _TakenT, prepared: PreparedT, signals: Memory) -> _GivenT:
        """The result of a run that reached its end; `signals` are overwritten by the next one."""

    def failed(self, item: _TakenT, error: BaseException) -> _GivenT:
        """The result of a run that did not, or the error again."""


@dataclass(frozen=True, slots=True)
class _Begun(Generic[ItemT, PreparedT]):
    """The item of number `i`, whose engine is at tick 0."""

    i: int
    item: ItemT
    prepared: PreparedT
    engine: Engine


class _RunPlace(Generic[ItemT, PreparedT]):
    """Components and an engine that stay."""

    def __init__(self, runs: Runs[ItemT, PreparedT, Any]) -> None:
        self._runs, self._kept, self._repeated = runs, KeptComponents(), RepeatedEngine()
        self._last: PreparedT | None = None
        self._close = weakref.finalize(self, _close, self._repeated, self._kept)

    def begin(self, i: int, item: ItemT) -> _Begun[ItemT, PreparedT]:
        """Raises CosimError, or whatever a component raises."""
        last, self._last = self._last, None
        prepared = self._runs.prepare(item, last, self._kept.load)
        columns = [column.index for column in prepared.columns]
        engine = self._repeated.begin(prepared.plan, columns)
        self._last = prepared
        return _Begun(i, item, prepared, engine)

    def free(self) -> None:
        """Free the FMUs. The processes of isolated ones wait for the next run."""
        self._repeated.close()

    def close(self) -> None:
        """Free the FMUs and end their processes, as otherwise happens when the thread ends."""
        self._close()


def _close(repeated: RepeatedEngine, kept: KeptComponents) -> None:
    repeated.close()
    kept.close()


class _RunPlaces(threading.local):
    """The places of this thread, for the last runs; `rooms`: what was recorded last."""

    def __init__(self) -> None:
        self.rooms = Rooms()
        self._runs: object = None
        self._places: list[_RunPlace[Any, Any]] = []

    def of(self, runs: Runs[Any, Any, Any]) -> list[_RunPlace[Any, Any]]:
        """The places for these runs, made anew for others."""
        if self._runs != runs:
            self.close()
            self._runs, self._places = runs, [_RunPlace(runs) for _ in range(PLACES)]
        return self._places

    def close(self) -> None:
        """Free everything."""
        for place in self._places:
            place.close()
        self._runs, self._places = None, []


_places = _RunPlaces()


def run_batch(
    runs: Runs[ItemT, PreparedT, ResultT], items: Sequence[ItemT]
) -> list[tuple[ResultT, float]]:
    """Run items; the results in this order, each with a share of the wall time, s.

    Raises what `runs` raises instead of a result.
    """
    places = _places.of(runs)
    found: list[tuple[ResultT, float]] = []
    with np.errstate(all="ignore"):  # values that diverge overflow; the result reports it
        for first in range(0, len(items), PLACES):
            some = items[first : first + PLACES]
            watch = stopwatch()
            results = _run(runs, places, some)
            share = watch() / len(some)
            found += [(results[i], share) for i in range(len(some))]
    return found


def _run(
    runs: Runs[ItemT, PreparedT, ResultT],
    places: Sequence[_RunPlace[ItemT, PreparedT]],
    items: Sequence[ItemT],
) -> dict[int, ResultT]:
    """At most as many items as there are places. Those that can join take one each."""
    results: dict[int, ResultT] = {}
    waiting: list[_Begun[ItemT, PreparedT]] = []
    for i, item in enumerate(items):
        place = places[len(waiting)]
        try:
            begun = place.begin(i, item)
        except Exception as error:
            results[i] = runs.failed(item, error)
            continue
        if can_join(begun.engine):
            waiting.append(begun)
            continue
        results |= _measured(runs, [begun])
        if not can_rewind(begun.engine.bound):
            place.free()  # not two of them at a time
    for every in {begun.prepared.every for begun in waiting}:
        same = {i: x.engine for i, x in enumerate(waiting) if x.prepared.every == every}
        for group in together(same):
            results |= _measured(runs, [waiting[i] for i in group])
    return results


def _measured(
    runs: Runs[ItemT, PreparedT, ResultT], group: Sequence[_Begun[ItemT, PreparedT]]
) -> dict[int, ResultT]:
    """The results of engines that run together, or of one."""
    first, engines = group[0].prepared, [begun.engine for begun in group]
    recorded: Sequence[Memory | BaseException]
    try:
        recorded = record_many(engines, first.columns, first.every, _places.rooms)
    except Exception as error:
        recorded = [error] * len(group)
    results: dict[int, ResultT] = {}
    for begun, signals in zip(group, recorded, strict=True):
        if isinstance(signals, BaseException):
            results[begun.i] = runs.failed(begun.item, signals)
        else:
            results[begun.i] = runs.measured(begun.item, begun.prepared, signals)
    return results
