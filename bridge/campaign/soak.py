"""One run of a soak test: real nodes, faults drawn from a seed, and the checks of the run.

Input and output are plain data; the run has its own process (:mod:`cosim.base.processes`).
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bridge.campaign import judgement
from bridge.campaign.soak_judgement import RunDone, judge_soak_run, run_numbers
from bridge.campaign.soak_spec import Soak, Table, draw, text
from bridge.campaign.spec import CampaignRunSpec
from bridge.deployment.system import System, load_system
from bridge.faults.load import build
from bridge.faults.script import FaultScript
from bridge.node.handle import NodeHandle
from bridge.rehearsal import injector
from bridge.rehearsal.hosts import Hosts, groups, settings
from bridge.rehearsal.supervisor import Rehearsal, Settings
from bridge.results import detection_links
from bridge.results.outcome import begin, complete
from bridge.results.rehearsal_outcome import RehearsalOutcome
from bridge.results.verdict import Verdict, Word
from cosim.base.clock import stopwatch
from cosim.base.copies import replace
from cosim.base.errors import CosimError
from cosim.base.interrupts import signals_as_interrupt
from cosim.fmi.failures import sentence
from cosim.record import seal
from cosim.record.folder import is_unfinished
from cosim.study.run_point import StudyRow

RUNS, SCRIPT = "runs", "script.toml"


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSetup:
    """Settings common to many runs in a folder; `changes`: of scenario and deployment.

    `hosted`: each run in separate network namespaces, `network`: with faults of the network between
    them. `formats`: of the bus logs that are kept; `command`: that has made the runs.
    """

    scenario: Path
    deployment: Path
    changes: tuple[str, ...]
    folder: Path
    hosted: bool = False
    network: bool = False
    realtime: bool = True
    warm_up: float = 0.0
    formats: tuple[str, ...] = ()
    command: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class SoakSetup(RunSetup):
    """Settings common to all runs of a soak test; `keep`: also run folders of runs that passed."""

    soak: Soak
    seed: int
    keep: bool = False


#: The script of a run, by its system and the links between its hosts.
Scripted = Callable[[System, tuple[str, ...]], FaultScript]


def run_soak(job: SoakSetup, k: int) -> StudyRow:
    """Run `k`; what goes wrong becomes the reason of its row."""

    def run(folder: Path) -> RunDone:
        return rehearse_drawn(
            job, k, folder, lambda system, links: draw(job.soak, system, links, job.seed, k)
        )

    return judge_row(job, k, run)


def judge_row(job: SoakSetup, k: int, run: Callable[[Path], RunDone]) -> StudyRow:
    """Evaluate the result of `run` in the folder of run `k`; an error becomes the reason in its
    row.
    """
    name, watch = f"{k:05d}", stopwatch()
    folder = job.folder / RUNS / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    cells: dict[str, Any] = {"faults": "", "zenoh": Path(job.soak.zenoh(job.seed, k)).stem}
    measures: dict[str, float] = {}
    try:
        with signals_as_interrupt(), np.errstate(all="ignore"):
            done = run(folder)
            measures = run_numbers(job.soak, done)
            found = judge_soak_run(job.soak, done, measures)
        cells["faults"] = ", ".join(f.kind for f in done.outcome.faults)
        cells["ended"] = "; ".join(f"{x}: {why}" for x, why in done.judged.ended.items())
    except CosimError as error:
        found = Verdict(Word.ERROR, (f"no run: {error}",))
    except Exception as error:
        found = Verdict(Word.ERROR, (f"no verdict: {sentence(error)}",))
    well = found.word is Word.PASSED
    if well and not job.keep:
        shutil.rmtree(folder, ignore_errors=True)
    else:
        found = _write_checksums(folder, found)
    cells["verdict"] = str(found.word)
    return StudyRow(
        name, cells, job.changes, well, "; ".join(found.reasons), wall=watch(), measures=measures
    )


def _write_checksums(folder: Path, found: Verdict) -> Verdict:
    """Sums of everything a run has left, also by its hosts; an error where that cannot be done."""
    try:
        if not is_unfinished(folder):
            seal(folder, anew=True)
    except CosimError as error:
        return Verdict(Word.ERROR, (*found.reasons, str(error)))
    return found


def rehearse_drawn(
    job: SoakSetup, k: int, folder: Path, drawn: Callable[[System, tuple[str, ...]], Table]
) -> RunDone:
    """Rehearse run `k` with what is `drawn` for it, and make its folder."""
    seed, zenoh = job.seed * 100_003 + k, job.soak.zenoh(job.seed, k)
    return rehearse_run(job, folder, seed, lambda *of: script_of(drawn(*of), folder), zenoh=zenoh)


def rehearse_run(
    job: RunSetup,
    folder: Path,
    seed: int,
    scripted: Scripted,
    *,
    expected: CampaignRunSpec | None = None,
    zenoh: str = "",
) -> RunDone:
    """Rehearse with a script, and make the folder of the run.

    `seed`: of the network between hosts, `zenoh`: its configuration; `expected`: of the run.
    """
    system = load_system(job.scenario, str(job.deployment), job.changes)
    with ExitStack() as stack:
        changes, hosts = job.changes, None
        if job.hosted:
            parts = groups(system) if job.network else {next(iter(system.nodes)): [*system.nodes]}
            hosts = Hosts(parts, folder / "packets", seed)
            if hosts.network is not None:
                changes += tuple(settings(system, parts, hosts.addresses, zenoh))
            stack.enter_context(hosts)
            system = load_system(job.scenario, str(job.deployment), changes)
        script = scripted(system, _links(hosts))
        outcome, lives = _rehearsed(replace(job, changes=changes), system, script, folder, hosts)
    spec = expected or CampaignRunSpec(script=str(script.path))
    return RunDone(system, script, outcome, judgement.judge(system, spec, outcome), lives)


def _links(hosts: Hosts | None) -> tuple[str, ...]:
    network = hosts.network if hosts else None
    return tuple(network.names) if network else ()


def script_of(document: Table, folder: Path) -> FaultScript:
    """The script of a run, written into its folder, too."""
    (folder / SCRIPT).write_text(text(document), encoding="utf-8")
    return build(document, folder / SCRIPT)


def _rehearsed(
    job: RunSetup, system: System, script: FaultScript, folder: Path, hosts: Hosts | None
) -> tuple[RehearsalOutcome, Sequence[NodeHandle]]:
    """The outcome of a run, and the processes of its nodes."""
    network = hosts.network if hosts else None
    given = Settings(
        job.scenario,
        job.deployment,
        job.changes,
        warm_up=job.warm_up,
        realtime=job.realtime,
        script=str(script.path),
        events=injector.events(script, system, network),
    )
    if hosts is not None:
        given = replace(given, on_host=hosts.on_host)
    facts = {"settings": list(job.changes), "faults": str(script.path), "real": False}
    facts |= {"command": job.command} if job.command else {}
    begin(system, folder, facts)
    with Rehearsal(system, given, folder) as rehearsal:
        rehearsal.run()
        rehearsal.end()
        ended = rehearsal.ended
        there = network and detection_links.RecordedNetwork(network, hosts.hosts, ended.start_ns)  # type: ignore[union-attr]
        outcome = complete(
            system,
            folder,
            ended,
            facts,
            with_twin=False,
            formats=job.formats,
            script=script,
            network=there,
        )
    return outcome, ended.lives
