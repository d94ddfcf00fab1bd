"""``cosim campaign``: rehearsals with fault scripts, one after the other, and their results."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bridge.cli.options import ChangeOptions, Realtime
from cosim.cli.options import ResultOptions
from cosim.cli.supervise import announce_run_folder

if TYPE_CHECKING:
    from bridge.campaign.judgement import JudgedRun
    from bridge.campaign.spec import Campaign, CampaignRunSpec
    from bridge.deployment.system import System
    from bridge.faults.script import FaultScript
    from bridge.rehearsal.supervisor import Settings

#: Actions for a kernel's CAN interface only: others cannot be set down, nor take such a load.
KERNEL = ("bus-down", "bus-up", "babble")


@dataclass(frozen=True, slots=True)
class ScriptOptions(ChangeOptions):
    """The scripts of a campaign that are run."""

    only: Annotated[
        list[str],
        typer.Option("--only", metavar="SCRIPT", help="Run this script only; repeatable."),
    ] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class ManyOptions:
    """The faults of a campaign that are drawn at random, and what all campaigns write."""

    out: Annotated[
        Path | None,
        typer.Option(help="Folder for the run folders. Default: a new folder in runs/."),
    ] = None
    markdown: Annotated[
        Path | None, typer.Option(help="Write the table to this file, as Markdown.")
    ] = None
    realtime: Realtime = True
    faults: Annotated[
        int,
        typer.Option(min=0, help="Number of faults to draw from a file such as faults/many.toml."),
    ] = 0
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random faults.")] = 0
    jobs: Annotated[
        int,
        typer.Option("--jobs", "--parallel", min=1, help="Number of parallel runs, with --faults."),
    ] = 2
    retry: Annotated[
        bool, typer.Option("--retry", help="With --faults: repeat the runs that did not pass.")
    ] = False
    blind: Annotated[
        bool,
        typer.Option(
            "--blind", help="Disable the checks of receivers; the campaign must then fail."
        ),
    ] = False


def campaign(
    file: Annotated[Path, typer.Argument(help="Campaign file (.toml); see docs/faults.md.")],
    scripts: ScriptOptions,
    options: ManyOptions,
    result: ResultOptions,
) -> None:
    """Run a rehearsal with each fault script of a campaign, and check each run.

    With --faults, that many faults are drawn at random and spread over many runs, most of them
    simulated and the others with real processes. The same command continues an interrupted
    campaign. Exit status 1 if a run failed or gave no result.
    """
    if options.faults:
        _run_many(file, options, result)
        return
    from bridge.campaign import judgement, page
    from bridge.campaign.spec import load_campaign
    from cosim.base.clock import stamp
    from cosim.cli.show import aligned
    from cosim.cli.summary import this_command

    found = load_campaign(file)
    folder = options.out or Path("runs") / f"{file.stem}-{stamp()}"
    judged: list[tuple[str, JudgedRun]] = []
    times = Counter[str]()
    for spec, script in found.runs:
        name = Path(spec.script).stem
        if scripts.only and name not in scripts.only:
            continue
        times[name] += 1
        name += f"-{times[name]}" if times[name] > 1 else ""
        one = _one(found, spec, script, scripts, folder / name, options.realtime)
        typer.echo(f"{name:<12} {_said(one)}", err=True)
        judged += [(name, one)] if one else []
    rows = judgement.table([one for _, one in judged])
    result.say("\n".join(aligned(rows)))
    if options.markdown:
        options.markdown.write_text(judgement.markdown(rows), encoding="utf-8")
    if judged:
        path = page.write_campaign(judged, found.title, folder, this_command())
        result.save(page.campaign_as_data(judged, folder))
        result.say(f"{'report':<16} {path}")
    if not judged or any(one.failures for _, one in judged):
        raise typer.Exit(1)


def _run_many(file: Path, options: ManyOptions, result: ResultOptions) -> None:
    """A campaign of many faults, and its table."""
    from bridge.campaign import driver, table
    from bridge.campaign.plan import load_many
    from bridge.cli.soak import conclude
    from bridge.rehearsal import hosts
    from cosim.cli.sweep import watched

    why = hosts.missing()
    if why and not options.blind:
        typer.echo(f"no run is rehearsed; all runs are simulated: {why}", err=True)
    folder = options.out or Path("runs") / f"campaign-{file.stem}-{options.seed}"
    job = driver.CampaignSetup(
        load_many(file), folder.resolve(), options.seed, not why, options.blind, options.realtime
    )
    title = job.many.spec.title
    with watched(result.quiet, folder, title, "runs", "the same command") as observer:
        records = driver.campaign(job, options.faults, options.jobs, options.retry, observer)
    title += f", seed {options.seed}"
    if options.markdown:
        options.markdown.write_text(table.markdown(records, title), encoding="utf-8")
    conclude(records, title, folder, result)


def _said(one: JudgedRun | None) -> str:
    if one is None:
        return "left out: needs socketcan"
    return "; ".join(one.failures) or "as expected"


def _one(
    campaign: Campaign,
    spec: CampaignRunSpec,
    script: FaultScript,
    changes: ChangeOptions,
    folder: Path,
    realtime: bool,
) -> JudgedRun | None:
    """Rehearse with one script; None: this interface cannot."""
    from bridge.deployment import spec as deploy
    from bridge.deployment.system import load_system
    from bridge.rehearsal.supervisor import Settings

    path = deploy.find(campaign.scenario, campaign.deploy)
    said = (*campaign.settings, *changes.settings(deploy.load(path)))
    system = load_system(campaign.scenario, str(path), said)
    kernel = any(e.action in KERNEL for e in script.events)
    if kernel and any(b.interface != "socketcan" for b in system.deployment.buses.values()):
        return None
    settings = Settings(campaign.scenario, path, said, realtime=realtime, script=str(script.path))
    return _rehearsed(system, spec, script, settings, folder)


def _rehearsed(
    system: System, spec: CampaignRunSpec, script: FaultScript, settings: Settings, folder: Path
) -> JudgedRun:
    """Execute and evaluate one run."""
    from dataclasses import replace

    from bridge.campaign import judgement
    from bridge.rehearsal import injector
    from bridge.rehearsal.supervisor import Rehearsal
    from bridge.results.outcome import begin, complete
    from bridge.results.page import describe
    from cosim.base.errors import RunError
    from cosim.cli.summary import this_command
    from cosim.record import claim_folder, seal

    announce_run_folder(folder)
    claim_folder(folder, force=False)
    facts = {
        "settings": list(settings.changes), "faults": settings.script, "real": False,
        "command": this_command(),
    }  # fmt: skip
    begin(system, folder, facts)
    settings = replace(settings, events=injector.events(script, system))
    with Rehearsal(system, settings, folder) as rehearsal:
        try:
            rehearsal.run()
            rehearsal.end()
            outcome = complete(
                system, folder, rehearsal.ended, facts, with_twin=False, script=script
            )
            describe(system, outcome)
            seal(folder)
        except RunError as error:
            return judgement.failed_run(spec.script, error)
    return judgement.judge(system, spec, outcome)
