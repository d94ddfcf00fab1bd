"""A rehearsal's run folder, completed: trajectories, tables, logs, twin, replay, numbers.

::

    RUN/run.json               scenario, deployment, settings, versions, verdict
    RUN/trajectories.parquet   signals on the base tick, as in an offline run
    RUN/links/*.parquet        sample that each link's receiver held
    RUN/nodes/LIFE.journal     one row per slot; LIFE.heard one row per received sample;
                               LIFE.json its report; LIFE.BUS.frames every frame;
                               LIFE is NODE, or NODE@2 after a restart
    RUN/buses/BUS.log          candump
    RUN/twin/                  the same on a simulated clock
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from bridge.deployment.system import System
from bridge.faults.script import FaultScript
from bridge.recording import run_folder
from bridge.records.node_lives import Life
from bridge.records.records import note_of
from bridge.rehearsal.supervisor import STARTED, RehearsalRecord
from bridge.replay import replay, twin
from bridge.replay.aligned import row_by_row
from bridge.results import detection, report, timeline, verdict
from bridge.results.detection_links import RecordedNetwork
from bridge.results.drive_answers import unanswered
from bridge.results.drive_states import seldom_told
from bridge.results.findings import Evidence
from bridge.results.rehearsal_outcome import ComponentFailure, RehearsalOutcome, failure_of
from bridge.results.symptoms import FinishedRun
from bridge.wiring.wiring import Rows
from cosim.base.clock import realtime_offset_ns
from cosim.base.copies import asdict
from cosim.base.errors import CosimError, Interrupted, RunError, ScenarioError
from cosim.base.interrupts import acknowledge
from cosim.engine.simulate import metadata, stop_metadata
from cosim.measure import declared_metrics, requirements
from cosim.measure.metric_result import summary_line
from cosim.measure.metrics import Metric, MetricResult
from cosim.measure.robustness import Robustness
from cosim.record import Run, seal, write_metadata
from cosim.record.folder import (
    FINISHED,
    NODES,
    STOPPED,
    TRAJECTORIES,
    journals,
    read_metadata,
)
from cosim.record.piecewise import PairwiseSum

TWIN = "twin"
#: Entries of ``run.json`` that every run has: the command that was typed, what the check found.
OF_ANY_RUN = ("command", "findings")


def clear(folder: Path, *, resumed: bool = False) -> None:
    """Delete the files of an earlier rehearsal in a folder that will be reused.

    Those of the nodes remain if it is `resumed`. A folder with other files is left unchanged:
    :func:`cosim.record.folder.claim_folder` refuses it.
    """
    if not (folder / NODES).is_dir():
        return
    for name in (run_folder.BUSES, TWIN, *(() if resumed else (NODES,))):
        shutil.rmtree(folder / name, ignore_errors=True)
    (folder / STARTED).unlink(missing_ok=True)


def complete(
    system: System,
    folder: Path,
    ended: RehearsalRecord,
    facts: Mapping[str, Any],
    *,
    with_twin: bool = True,
    formats: tuple[str, ...] = ("log",),
    script: FaultScript | None = None,
    network: RecordedNetwork | None = None,
) -> RehearsalOutcome:
    """Make the run folder from the files of the nodes.

    Raises RunError if no node reached its first slot, and CosimError if a file cannot be written.

    `script`: the faults that were injected, each to be found in the report; `network`: of those
    between hosts.
    """
    nodes = folder / NODES
    rows, heard = replay.load(nodes), replay.received_by_life(nodes)
    if not rows:
        why = "; ".join(map(str, ended.notes)) or "no reason was reported"
        raise RunError(f"no node reached its first slot ({why}); their output is in {nodes}")
    offset = 0 if system.deployment.clock == "simulated" else realtime_offset_ns()
    found = run_folder.collect(system, rows, nodes, folder, wall_ns=offset, formats=formats)
    reports = report.node_reports(system, rows, nodes)
    replayed, error = _replay_run(system, rows, heard)
    rms, twin_error = _compared(system, folder, facts["settings"]) if with_twin else ({}, "")
    faults: Sequence[Evidence] = ()
    if script is not None:
        strange = replayed.altered if replayed else ()
        altered = {(a.life, a.message): a.count for a in strange}
        shown = FinishedRun(system, rows, reports, nodes, ended.notes, altered)
        faults = detection.find(script, shown, network)
    outcome = RehearsalOutcome(
        folder, found.ticks, rows, reports, replayed, error, rms,
        report.bus_reports(system, found.logs, _start_of_logs(system, ended.start_ns)),
        ended.notes, faults,
        tuple(unanswered(system, rows, reports, nodes)) if facts.get("real") else (),
        _required(system, folder, failure_of(system, rows, reports)), twin_error,
    )  # fmt: skip
    write_metadata(folder, _metadata(system, outcome, facts))
    seal(folder)
    return outcome


def reopen(system: System, folder: Path) -> RehearsalOutcome:
    """The outcome of a rehearsal whose run folder is complete, computed from its files again.

    Nothing is written. Raises ScenarioError for a folder of something else.
    """
    nodes, known = folder / NODES, read_metadata(folder)
    facts = known.get("rehearsal")
    rows, heard = replay.load(nodes), replay.received_by_life(nodes)
    if not facts or not rows:
        raise ScenarioError("no complete rehearsal", str(folder))
    replayed, error = _replay_run(system, rows, heard)
    started = folder / STARTED
    start_ns = json.loads(started.read_text("utf-8"))["start_ns"] if started.exists() else 0
    reports = report.node_reports(system, rows, nodes)
    return RehearsalOutcome(
        folder, len(Run.open(folder)), rows, reports, replayed, error,
        facts["twin_rms"] if isinstance(facts["twin_rms"], dict) else {},
        report.bus_reports(
            system, run_folder.bus_logs(system, nodes), _start_of_logs(system, start_ns)
        ),
        [note_of(x) for x in facts["notes"]], [Evidence.of(x) for x in facts["faults"]],
        tuple(unanswered(system, rows, reports, nodes)) if known["deployment"].get("real") else (),
        _required(system, folder, failure_of(system, rows, reports)), facts.get("twin_error", ""),
    )  # fmt: skip


def _start_of_logs(system: System, start_ns: int) -> int:
    """Time 0 of a run on the clock of its bus logs, ns; simulated buses count from it."""
    return 0 if system.deployment.clock == "simulated" else start_ns


def _required(
    system: System, folder: Path, failure: ComponentFailure | None
) -> tuple[Robustness, ...]:
    """The results of the scenario's requirements on what was recorded."""
    if not system.scenario.require:
        return ()
    run = Run.open(folder / TRAJECTORIES)
    return requirements.of_run(system.scenario, run, None if failure is None else failure.t)


