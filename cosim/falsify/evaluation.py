"""Candidates, run in lanes: what they have in common is made once and stays with the worker.

A worker keeps some places, each with components and an engine of its own (as
:mod:`cosim.study.batch` does for points of a study). From one candidate to the next only the tables
of links change, as long as the axes have the same values.
"""

from __future__ import annotations

import threading
import weakref
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.clock import stopwatch
from cosim.base.convert import replace as replace_struct
from cosim.base.errors import CosimError, RunError, ScenarioError
from cosim.base.toml import as_toml, change
from cosim.engine.batch import can_join, together
from cosim.engine.engine import Engine
from cosim.engine.reset import can_rewind
from cosim.engine.reuse import RepeatedEngine
from cosim.falsify import judge
from cosim.falsify.bounds import MovingChannel
from cosim.falsify.judge import CandidateOutcome
from cosim.falsify.paths import Candidate, DelayPath
from cosim.fmi.failures import sentence
from cosim.links.table import DrawnTable
from cosim.measure.declared_metrics import Preview
from cosim.measure.requirements import Requirement
from cosim.record import Column
from cosim.scenario.assemble import assemble
from cosim.scenario.kept import KeptComponents
from cosim.scenario.spec import build
from cosim.schedule.plan import Plan
from cosim.study.axes import Axis, Drawn
from cosim.study.memory import Memory, Rooms, record_many
from cosim.study.run_point import recorded_columns

#: Candidates that run together: with AVX-512, eight instances are a vector.
PLACES = 8


@dataclass(frozen=True, slots=True)
class Problem:
    """The common part of all candidates: the scenario as parsed, at its `path`, and what may move.

    `ticks`: length of the scenario's own run; `h`: its base step, s; `wanted`: names of the
    requirements. `name`: a hash of all this. `links`: names of the plan's links; `signals`: what
    the requirements read.
    """

    path: Path
    document: Mapping[str, Any]
    channels: tuple[MovingChannel, ...]
    axes: tuple[Axis, ...]
    wanted: tuple[str, ...]
    ticks: int
    h: float
    name: str
    links: tuple[str, ...]
    signals: tuple[str, ...]

    @property
    def nominal(self) -> Candidate:
        """The nominal delay on all channels, and the scenario's own values."""
        paths = tuple(channel.base for channel in self.channels)
        return Candidate(paths, (None,) * len(self.axes), self.ticks, "the nominal delays")

    def kept(self, candidate: Candidate) -> tuple[DelayPath, ...]:
        """The paths of a candidate within their bounds."""
        pairs = zip(self.channels, candidate.paths, strict=True)
        return tuple(channel.kept(path, candidate.ticks) for channel, path in pairs)

    def settings(self, candidate: Candidate) -> tuple[str, ...]:
        """The settings of the scenario for the axes and the length of a candidate."""
        found = [s for a, u in zip(self.axes, candidate.axes, strict=True) for s in _set(a, u)]
        if candidate.ticks != self.ticks:
            start = _start(self.document)
            found.append(f"run.stop={as_toml(round(start + candidate.ticks * self.h, 12))}")
        return tuple(found)


def _set(axis: Axis, u: float | None) -> tuple[str, ...]:
    if u is None:
        return ()
    if isinstance(axis, Drawn):
        return axis.choice(u).settings
    return axis.choices[min(len(axis.choices) - 1, int(u * len(axis.choices)))].settings


def _start(document: Mapping[str, Any]) -> float:
    from cosim.base.convert import number

    return number(document["run"].get("start", 0.0), "s", "run.start")


@dataclass(frozen=True, slots=True)
class _PreparedPlan:
    settings: tuple[str, ...]
    plan: Plan
    requirements: tuple[Requirement, ...]
    columns: Sequence[Column]
    every: int


@dataclass(frozen=True, slots=True)
class _BegunCandidate:
    candidate: Candidate
    prepared: _PreparedPlan
    engine: Engine


class _CandidatePlace:
    """Components and an engine that stay."""

    def __init__(self, problem: Problem) -> None:
        self._problem, self._kept = problem, KeptComponents()
        self._repeated = RepeatedEngine()
        self._prepared: _PreparedPlan | None = None
        self._close = weakref.finalize(self, _close, self._repeated, self._kept)

    def begin(self, candidate: Candidate) -> _BegunCandidate:
        """Raises CosimError, or whatever a component raises."""
        settings = self._problem.settings(candidate)
        prepared, self._prepared = self._prepared, None
        if prepared is None or prepared.settings != settings:
            prepared = self._prepare(settings)
        plan = with_paths(prepared.plan, self._problem, candidate)
        engine = self._repeated.begin(plan, [column.index for column in prepared.columns])
        self._prepared = prepared
        return _BegunCandidate(candidate, prepared, engine)

    def _prepare(self, settings: tuple[str, ...]) -> _PreparedPlan:
        scenario = build(document_of(self._problem, settings), self._problem.path)
        plan = assemble(scenario, self._kept.load)
        recorded = recorded_columns(scenario, plan)
        found = judge.requirements(scenario, self._problem.wanted, recorded)
        columns = needed(found, recorded)
        return _PreparedPlan(settings, plan, found, columns, scenario.run.record.every)

    def free(self) -> None:
        """Free the FMUs."""
        self._repeated.close()

    def close(self) -> None:
        """Free the FMUs and end their processes."""
        self._close()


