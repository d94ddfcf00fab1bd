"""A campaign of many faults: its runs side by side, each once, whatever ends the process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import count, permutations
from pathlib import Path
from typing import Any

from bridge.campaign import compressed, judgement, soak
from bridge.campaign.drive_judge import judge_drives
from bridge.campaign.plan import Many, document
from bridge.campaign.soak_driver import Record, RunsFolder, drive, fingerprint, numbered
from bridge.campaign.soak_judgement import RunDone
from bridge.campaign.soak_spec import Table
from bridge.campaign.spec import CampaignRunSpec
from bridge.deployment.system import System, load_system
from bridge.rehearsal.hosts import groups
from cosim.base.copies import replace
from cosim.record.folder import NODES
from cosim.study.run_point import StudyRow
from cosim.study.runner import UNOBSERVED, Observer


@dataclass(frozen=True, slots=True)
class CampaignSetup:
    """The common part of all runs of a campaign.

    `blind`: simulated receivers check neither CRC nor counter, so that the campaign has to fail.
    `hosted`: there are network namespaces, so that runs can be rehearsed; else all are simulated.
    """

    many: Many
    folder: Path
    seed: int
    hosted: bool
    blind: bool = False
    realtime: bool = True

    def kind_of_run(self, k: int) -> tuple[str, bool]:
        """(channel, rehearsed)."""
        channel, rehearsed = self.many.kind_of_run(k)
        return channel, rehearsed and self.hosted and not self.blind


def runs_for(job: CampaignSetup, faults: int) -> int:
    """The number of runs, from the first one on, that have so many faults."""
    total = 0
    for k in count():
        if total >= faults:
            return k
        channel, rehearsed = job.kind_of_run(k)
        many, changes = job.many, job.many.changes(channel, rehearsed)
        system = _loaded(many.scenario, many.deployment(channel), changes)
        links = [f"{a}>{b}" for a, b in permutations(groups(system), 2)]
        total += len(document(many, system, links, rehearsed, job.seed, k)["fault"])
    raise AssertionError("not reached")


def run_and_judge(job: CampaignSetup, k: int) -> StudyRow:
    """Simulate or rehearse run `k` and evaluate it."""
    channel, rehearsed = job.kind_of_run(k)
    many, system = job.many, _system(job.many, channel, rehearsed)
    one = soak.SoakSetup(
        scenario=many.scenario,
        deployment=many.deployment(channel),
        changes=many.changes(channel, rehearsed),
        folder=job.folder,
        hosted=True,
        network=len(groups(system)) > 1,
        realtime=job.realtime,
        soak=many.soak(),
        seed=job.seed,
    )

    def drawn(system: System, links: tuple[str, ...]) -> Table:
        return document(many, system, links, rehearsed, job.seed, k)

    def run(folder: Path) -> RunDone:
        if rehearsed:
            return soak.rehearse_drawn(one, k, folder, drawn)
        return _simulated(system, drawn(system, ()), folder, one.changes, job.blind)

    row = soak.judge_row(one, k, run)
    how = "rehearsed" if rehearsed else "simulated"
    return replace(row, cells={**row.cells, "channel": channel, "how": how})


def _simulated(
    system: System, drawn: Table, folder: Path, changes: tuple[str, ...], blind: bool
) -> RunDone:
    script = soak.script_of(drawn, folder)
    outcome = compressed.run(system, script, folder, changes, blind=blind)
    judged = judgement.judge(system, CampaignRunSpec(script=str(script.path)), outcome)
    wrong = [
        f"{len(drive.forbidden)} torques to {drive.name}, which had told that it was off"
        for drive in judge_drives(system, script, folder / NODES, cold=False)
        if drive.forbidden
    ]
    judged = replace(judged, failures=(*judged.failures, *wrong))
    return RunDone(system, script, outcome, judged, ())


@lru_cache(maxsize=16)
def _loaded(scenario: Path, deployment: Path, changes: tuple[str, ...]) -> System:
    return load_system(scenario, str(deployment), changes)


def _system(many: Many, channel: str, rehearsed: bool) -> System:
    changes = many.changes(channel, rehearsed)
    if rehearsed:
        return _loaded(many.scenario, many.deployment(channel), changes)
    return load_system(many.scenario, str(many.deployment(channel)), changes)


def campaign(
    job: CampaignSetup,
    faults: int,
    parallel: int,
    retry: bool = False,
    observer: Observer = UNOBSERVED,
) -> list[Record]:
    """Make the runs that the folder does not have yet; rows of all, as :func:`drive`."""
    return drive(
        RunsFolder(job.folder, "campaign", facts(job)),
        partial(run_and_judge, job),
        numbered(runs_for(job, faults)),
        parallel,
        retry=retry,
        observer=observer,
    )


def facts(job: CampaignSetup) -> Mapping[str, Any]:
    """Facts that distinguish this folder from that of another campaign."""
    many = job.many
    files = (many.path, many.scenario, *(many.deployment(c) for c in many.spec.channels))
    return {
        "title": many.spec.title,
        "campaign": str(many.path.resolve()), "seed": job.seed, "blind": job.blind,
        "hosted": job.hosted, "fingerprint": fingerprint(*files),
    }  # fmt: skip