def _compared(
    system: System, folder: Path, settings: Sequence[str]
) -> tuple[Mapping[str, float], str]:
    """The difference of a run's positions from its twin's, by unit; or why the twin failed."""
    try:
        return positions_rms(system, folder, run_twin(system, folder / TWIN, settings)), ""
    except RunError as error:
        return {}, str(error)


def begin(system: System, folder: Path, facts: Mapping[str, Any]) -> dict[str, Any]:
    """Write the start of the run to ``run.json``, so that it can be replayed however it ends."""
    found = metadata(system.scenario, system.plan) | deployment_facts(system, facts)
    write_metadata(folder, found)
    return found


def _replay_run(
    system: System, rows: Mapping[Life, Rows], heard: Mapping[Life, Rows]
) -> tuple[replay.ReplayReport | None, str]:
    with TemporaryDirectory() as scratch:
        try:
            return replay.replay(system, rows, heard, Path(scratch)), ""
        except CosimError as error:
            return None, str(error)


def run_twin(
    system: System,
    folder: Path,
    settings: Sequence[str] = (),
    further: Mapping[str, Any] | None = None,
) -> Path:
    """The twin's run folder; its journals are kept only where it had to stop.

    `settings`: those that `system` was made with, and `further` entries, for ``run.json``. Raises
    RunError where a component fails, Interrupted for Ctrl-C; what was recorded until then is in the
    folder.
    """
    nodes = folder / NODES
    nodes.mkdir(parents=True, exist_ok=True)
    facts = begin(system, folder, {"settings": list(settings), **(further or {})})
    error: RunError | KeyboardInterrupt | None = None
    try:
        twin.simulate(system, nodes)
    except (RunError, KeyboardInterrupt) as found:
        error = found
        acknowledge()
    rows = replay.load(nodes) if journals(folder) else {}
    ticks = run_folder.collect(system, rows, nodes, folder, wall_ns=0).ticks if rows else 0
    if error is None:
        shutil.rmtree(nodes)
    elif isinstance(error, RunError):
        error.saved = str(folder)
    else:
        error = Interrupted(max(ticks - 1, 0) * system.plan.h, str(folder))
    how = {"status": FINISHED} if error is None else stop_metadata(error)
    write_metadata(folder, facts | how)
    seal(folder)
    if error is not None:
        raise error
    return folder


