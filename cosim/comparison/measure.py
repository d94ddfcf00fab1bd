"""One case, run and measured: in a worker process, so what goes in and comes out is plain data."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from math import nan
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import FmuError, PlanError, RunError, ScenarioError
from cosim.comparison.aligned import AlignedError
from cosim.comparison.documents import Case
from cosim.comparison.requirement_margin import RequirementMargin
from cosim.comparison.same_links import RecordedTable, keep
from cosim.comparison.spec import Picture, PortMeasure, Stability
from cosim.comparison.variants import MetricColumn
from cosim.comparison.verdict import RunVerdict, judge
from cosim.engine.simulate import simulate
from cosim.measure.metrics import Metric, MetricResult
from cosim.record import Run
from cosim.record.digest import digest
from cosim.record.piecewise import RunRows
from cosim.reporting.thinning import thinned
from cosim.scenario.spec import Scenario

#: Points of a curve that come back from a worker.
POINTS = 400

_CANNOT = (ScenarioError, FmuError, PlanError, RunError)


@dataclass(frozen=True, slots=True)
class Task:
    """A case to run; `folder`: where its run folder is kept, None: it is not kept.

    `tables`: the folder of the tables that its links recorded.
    """

    case: Case
    scenario: Scenario
    columns: tuple[MetricColumn, ...]
    stability: Stability
    picture: Picture
    tables: Path
    folder: Path | None = None


@dataclass(frozen=True, slots=True)
class Curve:
    """A signal's entry for the figure: `t` (s) and `y`, (n,), thinned."""

    name: str
    t: NDArray[np.float32]
    y: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class CaseOutcome:
    """The outcome of a case: numbers by column, each (value, unit); NaN where there is none.

    `errors`: two standard deviations of those that were estimated, in their units; `remark`: why
    numbers of the port are missing; `digest`: of the run (:func:`cosim.live.digest`).
    """

    case: Case
    verdict: RunVerdict
    numbers: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    errors: Mapping[str, float] = field(default_factory=dict)
    tables: tuple[RecordedTable, ...] = ()
    curves: tuple[Curve, ...] = ()
    remark: str = ""
    digest: str = ""


def failed_case(case: Case, reason: str) -> CaseOutcome:
    """The outcome of a case that left nothing behind."""
    return CaseOutcome(case, RunVerdict("stopped", nan, reason=reason))


def run_case(task: Task) -> CaseOutcome:
    """Run and measure a case. A case that fails is an outcome with its reason, not an error.

    Errors that do not concern a single case, such as an engine of another version, are raised as
    CosimError.
    """
    with _folder(task.folder) as folder:
        failure = None
        try:
            simulate(task.scenario, Path(folder), force=True)
        except RunError as error:
            failure = error
        except _CANNOT as error:
            return failed_case(task.case, str(error))
        try:
            return _measured(task, Run.open(folder), failure)
        except _CANNOT as error:
            return failed_case(task.case, str(failure or error))


def _folder(folder: Path | None) -> AbstractContextManager[str | Path]:
    return tempfile.TemporaryDirectory(prefix="cosim-") if folder is None else nullcontext(folder)


def _measured(task: Task, run: Run, failure: RunError | None) -> CaseOutcome:
    verdict = judge(run, task.stability, failure)
    numbers, tables = {}, _tables(run, task.tables)
    if verdict.ended:
        numbers = {
            c.name: _number(_evaluated(c.metric, run, tables), c.part)
            for c in task.columns
            if not isinstance(c.metric, PortMeasure)
        }
    curves = _curves(run, task.picture)
    return CaseOutcome(
        task.case, verdict, numbers, tables=tables, curves=curves, digest=digest(run)
    )


def _evaluated(
    metric: Metric | AlignedError | RequirementMargin, run: Run, tables: Sequence[RecordedTable]
) -> MetricResult:
    if not isinstance(metric, AlignedError):
        return metric.evaluate(run)
    ages = [table.mean_age for table in tables if table.channel == metric.channel]
    return metric.evaluate(run, ages[0] if ages else nan)


def _number(result: MetricResult, part: str) -> tuple[float, str]:
    """The value of a metric, or the named part of it."""
    if not part:
        return result.value, result.unit
    return result.parts.get(part, nan), result.unit_of(part)


def _curves(run: Run, picture: Picture) -> tuple[Curve, ...]:
    names = [name for signal in picture.y for name in run.entries(signal)]
    found = []
    for name, kept in thinned(run, names, POINTS, picture.until).items():
        rows = RunRows(run, [name], kept.rows)
        with np.errstate(over="ignore"):
            found.append(Curve(name, rows.t.astype("f4"), rows.array(name)[:, 0].astype("f4")))
    return tuple(found)


def _tables(run: Run, folder: Path) -> tuple[RecordedTable, ...]:
    """The recorded tables: one for all links of a channel, where these agree, as they should."""
    found: list[RecordedTable] = []
    for path in run.link_tables.values():
        table = keep(path, folder)
        if not any(table.agrees(other) for other in found):
            found.append(table)
    return tuple(found)
