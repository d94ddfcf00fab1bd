"""Points of a study, run and measured: plain data goes in and comes out, whatever happens.

:func:`run_points` runs several together (:mod:`cosim.study.batch`); the rows are those of
:func:`run_point`, to the bit. Only `wall` is a share of the time of all.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite, isinf, nan
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.clock import stopwatch
from cosim.base.copies import replace
from cosim.base.errors import CosimError, RunError, ScenarioError
from cosim.base.names import unknown
from cosim.base.toml import changed, parts
from cosim.engine.simulate import columns, simulate
from cosim.fmi.failures import sentence
from cosim.loading.files import read_document
from cosim.measure import declared_metrics
from cosim.measure.declared_metrics import Preview
from cosim.measure.metrics import Metric, evaluate
from cosim.measure.requirements import Requirement, requirements
from cosim.record import Column, Run
from cosim.record.signals import Signals
from cosim.scenario.assemble import assemble
from cosim.scenario.reseeded import can_reseed, reseeded
from cosim.scenario.spec import Scenario, build
from cosim.schedule.plan import Plan
from cosim.study.axes import Cell, setting_path
from cosim.study.batch import Load, run_batch
from cosim.study.design import Point
from cosim.study.memory import Memory, record
from cosim.study.study import RESERVED, Study

#: How a setting of the seed begins, as axes write it.
SEED = "run.seed="


@dataclass(frozen=True, slots=True)
class StudySetup:
    """The common part of all runs of a study: the scenario as parsed, at its `path`.

    `stable`: the largest size of each measure; `keep`: where run folders stay, None: nowhere;
    `required`: names of requirements that a stable run passes.
    """

    path: Path
    document: Mapping[str, Any]
    stable: Mapping[str, float]
    keep: Path | None = None
    required: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class RunMeasures:
    """The measures of a scenario's run: its metrics, and the margins of its requirements.

    `end`: of the run, s.
    """

    metrics: Sequence[Metric]
    requirements: Sequence[Requirement]
    end: float

    @classmethod
    def of(cls, scenario: Scenario, plan: Plan) -> RunMeasures:
        """The measures that a scenario declares. Raises ScenarioError."""
        units = {c.name: c.unit for c in recorded_columns(scenario, plan)}
        return cls(declared_metrics.metrics(scenario), requirements(scenario, units), plan.end)

    @property
    def signals(self) -> set[str]:
        """Names of the signals that they read."""
        return {name for m in (*self.metrics, *self.requirements) for name in m.signals}


@dataclass(frozen=True, slots=True)
class StudyRow:
    """The result of a run. `reason`: why it has no measures, empty if it has.

    `stopped_at`: simulated time of a run that stopped, s, else NaN; `wall`: wall time of the run,
    s.
    """

    run: str
    cells: Mapping[str, Cell]
    settings: Sequence[str]
    stable: bool
    reason: str = ""
    stopped_at: float = nan
    wall: float = nan
    measures: Mapping[str, float] = field(default_factory=dict)


def job(study: Study, keep: Path | None) -> StudySetup:
    """The study's scenario, read once; the study's metrics and requirements are added to it,
    figures left out.

    Raises ScenarioError.
    """
    path = study.scenario
    document = read_document(path)
    added = {"metrics": ("metric", study.metrics), "require": ("requirement", study.require)}
    for key, (what, tables) in added.items():
        known = document.setdefault(key, {})
        for name, table in tables.items():
            if name in known:
                raise ScenarioError(f"{path} has a {what} {name!r} already", study.place(key, name))
            known[name] = table
    document["figures"] = {}
    return StudySetup(path, document, study.stable, keep, study.required)


def scenario_of(job: StudySetup, settings: Sequence[str]) -> Scenario:
    """The scenario with these settings. Raises ScenarioError."""
    return build(document_of(job, settings), job.path)


def document_of(job: StudySetup, settings: Sequence[str]) -> dict[str, Any]:
    """The scenario with these settings, as parsed. Raises ScenarioError."""
    return changed(job.document, settings)


def preview(job: StudySetup, point: Point) -> tuple[Plan, dict[str, str]]:
    """The plan of a point, and the unit of each measure by its name; nothing runs.

    Raises CosimError if it could not run, ScenarioError for a metric or a bound of `stable` that
    has no meaning.
    """
    scenario = scenario_of(job, point.settings)
    plan = assemble(scenario)
    units: dict[str, str] = {}
    known = Preview({c.name: c.unit for c in recorded_columns(scenario, plan)})
    for result in evaluate(declared_metrics.metrics(scenario), known):
        units |= {name: unit for name, (_, unit) in result.numbers.items()}
    measures = RunMeasures.of(scenario, plan)
    units |= {margin_of(r.name): r.unit for r in measures.requirements}
    for name in job.required:
        if name not in scenario.require:
            raise ScenarioError(f"stable: {unknown(name, scenario.require, 'requirement')}")
    for name in job.stable:
        if name not in units:
            raise ScenarioError(f"stable: no measure {name!r}; there are: {', '.join(units)}")
    for name in units:
        if name in RESERVED or name in point.cells:
            raise ScenarioError(f"the metric {name!r} has the name of another column")
    return plan, units


def run_point(job: StudySetup, point: Point) -> StudyRow:
    """Run one point; what goes wrong becomes the reason of its row."""
    watch = stopwatch()
    try:
        with np.errstate(all="ignore"):  # what diverges overflows; the row says so
            row = measured_row(job, point, *_recording(job, point))
    except Exception as error:
        row = failed_row(point, error)
    return replace(row, wall=watch())


def measured_row(job: StudySetup, point: Point, wanted: RunMeasures, signals: Signals) -> StudyRow:
    """The row of a run that reached its end. Raises ScenarioError."""
    results = evaluate(wanted.metrics, signals)
    measures = {name: value for r in results for name, (value, _) in r.numbers.items()}
    stable = _stable(job.stable, measures)
    for requirement in wanted.requirements:
        found = requirement.evaluate(signals, wanted.end, results)
        measures[margin_of(found.name)] = found.value
        stable &= found.verdict == "passed" or found.name not in job.required
    return StudyRow(point.run, point.cells, point.settings, stable, measures=measures)


def margin_of(requirement: str) -> str:
    """The name of the measure that is the margin of a requirement."""
    return f"{requirement}.margin"


def failed_row(point: Point, error: BaseException) -> StudyRow:
    """The row of a run that has no measures."""
    reason = str(error) if isinstance(error, CosimError) else sentence(error)
    stopped_at = error.time if isinstance(error, RunError) else nan
    return StudyRow(point.run, point.cells, point.settings, False, reason, stopped_at)


def _recording(job: StudySetup, point: Point) -> tuple[RunMeasures, Signals]:
    scenario = scenario_of(job, point.settings)
    plan = assemble(scenario)
    wanted = RunMeasures.of(scenario, plan)
    if job.keep is not None:
        folder = job.keep / point.run
        simulate(scenario, folder, plan=plan, force=True)
        return wanted, Run.open(folder)
    needed = needed_columns(wanted.signals, recorded_columns(scenario, plan))
    return wanted, record(plan, needed, scenario.run.record.every)


def _stable(bounds: Mapping[str, float], measures: Mapping[str, float]) -> bool:
    """True if every measure with a bound is a number no larger than it; without any: all finite."""
    if bounds:
        return all(abs(measures.get(name, nan)) <= bound for name, bound in bounds.items())
    return all(isfinite(v) or (isinf(v) and name.endswith("_s")) for name, v in measures.items())


def recorded_columns(scenario: Scenario, plan: Plan) -> list[Column]:
    """The columns that a run of the scenario records."""
    return columns(plan, scenario.run.record.signals, scenario.place("run.record.signals"))


def needed_columns(signals: Iterable[str], recorded: Sequence[Column]) -> list[Column]:
    """The columns of these signals. Raises ScenarioError for one that is not recorded."""
    names = Preview({c.name: c.unit for c in recorded})
    wanted = {entry for signal in signals for entry in names.entries(signal)}
    return [column for column in recorded if column.name in wanted]


# ---- points that run together -------------------------------------------------------------------


def run_points(setup: StudySetup, points: Sequence[Point]) -> list[StudyRow]:
    """Run points; the rows in this order. What goes wrong with one is the reason of its row."""
    if setup.keep is not None:
        return [run_point(setup, point) for point in points]
    return [replace(row, wall=wall) for row, wall in run_batch(_PointRuns(setup), points)]


@dataclass(frozen=True, slots=True)
class _PreparedPoint:
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
class _PointRuns:
    """The runs of a study, for :func:`cosim.study.batch.run_batch`."""

    setup: StudySetup

    def prepare(self, item: Point, last: _PreparedPoint | None, load: Load) -> _PreparedPoint:
        """The run of a point."""
        others, seed = _seed(item.settings)
        if last is not None and seed is not None and last.can_reseed and others == last.others:
            return replace(last, plan=reseeded(last.plan, seed))
        document = document_of(self.setup, item.settings)
        scenario = build(document, self.setup.path)
        plan = assemble(scenario, load)
        measures = RunMeasures.of(scenario, plan)
        columns = needed_columns(measures.signals, recorded_columns(scenario, plan))
        every = scenario.run.record.every
        latest = all(parts(setting_path(s)) not in (["run"], ["run", "seed"]) for s in others)
        again = latest and can_reseed(document, plan)
        return _PreparedPoint(others, plan, measures, columns, every, again)

    def measured(self, item: Point, prepared: _PreparedPoint, signals: Memory) -> StudyRow:
        """The row of a run."""
        try:
            return measured_row(self.setup, item, prepared.measures, signals)
        except Exception as error:
            return failed_row(item, error)

    def failed(self, item: Point, error: BaseException) -> StudyRow:
        """The row of a run that has no measures."""
        return failed_row(item, error)


def _seed(settings: Sequence[str]) -> tuple[Sequence[str], int | None]:
    """(the settings without those of the seed, the seed); None: it is not set to a plain number."""
    seeds = [s.removeprefix(SEED) for s in settings if s.startswith(SEED)]
    plain = bool(seeds) and all(seed.isdecimal() and len(seed) < 10 for seed in seeds)
    others = tuple(s for s in settings if not s.startswith(SEED))
    return others, int(seeds[-1]) if plain else None
