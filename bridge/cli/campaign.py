"""``cosim campaign``: rehearsals with fault scripts, one after the other, and their results."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bridge.cli.options import BusOptions, Interface, Realtime
from cosim.cli.options import Json, Set, write_json
from cosim.cli.supervise import announce_run_folder

if TYPE_CHECKING:
    from bridge.campaign.judgement import JudgedRun
    from bridge.campaign.spec import Campaign, CampaignRunSpec
    from bridge.deployment.system import System
    from bridge.faults.script import FaultScript
    from bridge.rehearsal.supervisor import Settings

#: Actions for a kernel's CAN interface only: others cannot be set down, nor take such a load.
KERNEL = ("bus-down", "bus-up", "babble")


def campaign(
    file: Annotated[Path, typer.Argument(help="Campaign file (.toml); see docs/faults.md.")],
    only: Annotated[
        list[str] | None,
        typer.Option("--only", metavar="SCRIPT", help="Run this script only; repeatable."),
    ] = None,
    set_: Set = None,
    interface: Interface = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for the run folders. Default: a new folder in runs/."),
    ] = None,
    markdown: Annotated[
        Path | None, typer.Option(help="Write the table to this file, as Markdown.")
    ] = None,
    realtime: Realtime = True,
    faults: Annotated[
        int,
        typer.Option(min=0, help="Number of faults to draw from a file such as faults/many.toml."),
    ] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random faults.")] = 0,
    parallel: Annotated[
        int, typer.Option(min=1, help="Number of parallel runs, with --faults.")
    ] = 2,
    retry: Annotated[
        bool, typer.Option("--retry", help="With --faults: repeat the runs that did not pass.")
    ] = False,
    blind: Annotated[
        bool,
        typer.Option(
            "--blind", help="Disable the checks of receivers; the campaign must then fail."
        ),
    ] = False,
    json: Json = None,
) -> None:
    """Run a rehearsal with each fault script of a campaign, and check each run.

    With --faults, that many faults are drawn at random and spread over many runs, most of them
    simulated and the others with real processes. The same command continues an interrupted
    campaign. Exit status 1 if a run failed or gave no result.
    """
    if faults:
        _run_many(file, faults, seed, parallel, out, markdown, retry, blind, realtime, json)
        return
    from bridge.campaign import judgement, page
    from bridge.campaign.spec import load_campaign
    from cosim.base.clock import stamp
    from cosim.cli.show import aligned
    from cosim.cli.summary import this_command

    found = load_campaign(file)
    folder = out or Path("runs") / f"{file.stem}-{stamp()}"
    changes = [*found.settings, *(set_ or [])]
    judged: list[tuple[str, JudgedRun]] = []
    times = Counter[str]()
    for spec, script in found.runs:
        name = Path(spec.script).stem
        if only and name not in only:
            continue
        times[name] += 1
        name += f"-{times[name]}" if times[name] > 1 else ""
        one = _one(found, spec, script, changes, interface, folder / name, realtime)
        typer.echo(f"{name:<12} {_said(one)}", err=True)
        judged += [(name, one)] if one else []
    rows = judgement.table([one for _, one in judged])
    typer.echo("\n".join(aligned(rows)))
    if markdown:
        markdown.write_text(judgement.markdown(rows), encoding="utf-8")
    if judged:
        path = page.write_campaign(judged, found.title, folder, this_command())
        if json is not None:
            write_json(json, page.campaign_as_data(judged, folder))
        typer.echo(f"{'report':<16} {path}")
    if not judged or any(one.failures for _, one in judged):
        raise typer.Exit(1)


def _run_many(
    file: Path,
    faults: int,
    seed: int,
    parallel: int,
    out: Path | None,
    markdown: Path | None,
    retry: bool,
    blind: bool,
    realtime: bool,
    json: Path | None,
) -> None:
    """A campaign of many faults, and its table."""
    from bridge.campaign import driver, page, table
    from bridge.campaign.plan import load_many
    from bridge.rehearsal import hosts
    from cosim.cli.show import aligned
    from cosim.cli.summary import this_command
    from cosim.cli.sweep import interrupted, progress_of, stopping
    from cosim.study.runner import Observer

    why = hosts.missing()
    if why and not blind:
        typer.echo(f"no run is rehearsed; all runs are simulated: {why}", err=True)
    folder = out or Path("runs") / f"campaign-{file.stem}-{seed}"
    job = driver.CampaignSetup(load_many(file), folder.resolve(), seed, not why, blind, realtime)
    with progress_of(False) as progress:
        try:
            observer = Observer(
                lambda b: progress.begin(b, job.many.spec.title, "runs"), progress.done, stopping
            )
            records = driver.campaign(job, faults, parallel, retry, observer)
        except KeyboardInterrupt:
            raise interrupted(progress, folder, "the same command") from None
    kinds, title = table.kinds(records), f"{job.many.spec.title}, seed {seed}"
    typer.echo("\n".join(aligned(kinds)))
    text = table.markdown(records, title)
    for path in (folder / "summary.md", *([markdown] if markdown else [])):
        path.write_text(text, encoding="utf-8")
    report = page.write_many(records, kinds, title, folder, this_command())
    if json is not None:
        write_json(json, page.many_as_data(records, folder))
    for line in table.inconclusive(records):
        typer.echo(f"inconclusive: {line}", err=True)
    wrong = table.failures(records)
    for line in wrong:
        typer.echo(line, err=True)
    typer.echo(f"{'report':<16} {report}")
    typer.echo(f"{'folder':<16} {folder}")
    if wrong:
        raise typer.Exit(1)


def _said(one: JudgedRun | None) -> str:
    if one is None:
        return "left out: needs socketcan"
    return "; ".join(one.failures) or "as expected"


def _one(
    campaign: Campaign,
    spec: CampaignRunSpec,
    script: FaultScript,
    changes: list[str],
    interface: str | None,
    folder: Path,
    realtime: bool,
) -> JudgedRun | None:
    """Rehearse with one script; None: this interface cannot."""
    from bridge.deployment import spec as deploy
    from bridge.deployment.system import load_system
    from bridge.rehearsal.supervisor import Settings

    path = deploy.find(campaign.scenario, campaign.deploy)
    said = (*changes, *BusOptions(interface).settings(deploy.load(path)))
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
