"""A campaign of fault scripts: each is rehearsed, and compared with what the campaign expects."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from bridge.campaign import judgement
from bridge.campaign.judgement import JudgedRun
from bridge.campaign.soak import RunSetup, rehearse_run
from bridge.campaign.soak_driver import RunsFolder, drive, fingerprint
from bridge.campaign.spec import Campaign, CampaignRunSpec
from bridge.deployment.system import System
from bridge.faults.load import load
from bridge.results.page import describe
from cosim.base.clock import stopwatch
from cosim.base.convert import convert
from cosim.base.copies import asdict
from cosim.base.errors import RunError, ScenarioError
from cosim.base.interrupts import signals_as_interrupt
from cosim.base.names import unknown
from cosim.record import seal
from cosim.study.run_point import StudyRow
from cosim.study.runner import UNOBSERVED, Observer

#: Actions for a kernel's CAN interface only: others cannot be set down, nor take such a load.
KERNEL = ("bus-down", "bus-up", "babble")


@dataclass(frozen=True, slots=True)
class ScriptedRun:
    """A run of a campaign: its folder in that of the campaign, what is expected, and its script."""

    name: str
    spec: CampaignRunSpec
    script: Path


def runs_of(campaign: Campaign, only: Sequence[str] = ()) -> list[ScriptedRun]:
    """The runs in the order of the file, or those of some scripts `only`; a repeated one has -2.

    `only`: names or files. Raises ScenarioError for a script that the campaign does not have.
    """
    times, found = Counter[str](), []
    known = [Path(spec.script).stem for spec, _ in campaign.runs]
    only = [text.removesuffix(".toml") for text in only]
    if strange := sorted({*only} - {*known}):
        raise ScenarioError(unknown(strange[0], known, "script"), f"{campaign.path}: --only")
    for spec, script in campaign.runs:
        name = Path(spec.script).stem
        if only and name not in only:
            continue
        times[name] += 1
        number = f"-{times[name]}" if times[name] > 1 else ""
        found.append(ScriptedRun(f"{name}{number}", spec, script.path))
    return found


def needs_kernel(system: System, run: ScriptedRun) -> bool:
    """True if the script acts on a bus of a kernel, and the system has others."""
    buses = system.deployment.buses.values()
    others = any(bus.interface != "socketcan" for bus in buses)
    return others and any(e.action in KERNEL for e in load(run.script).events)


def run_script(job: RunSetup, run: ScriptedRun) -> StudyRow:
    """Rehearse with a script and evaluate the run; a run that fails is a row with its reasons."""
    folder, watch = job.folder / run.name, stopwatch()
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    try:
        with signals_as_interrupt():
            done = rehearse_run(job, folder, 0, lambda *_: load(run.script), expected=run.spec)
            describe(done.system, done.outcome)
            seal(folder)
        judged = done.judged
    except RunError as error:
        judged = judgement.failed_run(run.spec.script, error)
    return row_of(run.name, judged, job.changes, watch())


def row_of(name: str, judged: JudgedRun, changes: Sequence[str], wall: float) -> StudyRow:
    """The row of a judged run that took `wall` s."""
    cells, why = {"judged": json.dumps(asdict(judged))}, "; ".join(judged.failures)
    return StudyRow(name, cells, changes, not why, why, wall=wall)


def campaign(
    job: RunSetup,
    file: Campaign,
    runs: Sequence[ScriptedRun],
    parallel: int,
    *,
    retry: bool = False,
    observer: Observer = UNOBSERVED,
) -> list[tuple[str, JudgedRun]]:
    """Make the runs that the folder does not have yet; the name and the judgement of each."""
    facts = {
        "title": file.title,
        "campaign": str(file.path.resolve()),
        "settings": list(job.changes),
        "fingerprint": fingerprint(file.path, job.scenario, job.deployment),
    }
    records = drive(
        RunsFolder(job.folder, "campaign", facts),
        partial(run_script, job),
        {run.name: run for run in runs},
        parallel,
        retry=retry,
        observer=observer,
    )
    found = {str(record["run"]): record for record in records}
    return [(run.name, _judged(found[run.name])) for run in runs if run.name in found]


def _judged(record: Mapping[str, object]) -> JudgedRun:
    """The judgement in a row; a process that died has left none."""
    if text := record.get("judged"):
        return convert(json.loads(str(text)), JudgedRun, Path(str(record["run"])))
    return judgement.failed_run(str(record["run"]), RunError(str(record["reason"])))
