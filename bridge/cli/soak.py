"""``cosim soak``: many short rehearsals with random faults, each evaluated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bridge.cli.options import ChangeOptions, Realtime
from cosim.cli.options import PROCESSORS, ResultOptions, Retry, finite

if TYPE_CHECKING:
    from bridge.campaign.soak import SoakSetup
    from bridge.deployment.spec import Deployment


class SoakOptions(ChangeOptions, frozen=True):
    """The deployment of a soak test, its runs, and their faults."""

    deploy: Annotated[
        str, typer.Option(help="Deployment: a file, or a name in deploy/ next to the scenario.")
    ] = "zenoh"
    hours: Annotated[
        float, typer.Option(callback=finite, min=0.0, help="Total time of all runs, h.")
    ] = 1.0
    run: Annotated[str, typer.Option(help="Duration of one run.")] = "20 s"
    jobs: Annotated[
        int,
        typer.Option(
            "--jobs",
            "--parallel",
            min=1,
            help="Number of parallel runs, if each has its own network namespaces.",
        ),
    ] = 2 * PROCESSORS
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random faults.")] = 0
    faults: Annotated[
        Path | None,
        typer.Option(
            help="File with the faults to draw from.",
            show_default="faults/soak.toml next to the scenario",
        ),
    ] = None
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "--folder",
            help="Folder for the results; an unfinished soak test continues there.",
            show_default="runs/soak-SCENARIO-DEPLOYMENT",
        ),
    ] = None
    network: Annotated[
        bool,
        typer.Option(
            "--network/--no-network", help="Emulate a network between hosts, with faults."
        ),
    ] = True
    retry: Retry = False
    keep: Annotated[
        bool, typer.Option("--keep", help="Keep the run folders of runs that passed, too.")
    ] = False
    realtime: Realtime = True


def soak(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (.toml).")],
    options: SoakOptions,
    result: ResultOptions,
) -> None:
    """Run a soak test: many rehearsals with random faults, several at once.

    Each run is checked: no process crashed, every fault is in the report, torques stayed in bounds,
    the replay equals the run, and the arms synchronized or stopped safely. The same command
    continues an interrupted soak test. Exit status 1 if any check failed.
    """
    from bridge.campaign import soak_driver
    from cosim.base.convert import number
    from cosim.cli.sweep import watched

    seconds = number(options.run, "s", "--run")
    job, why = _fit_to_machine(_job(scenario, seconds, options))
    if why:
        typer.echo(f"the runs are sequential and have no network faults: {why}", err=True)
    runs, jobs = soak_driver.count(options.hours, seconds), options.jobs if job.hosted else 1
    title = job.soak.spec.title or "Soak"
    with watched(result.quiet, job.folder, title, "runs", "the same command") as observer:
        records = soak_driver.soak(job, runs, jobs, options.retry, observer)
    conclude(records, title, job.folder, result)


def conclude(
    records: Sequence[Mapping[str, Any]], title: str, folder: Path, result: ResultOptions
) -> None:
    """Print and write the table of many runs with faults; ends the command if one did not pass."""
    from bridge.campaign import page, table
    from bridge.campaign.soak_driver import SUMMARY
    from cosim.cli.show import aligned
    from cosim.cli.summary import this_command

    kinds = table.kinds(records)
    result.say("\n".join(aligned(kinds)))
    result.say("\n" + "\n".join(aligned(table.facts(records))))
    (folder / SUMMARY).write_text(table.markdown(records, title), encoding="utf-8")
    report = page.write_many(records, kinds, title, folder, this_command())
    result.save("soak", page.many_as_data(records, folder))
    for line in table.inconclusive(records):
        typer.echo(f"inconclusive: {line}", err=True)
    wrong = table.failures(records)
    for line in wrong:
        typer.echo(f"not passed: {line}", err=True)
    result.say(f"{'report':<16} {report}")
    result.say(f"{'folder':<16} {folder}")
    if wrong:
        raise typer.Exit(1)


def _job(scenario: Path, seconds: float, options: SoakOptions) -> SoakSetup:
    """The soak test that was asked for. Raises ScenarioError."""
    from bridge.campaign.soak import SoakSetup
    from bridge.campaign.soak_spec import load_soak
    from bridge.deployment import spec as deployments
    from cosim.base.errors import ScenarioError

    path = deployments.find(scenario, options.deploy)
    drawn = load_soak(scenario, options.faults)
    if seconds <= drawn.spec.last:
        raise ScenarioError(
            f"--run {seconds:g} s: faults may last until {drawn.spec.last:g} s; expected more",
            str(drawn.path),
        )
    said = options.settings(deployments.load(path))
    changes = (*drawn.spec.settings, *said, f"run.stop={seconds}")
    folder = options.out or Path("runs") / f"soak-{scenario.stem}-{path.stem}"
    return SoakSetup(
        scenario=scenario.resolve(),
        deployment=path.resolve(),
        changes=changes,
        soak=drawn,
        folder=folder.resolve(),
        seed=options.seed,
        hosted=True,
        network=options.network,
        realtime=options.realtime,
        keep=options.keep,
    )


def _fit_to_machine(job: SoakSetup) -> tuple[SoakSetup, str]:
    """The job as this machine can do it, and why that is less, if it is."""
    from bridge.deployment.system import load_system
    from bridge.rehearsal import hosts
    from cosim.base.copies import replace

    system = load_system(job.scenario, str(job.deployment), job.changes)
    why = own_bus(system.deployment) or hosts.missing()
    network = job.network and not why and len(hosts.groups(system)) > 1
    return replace(job, hosted=not why, network=network), why


def own_bus(deployment: Deployment) -> str:
    """The CAN bus that is this machine's and no other's, as a reason; "": none."""
    for name, bus in deployment.buses.items():
        if bus.kind == "can" and bus.interface != "udp_multicast":
            return f"bus {name} is {bus.interface}; -i udp_multicast is there for each run anew"
    return ""
