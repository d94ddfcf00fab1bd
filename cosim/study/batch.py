"""Points of a study, several at a time: what they have in common is made once.

A worker keeps some places. Each has components and an engine of its own, which stay from one point
to the next as long as only numbers change (:mod:`cosim.engine.reuse`). Points whose engines can run
together (:mod:`cosim.engine.batch`) do so, one in each place. The rows are those of
:func:`cosim.study.run_point.run_point`, to the bit; only `wall` is a share of the time of all.
"""

from __future__ import annotations

import threading
import weakref
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cosim.base.clock import stopwatch
from cosim.base.toml import parts
from cosim.engine.batch import can_join, together
from cosim.engine.engine import Engine
from cosim.engine.reset import can_rewind
from cosim.engine.reuse import RepeatedEngine
from cosim.record import Column
from cosim.scenario.assemble import assemble
from cosim.scenario.kept import KeptComponents
from cosim.scenario.reseeded import can_reseed, reseeded
from cosim.scenario.spec import build
from cosim.schedule.plan import Plan
from cosim.study.axes import setting_path
from cosim.study.design import Point
from cosim.study.memory import Memory, Rooms, record_many
from cosim.study.run_point import (
    RunMeasures,
    StudyRow,
    StudySetup,
    document_of,
    failed_row,
    measured_row,
    needed_columns,
    recorded_columns,
    run_point,
)

#: Points that run together: with AVX-512, eight instances are a vector.
PLACES = 8
#: How a setting of the seed begins, as axes write it.
SEED = "run.seed="


@dataclass(frozen=True, slots=True)
class _Prepared:
    """A prepared run: `others` are the settings but for the seed, by which the next point may have
    the same plan with another seed (`can_reseed`).
    """

    others: Sequence[str]
    plan: Plan
    measures: RunMeasures
    columns: Sequence[Column]
    every: int
    can_reseed: bool


@dataclass(frozen=True, slots=True)
class _Begun:
    """A point whose engine is at tick 0."""

    point: Point
    prepared: _Prepared
    engine: Engine


class _RunPlace:
    """Components and an engine that stay."""

    def __init__(self, setup: StudySetup) -> None:
        self._setup, self._kept, self._repeated = setup, KeptComponents(), RepeatedEngine()
        self._last: _Prepared | None = None
        self._close = weakref.finalize(self, _close, self._repeated, self._kept)

    def begin(self, point: Point) -> _Begun:
        """Raises CosimError, or whatever a component raises."""
        last, self._last = self._last, None
        others, seed = _seed(point.settings)
        if last is not None and seed is not None and last.can_reseed and others == last.others:
            prepared = replace(last, plan=reseeded(last.plan, seed))
        else:
            prepared = self._prepare(point.settings, others)
        columns = [column.index for column in prepared.columns]
        engine = self._repeated.begin(prepared.plan, columns)
        self._last = prepared
        return _Begun(point, prepared, engine)

    def _prepare(self, settings: Sequence[str], others: Sequence[str]) -> _Prepared:
        document = document_of(self._setup, settings)
        scenario = build(document, self._setup.path)
        plan = assemble(scenario, self._kept.load)
        measures = RunMeasures.of(scenario, plan)
        columns = needed_columns(measures, recorded_columns(scenario, plan))
        every = scenario.run.record.every
        last = all(parts(setting_path(s)) not in (["run"], ["run", "seed"]) for s in others)
        again = last and can_reseed(document, plan)
        return _Prepared(others, plan, measures, columns, every, again)

    def free(self) -> None:
        """Free the FMUs. The processes of isolated ones wait for the next point."""
        self._repeated.close()

    def close(self) -> None:
        """Free the FMUs and end their processes, as otherwise happens when the thread ends."""
        self._close()


def _close(repeated: RepeatedEngine, kept: KeptComponents) -> None:
    repeated.close()
    kept.close()


def _seed(settings: Sequence[str]) -> tuple[Sequence[str], int | None]:
    """(the settings without those of the seed, the seed); None: it is not set to a plain number."""
    seeds = [s.removeprefix(SEED) for s in settings if s.startswith(SEED)]
    plain = bool(seeds) and all(seed.isdecimal() and len(seed) < 10 for seed in seeds)
    others = tuple(s for s in settings if not s.startswith(SEED))
    return others, int(seeds[-1]) if plain else None


class _RunPlaces(threading.local):
    """The places of this thread, for the last study; `rooms`: what was recorded last."""

    def __init__(self) -> None:
        self.rooms = Rooms()
        self._setup: StudySetup | None = None
        self._places: list[_RunPlace] = []

    def of(self, setup: StudySetup) -> list[_RunPlace]:
        """The places of the runs of a study, made anew for another one."""
        if self._setup != setup:
            for place in self._places:
                place.close()
            self._setup, self._places = setup, [_RunPlace(setup) for _ in range(PLACES)]
        return self._places


_places = _RunPlaces()


def run_points(setup: StudySetup, points: Sequence[Point]) -> list[StudyRow]:
    """Run points; the rows in this order. What goes wrong with one is the reason of its row."""
    if setup.keep is not None:
        return [run_point(setup, point) for point in points]
    places = _places.of(setup)
    rows: dict[str, StudyRow] = {}
    with np.errstate(all="ignore"):  # values that diverge overflow; the row reports it
        for first in range(0, len(points), PLACES):
            for row in _run(setup, places, points[first : first + PLACES]):
                rows[row.run] = row
    return [rows[point.run] for point in points]


def _run(setup: StudySetup, places: Sequence[_RunPlace], points: Sequence[Point]) -> list[StudyRow]:
    """At most as many points as there are places. Those that can join take one each."""
    watch = stopwatch()
    rows: list[StudyRow] = []
    waiting: list[_Begun] = []
    for point in points:
        place = places[len(waiting)]
        try:
            begun = place.begin(point)
        except Exception as error:
            rows.append(failed_row(point, error))
            continue
        if can_join(begun.engine):
            waiting.append(begun)
            continue
        rows += _measured(setup, [begun])
        if not can_rewind(begun.engine.bound):
            place.free()  # not two of them at a time
    for every in {begun.prepared.every for begun in waiting}:
        same = {i: x.engine for i, x in enumerate(waiting) if x.prepared.every == every}
        for group in together(same):
            rows += _measured(setup, [waiting[i] for i in group])
    share = watch() / len(points)
    return [replace(row, wall=share) for row in rows]


def _measured(setup: StudySetup, group: Sequence[_Begun]) -> list[StudyRow]:
    """The rows of engines that run together, or of one."""
    first, engines = group[0].prepared, [begun.engine for begun in group]
    try:
        recorded = record_many(engines, first.columns, first.every, _places.rooms)
    except Exception as error:
        return [failed_row(begun.point, error) for begun in group]
    return [_row(setup, begun, found) for begun, found in zip(group, recorded, strict=True)]


def _row(setup: StudySetup, begun: _Begun, found: Memory | BaseException) -> StudyRow:
    if isinstance(found, BaseException):
        return failed_row(begun.point, found)
    try:
        return measured_row(setup, begun.point, begun.prepared.measures, found)
    except Exception as error:
        return failed_row(begun.point, error)