def positions_rms(system: System, a: Path, b: Path) -> dict[str, float]:
    """RMS difference of all recorded angles (rad) and lengths (m) of two runs, by unit.

    Over their common time; a unit that no recorded position has is left out.
    """
    first, second = Run.open(a), Run.open(b)
    n = min(len(first), len(second))
    units = {
        name: slot.unit_of(i)
        for step in system.plan.components
        for slot in (step.outputs if step.kind == "continuous" else ())
        for i, name in enumerate(slot.scalars())
        if name in first.units and name in second.units
    }
    names = [name for name, unit in units.items() if unit in ("rad", "m")]
    sums = {name: PairwiseSum(n) for name in names}
    for rows in row_by_row(first, second, names):
        for name, (x, y) in rows.items():
            sums[name].add((x - y) ** 2)
    squares: dict[str, list[float]] = {"rad": [], "m": []}
    for name, found in sums.items() if n else ():
        squares[units[name]].append(found.value / n)
    return {unit: float(np.sqrt(np.mean(found))) for unit, found in squares.items() if found}


def twin_text(rms: Mapping[str, float]) -> str:
    """The differences of positions from the twin, by unit: ``0.0012 rad RMS, 0.003 m RMS``."""
    return ", ".join(f"{value:.2g} {unit} RMS" for unit, value in rms.items())


def deployment_facts(system: System, facts: Mapping[str, Any]) -> dict[str, Any]:
    """The entries of ``run.json`` about the deployment, sufficient for a replay.

    `facts` are about the deployment, except those of any run (`OF_ANY_RUN`).
    """
    return {
        "deployment": {
            "path": str(system.deployment.path.resolve()),
            "scenario": str(system.scenario.path.resolve()),
            "nodes": {n: list(s.components) for n, s in system.deployment.nodes.items()},
            "latency": system.deployment.latency,
            **{key: value for key, value in facts.items() if key not in OF_ANY_RUN},
        },
        **{key: facts[key] for key in OF_ANY_RUN if key in facts},
    }


