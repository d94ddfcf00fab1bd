"""``cosim soak``: many short rehearsals with random faults, each evaluated."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bridge.cli.options import BusOptions, Interface, Realtime
from cosim.cli.options import Json, Quiet, Set, finite, write_json

if TYPE_CHECKING:
    from bridge.campaign.soak import SoakSetup
    from bridge.deployment.spec import Deployment


def soak(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (.toml).")],
    deploy: Annotated[
        str, typer.Option(help="Deployment: a file, or a name in deploy/ next to the scenario.")
    ] = "zenoh",
    hours: Annotated[
        float, typer.Option(callback=finite, min=0.0, help="Total time of all runs, h.")
    ] = 1.0,
    run: Annotated[str, typer.Option(help="Duration of one run.")] = "20 s",
    parallel: Annotated[
        int,
        typer.Option(
            min=1, help="Number of parallel runs, if each has its own network namespaces."
        ),
    ] = 2 * (os.cpu_count() or 1),
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random faults.")] = 0,
    faults: Annotated[
        Path | None,
        typer.Option(
            help="File with the faults to draw from.",
            show_default="faults/soak.toml next to the scenario",
        ),
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the results; an unfinished soak test continues there.",
            show_default="runs/soak-SCENARIO-DEPLOYMENT",
        ),
    ] = None,
    network: Annotated[
        bool,
        typer.Option(
            "--network/--no-network", help="Emulate a network between hosts, with faults."
        ),
    ] = True,
    retry: Annotated[bool, typer.Option("--retry", help="Repeat the runs that failed.")] = False,
    keep: Annotated[
        bool, typer.Option("--keep", help="Keep the run folders of runs that passed, too.")
    ] = False,
    set_: Set = None,
    interface: Interface = None,
    realtime: Realtime = True,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Run a soak test: many rehearsals with random faults, several at once.

    Each run is checked: no process crashed, every fault is in the report, torques stayed in bounds,
    the replay equals the run, and the arms synchronized or stopped safely. The same command
    continues an interrupted soak test. Exit status 1 if any check failed.
    """
    from bridge.campaign import page, table
    from bridge.campaign.soak_driver import SUMMARY, count
    from cosim.base.convert import number
    from cosim.cli.show import aligned
    from cosim.cli.summary import this_command

    seconds = number(run, "s", "--run")
    job = _job(scenario, deploy, seconds, seed, faults, folder, network, keep, set_, interface)
    job, why = _fit_to_machine(job, realtime)
    if why:
        typer.echo(f"the runs are sequential and have no network faults: {why}", err=True)
    records = _driven(job, count(hours, seconds), parallel if job.hosted else 1, retry, quiet)
    kinds, title = table.kinds(records), job.soak.spec.title or "Soak"
    if not quiet:
        typer.echo("\n".join(aligned(kinds)))
        typer.echo("\n" + "\n".join(aligned(table.facts(records))))
    path = job.folder / SUMMARY
    path.write_text(table.markdown(records, title), encoding="utf-8")
    report = page.write_many(records, kinds, title, job.folder, this_command())
    if json is not None:
        write_json(json, page.many_as_data(records, job.folder))
    wrong = table.failures(records)
    for line in wrong:
        typer.echo(f"not passed: {line}", err=True)
    if not quiet:
        typer.echo(f"{'report':<16} {report}")
        typer.echo(f"{'folder':<16} {job.folder}")
    if wrong:
        raise typer.Exit(1)


def _job(
    scenario: Path,
    deploy: str,
    seconds: float,
    seed: int,
    faults: Path | None,
    folder: Path | None,
    network: bool,
    keep: bool,
    set_: list[str] | None,
    interface: str | None,
) -> SoakSetup:
    """The soak test that was asked for. Raises ScenarioError."""
    from bridge.campaign.soak import SoakSetup
    from bridge.campaign.soak_spec import load_soak
    from bridge.deployment import spec as deployments
    from cosim.base.errors import ScenarioError

    path = deployments.find(scenario, deploy)
    drawn = load_soak(scenario, faults)
    if seconds <= drawn.last:
        raise ScenarioError(
            f"--run {seconds:g} s: faults may last until {drawn.last:g} s; expected more",
            str(drawn.path),
        )
    said = BusOptions(interface).settings(deployments.load(path))
    changes = (*drawn.spec.settings, *said, *(set_ or []), f"run.stop={seconds}")
    name = f"soak-{scenario.stem}-{path.stem}"
    return SoakSetup(
        scenario.resolve(), path.resolve(), changes, drawn,
        (folder or Path("runs") / name).resolve(), seed, True, network, keep=keep,
    )  # fmt: skip


def _fit_to_machine(job: SoakSetup, realtime: bool) -> tuple[SoakSetup, str]:
    """The job as this machine can do it, and why that is less, if it is."""
    from dataclasses import replace

    from bridge.deployment.system import load_system
    from bridge.rehearsal import hosts

    system = load_system(job.scenario, str(job.deployment), job.changes)
    why = _own_bus(system.deployment) or hosts.missing()
    network = job.network and not why and len(hosts.groups(system)) > 1
    return replace(job, hosted=not why, network=network, realtime=realtime), why


def _own_bus(deployment: Deployment) -> str:
    """The CAN bus that is this machine's and no other's, as a reason; "": none."""
    for name, bus in deployment.buses.items():
        if bus.kind == "can" and bus.interface != "udp_multicast":
            return f"bus {name} is {bus.interface}; -i udp_multicast is there for each run anew"
    return ""


def _driven(
    job: SoakSetup, runs: int, parallel: int, retry: bool, quiet: bool
) -> list[dict[str, object]]:
    from bridge.campaign.soak_driver import soak as drive
    from cosim.cli.sweep import interrupted, progress_of, stopping
    from cosim.study.runner import Observer

    with progress_of(quiet) as progress:
        try:
            observer = Observer(
                lambda b: progress.begin(b, job.soak.spec.title, "runs"), progress.done, stopping
            )
            return drive(job, runs, parallel, retry, observer)
        except KeyboardInterrupt:
            raise interrupted(progress, job.folder, "the same command") from None