def _close(repeated: RepeatedEngine, kept: KeptComponents) -> None:
    repeated.close()
    kept.close()


class _CandidatePlaces(threading.local):
    """The places of this thread, for the last problem."""

    def __init__(self) -> None:
        self.rooms, self._name = Rooms(), ""
        self._places: list[_CandidatePlace] = []

    def of(self, problem: Problem) -> list[_CandidatePlace]:
        """The places for a problem, made anew for another one."""
        if self._name != problem.name:
            for place in self._places:
                place.close()
            self._name, self._places = (
                problem.name,
                [_CandidatePlace(problem) for _ in range(PLACES)],
            )
        return self._places


_places = _CandidatePlaces()


def document_of(problem: Problem, settings: Sequence[str]) -> dict[str, Any]:
    """The scenario with these settings, as parsed. Raises ScenarioError."""
    document = deepcopy(dict(problem.document))
    for setting in settings:
        change(document, setting)
    return document


def with_paths(plan: Plan, problem: Problem, candidate: Candidate) -> Plan:
    """The plan over the network of a candidate."""
    links = list(plan.links)
    for channel, path in zip(problem.channels, problem.kept(candidate), strict=True):
        law = channel.law(path)
        for i in channel.places:
            old = links[i].table
            assert isinstance(old, DrawnTable)
            table = DrawnTable(old.name, old.grid, law, old.rule, old.seed)
            links[i] = replace_struct(links[i], table=table)
    return replace(plan, links=tuple(links))


def needed(found: Sequence[Requirement], recorded: Sequence[Column]) -> list[Column]:
    """The columns that the requirements read. Raises ScenarioError for one that is not recorded."""
    names = Preview({c.name: c.unit for c in recorded})
    wanted = {e for one in found for signal in one.signals for e in names.entries(signal)}
    return [column for column in recorded if column.name in wanted]


def run_candidates(problem: Problem, candidates: Sequence[Candidate]) -> list[CandidateOutcome]:
    """Run candidates; the outcomes in this order. Raises ScenarioError for values that cannot be.

    The paths of candidates are kept within their bounds first.
    """
    places = _places.of(problem)
    found: dict[str, CandidateOutcome] = {}
    with np.errstate(all="ignore"):  # values that diverge overflow; the outcome reports it
        for first in range(0, len(candidates), PLACES):
            for outcome in _run(places, candidates[first : first + PLACES]):
                found[outcome.key] = outcome
    return [found[candidate.key] for candidate in candidates]


def _run(
    places: Sequence[_CandidatePlace], candidates: Sequence[Candidate]
) -> list[CandidateOutcome]:
    """At most as many candidates as there are places. Those that can join take one each."""
    watch = stopwatch()
    outcomes: list[CandidateOutcome] = []
    waiting: list[_BegunCandidate] = []
    for candidate in candidates:
        place = places[len(waiting)]
        try:
            begun = place.begin(candidate)
        except ScenarioError:
            raise
        except Exception as error:
            outcomes.append(_failed(candidate, error))
            continue
        if can_join(begun.engine):
            waiting.append(begun)
            continue
        outcomes += _judged([begun])
        if not can_rewind(begun.engine.bound):
            place.free()
    groups = together({i: x.engine for i, x in enumerate(waiting)})
    for group in groups:
        outcomes += _judged([waiting[i] for i in group])
    share = watch() / len(candidates)
    return [replace(outcome, wall=share) for outcome in outcomes]


def _judged(group: Sequence[_BegunCandidate]) -> list[CandidateOutcome]:
    first, engines = group[0].prepared, [begun.engine for begun in group]
    try:
        recorded = record_many(engines, first.columns, first.every, _places.rooms)
    except Exception as error:
        return [_failed(begun.candidate, error) for begun in group]
    return [_outcome(begun, found) for begun, found in zip(group, recorded, strict=True)]


def _outcome(begun: _BegunCandidate, found: Memory | BaseException) -> CandidateOutcome:
    if isinstance(found, BaseException):
        return _failed(begun.candidate, found)
    try:
        wanted = begun.prepared.requirements
        margins = {one.name: judge.margin(one, found) for one in wanted}
    except RunError as error:
        return _failed(begun.candidate, error)
    return CandidateOutcome(begun.candidate.key, margins)


def _failed(candidate: Candidate, error: BaseException) -> CandidateOutcome:
    """The outcome of a run that came to no end."""
    reason = str(error) if isinstance(error, CosimError) else sentence(error)
    stopped_at = error.time if isinstance(error, RunError) else float("nan")
    return CandidateOutcome(candidate.key, {}, reason, stopped_at)
