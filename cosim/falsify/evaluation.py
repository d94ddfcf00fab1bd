"""Candidates, run in lanes: what they have in common is made once and stays with the worker.

They stay in the places of a worker (:mod:`cosim.study.batch`), as points of a study do. From one
candidate to the next only the tables of links change, as long as the axes have the same values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosim.base.copies import replace
from cosim.base.errors import CosimError, RunError, ScenarioError
from cosim.base.toml import as_toml, changed
from cosim.falsify import judge
from cosim.falsify.bounds import MovingChannel
from cosim.falsify.judge import CandidateOutcome
from cosim.falsify.paths import Candidate, DelayPath
from cosim.fmi.failures import sentence
from cosim.links.table import DrawnTable
from cosim.measure.requirements import Requirement
from cosim.record import Column
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from cosim.schedule.plan import Plan
from cosim.study.axes import Axis, Drawn
from cosim.study.batch import Load, run_batch
from cosim.study.memory import Memory
from cosim.study.run_point import needed_columns, recorded_columns


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


def document_of(problem: Problem, settings: Sequence[str]) -> dict[str, Any]:
    """The scenario with these settings, as parsed. Raises ScenarioError."""
    return changed(problem.document, settings)


def with_paths(plan: Plan, problem: Problem, candidate: Candidate) -> Plan:
    """The plan over the network of a candidate."""
    links = list(plan.links)
    for channel, path in zip(problem.channels, problem.kept(candidate), strict=True):
        law = channel.law(path)
        for i in channel.places:
            old = links[i].table
            assert isinstance(old, DrawnTable)
            table = DrawnTable(old.name, old.grid, law, old.rule, old.seed)
            links[i] = replace(links[i], table=table)
    return replace(plan, links=tuple(links))


def run_candidates(problem: Problem, candidates: Sequence[Candidate]) -> list[CandidateOutcome]:
    """Run candidates; the outcomes in this order. Raises ScenarioError for values that cannot be.

    The paths of candidates are kept within their bounds first.
    """
    found = run_batch(_CandidateRuns(problem), candidates)
    return [replace(outcome, wall=wall) for outcome, wall in found]


@dataclass(frozen=True, slots=True)
class _PreparedCandidate:
    """A prepared run: `plan` is `base`, of the scenario with `settings`, over another network."""

    settings: tuple[str, ...]
    base: Plan
    plan: Plan
    requirements: tuple[Requirement, ...]
    columns: Sequence[Column]
    every: int


@dataclass(frozen=True, slots=True, eq=False)
class _CandidateRuns:
    """The runs of a search, for :func:`cosim.study.batch.run_batch`."""

    problem: Problem

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _CandidateRuns) and self.problem.name == other.problem.name

    def __hash__(self) -> int:
        return hash(self.problem.name)

    def prepare(
        self, item: Candidate, last: _PreparedCandidate | None, load: Load
    ) -> _PreparedCandidate:
        """The run of a candidate."""
        settings = self.problem.settings(item)
        if last is not None and last.settings == settings:
            return replace(last, plan=with_paths(last.base, self.problem, item))
        scenario = build(document_of(self.problem, settings), self.problem.path)
        base = assemble(scenario, load)
        recorded = recorded_columns(scenario, base)
        found = judge.requirements(scenario, self.problem.wanted, recorded)
        plan = with_paths(base, self.problem, item)
        columns = needed_columns([x for one in found for x in one.signals], recorded)
        every = scenario.run.record.every
        return _PreparedCandidate(settings, base, plan, found, columns, every)

    def measured(
        self, item: Candidate, prepared: _PreparedCandidate, signals: Memory
    ) -> CandidateOutcome:
        """The margins of a run."""
        try:
            margins = {one.name: judge.margin(one, signals) for one in prepared.requirements}
        except RunError as error:
            return self.failed(item, error)
        return CandidateOutcome(item.key, margins)

    def failed(self, item: Candidate, error: BaseException) -> CandidateOutcome:
        """The outcome of a run that came to no end. Raises ScenarioError for what cannot be."""
        if isinstance(error, ScenarioError):
            raise error
        reason = str(error) if isinstance(error, CosimError) else sentence(error)
        stopped_at = error.time if isinstance(error, RunError) else float("nan")
        return CandidateOutcome(item.key, {}, reason, stopped_at)
