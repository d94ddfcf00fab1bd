"""One point of a study, run and measured: plain data goes in and comes out, whatever happens."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from math import isfinite, isinf, nan
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.clock import stopwatch
from cosim.base.errors import CosimError, RunError, ScenarioError
from cosim.base.toml import change
from cosim.engine.simulate import columns, simulate
from cosim.fmi.failures import sentence
from cosim.loading.files import read_document
from cosim.measure import declared_metrics
from cosim.measure.declared_metrics import Preview
from cosim.measure.metrics import Metric, evaluate
from cosim.record import Column, Run
from cosim.record.signals import Signals
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario, build
from cosim.schedule.plan import Plan
from cosim.study.axes import Cell
from cosim.study.design import Point
from cosim.study.memory import record
from cosim.study.study import RESERVED, Study


@dataclass(frozen=True, slots=True)
class StudySetup:
    """The common part of all runs of a study: the scenario as parsed, at its `path`.

    `stable`: the largest size of each measure; `keep`: where run folders stay, None: nowhere.
    """

    path: Path
    document: Mapping[str, Any]
    stable: Mapping[str, float]
    keep: Path | None = None


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
    """The study's scenario, read once; the study's metrics are added to it, figures left out.

    Raises ScenarioError.
    """
    path = study.scenario
    document = read_document(path)
    metrics = document.setdefault("metrics", {})
    for name, table in study.metrics.items():
        if name in metrics:
            raise ScenarioError(
                f"{path} has a metric {name!r} already", study.place("metrics", name)
            )
        metrics[name] = table
    document["figures"] = {}
    return StudySetup(path, document, study.stable, keep)


def scenario_of(job: StudySetup, settings: Sequence[str]) -> Scenario:
    """The scenario with these settings. Raises ScenarioError."""
    return build(document_of(job, settings), job.path)


def document_of(job: StudySetup, settings: Sequence[str]) -> dict[str, Any]:
    """The scenario with these settings, as parsed. Raises ScenarioError."""
    document = deepcopy(dict(job.document))
    for setting in settings:
        change(document, setting)
    return document


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


def measured_row(
    job: StudySetup, point: Point, metrics: Sequence[Metric], signals: Signals
) -> StudyRow:
    """The row of a run that reached its end. Raises ScenarioError."""
    results = evaluate(metrics, signals)
    measures = {name: value for r in results for name, (value, _) in r.numbers.items()}
    stable = _stable(job.stable, measures)
    return StudyRow(point.run, point.cells, point.settings, stable, measures=measures)


def failed_row(point: Point, error: BaseException) -> StudyRow:
    """The row of a run that has no measures."""
    reason = str(error) if isinstance(error, CosimError) else sentence(error)
    stopped_at = error.time if isinstance(error, RunError) else nan
    return StudyRow(point.run, point.cells, point.settings, False, reason, stopped_at)


def _recording(job: StudySetup, point: Point) -> tuple[Sequence[Metric], Signals]:
    scenario = scenario_of(job, point.settings)
    plan = assemble(scenario)
    metrics = declared_metrics.metrics(scenario)
    if job.keep is not None:
        folder = job.keep / point.run
        simulate(scenario, folder, plan=plan, force=True)
        return metrics, Run.open(folder)
    needed = needed_columns(metrics, recorded_columns(scenario, plan))
    return metrics, record(plan, needed, scenario.run.record.every)


def _stable(bounds: Mapping[str, float], measures: Mapping[str, float]) -> bool:
    """True if every measure with a bound is a number no larger than it; without any: all finite."""
    if bounds:
        return all(abs(measures.get(name, nan)) <= bound for name, bound in bounds.items())
    return all(isfinite(v) or (isinf(v) and name.endswith("_s")) for name, v in measures.items())


def recorded_columns(scenario: Scenario, plan: Plan) -> list[Column]:
    """The columns that a run of the scenario records."""
    return columns(plan, scenario.run.record.signals, scenario.place("run.record.signals"))


def needed_columns(metrics: Sequence[Metric], recorded: Sequence[Column]) -> list[Column]:
    """The columns that the metrics read."""
    names = Preview({c.name: c.unit for c in recorded})
    wanted = {entry for m in metrics for signal in m.signals for entry in names.entries(signal)}
    return [column for column in recorded if column.name in wanted]