def _metadata(
    system: System, outcome: RehearsalOutcome, facts: Mapping[str, Any]
) -> dict[str, Any]:
    replayed, judged = outcome.replayed, verdict.judge(system, outcome)
    failure = failure_of(system, outcome.rows, outcome.reports)
    return {
        **metadata(system.scenario, system.plan),
        **deployment_facts(system, facts),
        "status": FINISHED if outcome.finished else STOPPED,
        **({} if failure is None else {"error": failure.why, "failed_at": failure.t}),
        "marks": timeline.marks(outcome),
        **({"requirements": found} if (found := requirements.as_data(outcome.required)) else {}),
        "rehearsal": {
            "finished": outcome.finished,
            "verdict": str(judged.word),
            "reasons": list(judged.reasons),
            "notes": [note.facts() for note in outcome.notes],
            "faults": [fault.facts() for fault in outcome.faults],
            "nodes": {
                str(r.life): {
                    "lateness": r.lateness.facts(),
                    "state": r.state,
                    "reasons": list(r.reasons),
                    "end": r.end,
                    "said": r.statement.facts() if r.statement else {},
                }
                for r in outcome.reports
            },
            "twin_rms": outcome.twin_rms,
            **({"twin_error": outcome.twin_error} if outcome.twin_error else {}),
            "replay": None if replayed is None else replayed.greatest,
            "replay_error": outcome.replay_error,
            "altered": [asdict(a) for a in replayed.altered] if replayed else [],
        },
    }


def metrics(
    system: System, outcome: RehearsalOutcome, run: Run
) -> Iterator[tuple[Metric, MetricResult | None]]:
    """The metrics of the scenario with their results; None: a signal is of a node elsewhere."""
    ran = {report.life.node for report in outcome.reports}
    here = {name for node in ran for name in system.deployment.nodes[node].components}
    for metric in declared_metrics.metrics(system.scenario):
        there = all(name.partition(".")[0] in here for name in metric.signals)
        yield metric, metric.evaluate(run) if there else None


def metric_lines(system: System, outcome: RehearsalOutcome, run: Run) -> Iterator[str]:
    """The metrics of the scenario as lines of text, or which signals they lack."""
    ran = {report.life.node for report in outcome.reports}
    here = {name for node in ran for name in system.deployment.nodes[node].components}
    for metric, result in metrics(system, outcome, run):
        if result is not None:
            yield from (summary_line(*fact) for fact in result.facts)
            continue
        away = [name for name in metric.signals if name.partition(".")[0] not in here]
        text = f"not computed: {', '.join(away)}, of a node that did not run here"
        yield summary_line(metric.label or metric.name, text)


def lines(system: System, outcome: RehearsalOutcome) -> list[str]:
    """The summary of a rehearsal, without the metrics of the scenario."""
    said = [summary_line("requirement", result.line) for result in outcome.required]
    said += [summary_line("note", str(note)) for note in outcome.notes]
    said += [summary_line(str(r.life), r.text()) for r in outcome.reports]
    said += [summary_line(f"{r.life}, slots", r.parts()) for r in outcome.reports]
    said += report.firmware_lines(outcome.reports)
    said += [
        summary_line("not granted", f"{r.life}: {i['name']}: {i['said']}")
        for r in outcome.reports
        if r.statement
        for i in r.statement.granted.get("items", ())
        if not i["granted"]
    ]
    states = seldom_told(system, outcome.rows, outcome.folder / NODES)
    said += [summary_line("states", text) for text in states]
    said += report.age_lines(system, outcome.rows)
    said += [bus.text for bus in outcome.buses.values()]
    said += report.forward_lines(outcome.reports)
    said += report.fault_lines(outcome.reports)
    said += [summary_line(f"fault {f.index}", f.text()) for f in outcome.faults]
    if outcome.twin_rms:
        text = f"positions differ by {twin_text(outcome.twin_rms)}"
        said.append(summary_line("twin", text))
    if outcome.twin_error:
        said.append(summary_line("twin", f"failed, too: {outcome.twin_error}"))
    said.append(summary_line("replay", replay_text(outcome)))
    found = outcome.replayed.altered if outcome.replayed else ()
    said += [summary_line("altered", str(altered)) for altered in found]
    return said


def replay_text(outcome: RehearsalOutcome) -> str:
    """True if everything could be computed again."""
    found = outcome.replayed
    if found is None:
        return f"failed: {outcome.replay_error}"
    slots = sum(found.slots.values())
    if found.first is None:
        return f"{slots} slots of {len(found.slots)} nodes computed again: difference exactly 0"
    return f"differs by up to {found.greatest:.3g}; first: {found.first}"
