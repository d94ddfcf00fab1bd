"""``cosim campaign``: rehearsals with fault scripts, one after the other, and their results."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bridge.cli.options import ChangeOptions, Realtime
from cosim.base.convert import Struct, field
from cosim.cli.options import ResultOptions, Retry

if TYPE_CHECKING:
    from bridge.campaign.soak import RunSetup
    from bridge.campaign.spec import Campaign
    from bridge.deployment.system import System


class ScriptOptions(ChangeOptions, frozen=True):
    """The scripts of a campaign that are run."""

    only: Annotated[
        list[str],
        typer.Option("--only", metavar="SCRIPT", help="Run this script only; repeatable."),
    ] = field(default_factory=list)


class CampaignOptions(Struct, frozen=True):
    """The folder and the processes of a campaign, and faults that are drawn at random."""

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
        int | None,
        typer.Option(
            "--jobs",
            "--parallel",
            min=1,
            help="Number of parallel runs, if each has its own network namespaces.",
            show_default="1, with --faults 2",
        ),
    ] = None
    retry: Retry = False
    blind: Annotated[
        bool,
        typer.Option(
            "--blind", help="Disable the checks of receivers; the campaign must then fail."
        ),
    ] = False


def campaign(
    file: Annotated[Path, typer.Argument(help="Campaign file (.toml); see docs/faults.md.")],
    scripts: ScriptOptions,
    options: CampaignOptions,
    result: ResultOptions,
) -> None:
    """Run a rehearsal with each fault script of a campaign, and check each run.

    With --faults, that many faults are drawn at random and spread over many runs, most of them
    simulated and the others with real processes. The same command, with the same --out, continues
    an interrupted campaign. Exit status 1 if a run failed or gave no result.
    """
    if options.faults:
        _run_many(file, options, result)
        return
    from bridge.campaign import judgement, page, scripted
    from bridge.campaign.spec import load_campaign
    from cosim.cli.show import aligned
    from cosim.cli.summary import this_command
    from cosim.cli.sweep import watched

    found = load_campaign(file)
    job, system = _setup(found, scripts, options)
    runs = []
    for run in scripted.runs_of(found, scripts.only):
        if scripted.needs_kernel(system, run):
            typer.echo(f"{run.name:<12} left out: needs socketcan", err=True)
        else:
            runs.append(run)
    again = f"the same command and --out {job.folder}"
    parallel = options.jobs if options.jobs and job.hosted else 1
    with watched(result.quiet, job.folder, found.title, "runs", again) as observer:
        judged = scripted.campaign(
            job, found, runs, parallel, retry=options.retry, observer=observer
        )
    rows = judgement.table([one for _, one in judged])
    result.say("\n".join(aligned(rows)))
    if options.markdown:
        options.markdown.write_text(judgement.markdown(rows), encoding="utf-8")
    if judged:
        path = page.write_campaign(judged, found.title, job.folder, this_command())
        result.save("campaign", page.campaign_as_data(judged, job.folder))
        result.say(f"{'report':<16} {path}")
    if not judged or any(one.failures for _, one in judged):
        raise typer.Exit(1)


def _setup(
    found: Campaign, scripts: ScriptOptions, options: CampaignOptions
) -> tuple[RunSetup, System]:
    """The setup of all runs, and their system; runs at the same time have a bus each."""
    from bridge.campaign.soak import RunSetup
    from bridge.cli.soak import own_bus
    from bridge.deployment import spec as deploy
    from bridge.deployment.system import load_system
    from bridge.rehearsal import hosts
    from cosim.base.clock import stamp
    from cosim.cli.summary import this_command

    path = deploy.find(found.scenario, found.deploy)
    changes = (*found.settings, *scripts.settings(deploy.load(path)))
    system = load_system(found.scenario, str(path), changes)
    several = (options.jobs or 1) > 1
    why = (own_bus(system.deployment) or hosts.missing()) if several else ""
    if why:
        typer.echo(f"the runs are sequential: {why}", err=True)
    folder = options.out or Path("runs") / f"{found.path.stem}-{stamp()}"
    setup = RunSetup(
        scenario=found.scenario,
        deployment=path,
        changes=changes,
        folder=folder,
        hosted=several and not why,
        realtime=options.realtime,
        warm_up=0.2,
        formats=("log",),
        command=this_command(),
    )
    return setup, system


def _run_many(file: Path, options: CampaignOptions, result: ResultOptions) -> None:
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
        records = driver.campaign(job, options.faults, options.jobs or 2, options.retry, observer)
    title += f", seed {options.seed}"
    if options.markdown:
        options.markdown.write_text(table.markdown(records, title), encoding="utf-8")
    conclude(records, title, folder, result)
