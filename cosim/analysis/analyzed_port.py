"""The subject of an analysis: a scenario, which is run for it, or a recorded run."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.copies import replace
from cosim.base.errors import CosimError, ScenarioError
from cosim.base.names import listed, signal_of
from cosim.engine.memory_run import SignalTrace, trace
from cosim.loading.files import load
from cosim.predict.inputs import RunWithInputs
from cosim.predict.port import PortSignals, port_of
from cosim.predict.system import AnalyzedSystem, system
from cosim.record import Run
from cosim.record.signals import Signals
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import AnalysisSpec, Scenario, build
from cosim.schedule.plan import Plan

#: Rows of a run in memory at the most, and values; more are recorded more coarsely.
ROWS, VALUES = 400_000, 1 << 26


@dataclass(frozen=True, slots=True)
class Subject:
    """Signals of a run, the port, and the system it was made of, None where that is not known.

    `remarks`: what is missing, and why.
    """

    title: str
    signals: Signals
    port: PortSignals
    system: AnalyzedSystem | None = None
    remarks: tuple[str, ...] = ()


def of_scenario(path: str | Path, settings: Sequence[str] = (), chosen: str = "") -> Subject:
    """A scenario, run in memory with the port's signals recorded; `chosen`: the port's component.

    A run that stops early is analysed up to there. Raises CosimError.
    """
    path = Path(path)
    scenario = load(path, settings)
    plan = assemble(scenario)
    known, port = find_port(scenario, plan, chosen)
    run = record(scenario, plan, port)
    remarks = (f"the run stopped: {run.stopped}",) if run.stopped else ()
    return Subject(scenario.title, run, port, known, remarks)


def find_port(
    scenario: Scenario, plan: Plan, chosen: str = ""
) -> tuple[AnalyzedSystem, PortSignals]:
    """The system of a plan and its port. Raises ScenarioError."""
    known = system(scenario, plan)
    place = scenario.place("analysis")
    return known, port_of(scenario.analysis, plan.slots(), known, chosen, place)


def record(scenario: Scenario, plan: Plan, port: PortSignals) -> SignalTrace:
    """The scenario run as it is, in memory, with the port's signals recorded."""
    slots = plan.slots()
    width = sum(slots[name].size for name in port.signals())
    every = max(scenario.run.record.every, -(-plan.ticks // min(ROWS, VALUES // max(1, width))))
    found = trace(plan, port.signals(), every)
    return found if every > 1 else _acting_from(found, (port.external, port.far_external))


def _acting_from(found: SignalTrace, inputs: Collection[str]) -> SignalTrace:
    """Rows of `inputs` moved up by one: at t_k the torque that acts from then on.

    An arm reads its inputs as it steps, so row k + 1 holds what acted from t_k to t_(k+1). Outputs
    of a sampled operator, which is what a recorded run has, are those of t_k as well.
    """
    columns = dict(found.columns)
    for name in filter(None, inputs):
        columns[name] = np.concatenate([columns[name][1:], columns[name][-1:]])
    return replace(found, columns=columns)


def of_run(folder: str | Path, chosen: str = "") -> Subject:
    """A recorded run; its scenario, from ``run.json``, is used for predictions and tests.

    If the scenario cannot be assembled any more, there is no system, and a remark instead. Raises
    ScenarioError if the folder is not a run, or signals of the port were not recorded.
    """
    folder = Path(folder)
    run = Run.open(folder)
    names = {signal_of(name) for name in run.names}
    known, spec, title, remark = None, AnalysisSpec(), folder.name, ""
    try:
        scenario = stored_scenario(run.metadata)
        title, spec = scenario.title, scenario.analysis
        known = system(scenario, assemble(scenario))
    except CosimError as error:
        remark = f"no closed forms, no test forces: {error}"
    if known is None:
        port = port_of(_recordable(spec), names, None, chosen, str(folder))
        if not port.external:
            remark += f"; the force is {port.force} alone: what else acted is not known"
        return Subject(title, run, port, None, (remark,))
    slots = known.plan.slots()
    port = _recorded(port_of(spec, slots, known, chosen, str(folder)), names, folder)
    signals = RunWithInputs(run, known.plan)
    port, remarks = _far_end(port, signals)
    return Subject(title, signals, port, known, remarks)


def _far_end(port: PortSignals, signals: RunWithInputs) -> tuple[PortSignals, tuple[str, ...]]:
    """The port without its far end where a torque on that was not recorded, and a remark."""
    try:
        if port.far_external:
            next(signals.pieces([port.far_external])).array(port.far_external)
    except ScenarioError as error:
        return replace(port, far_force="", far_external=""), (f"no far end: {error}",)
    return port, ()


def _recordable(spec: AnalysisSpec) -> AnalysisSpec:
    """Without the input of test forces, which no run records."""
    return AnalysisSpec(
        force=spec.force,
        response=spec.response,
        rate=spec.rate,
        far_force=spec.far_force,
        far_response=spec.far_response,
        far_rate=spec.far_rate,
    )


def stored_scenario(metadata: dict[str, Any]) -> Scenario:
    """The scenario that a run keeps. Raises ScenarioError."""
    data = metadata.get("scenario")
    if not isinstance(data, dict):
        raise ScenarioError("the run's metadata holds no scenario")
    document = {key: value for key, value in data.items() if key != "path"}
    return build(document, Path(str(data.get("path", "scenario.toml"))))


def _recorded(port: PortSignals, names: Collection[str], folder: Path) -> PortSignals:
    """The port, without what was not recorded. Raises ScenarioError where that leaves none."""
    for name in (port.force, port.response):
        if name not in names:
            known = listed(sorted(names))
            raise ScenarioError(f"{name} was not recorded; recorded are {known}", str(folder))
    kept = {
        field: getattr(port, field) if getattr(port, field) in names else ""
        for field in ("rate", "far_force", "far_response", "far_rate")
    }
    estimates = port.estimates if all(name in names for name in port.estimates) else ()
    members = port.members if all(name in names for name in port.members) else ()
    return replace(port, **kept, estimates=estimates, members=members)
