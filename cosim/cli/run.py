"""``cosim run``: a scenario, offline, as fast as the machine allows."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cosim.base.parts import part
from cosim.cli.numbers import finite
from cosim.cli.options import Force, Json, Pdf, Png, Quiet, Report, Strict

if TYPE_CHECKING:
    from cosim.base.errors import RunError
    from cosim.scenario.spec import Scenario


def run(
    scenario: Annotated[
        Path, typer.Argument(help="Scenario (.toml), system of another tool (.ssp), or FMU (.fmu).")
    ],
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="PATH=VALUE",
            help="Change a value, e.g. components.master.parameters.k_p=20 (of a single FMU: "
            "m=2); repeatable.",
        ),
    ] = None,
    stop: Annotated[
        str | None, typer.Option(metavar="TIME", help='Stop time (run.stop), e.g. 10 or "500 ms".')
    ] = None,
    start: Annotated[
        str | None, typer.Option(metavar="TIME", help="Time at which the run begins (run.start).")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of links and topology (run.seed).")] = None,
    record: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SIGNAL",
            help="Record these signals only (run.record.signals), e.g. plant.x, 'plant.*' or all, "
            "also variables of FMUs that are no outputs; repeatable.",
        ),
    ] = None,
    table: Annotated[
        Path | None,
        typer.Option(
            "--input", metavar="FILE", help="Feed the inputs of a single FMU from a table (.csv)."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Run folder to write. Default: runs/SCENARIO-DATE-TIME.")
    ] = None,
    force: Force = False,
    csv: Annotated[bool, typer.Option("--csv", help="Also write trajectories.csv.")] = False,
    plot: Report = True,
    png: Png = False,
    pdf: Pdf = False,
    estimate_error: Annotated[
        bool,
        typer.Option(
            "--estimate-error", help="Estimate the local error of the steps after the run."
        ),
    ] = False,
    tolerance: Annotated[
        float,
        typer.Option(
            callback=finite,
            help="Target local error, as a fraction, for the recommended step size.",
        ),
    ] = 1e-4,
    links: Annotated[
        Path | None,
        typer.Option(metavar="RUN", help="Use the recorded link delays and losses of this run."),
    ] = None,
    deploy: Annotated[
        str | None,
        typer.Option(
            "--deploy", help="Simulate this deployment: nodes, codecs and buses (the twin)."
        ),
    ] = None,
    clock: Annotated[
        str,
        typer.Option(
            "--clock", help="Clock of --deploy: simulated (for real time: cosim rehearse)."
        ),
    ] = "simulated",
    fmu_log: Annotated[
        bool, typer.Option("--fmu-log", help="Write the log of every FMU to NAME.fmu.log.")
    ] = False,
    threads: Annotated[
        int,
        typer.Option(min=1, max=256, help="Threads that share many FMUs; same results."),
    ] = 1,
    strict: Strict = False,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Run a scenario; write trajectories, metadata, link tables and a report to a folder."""
    from cosim.base.clock import stamp
    from cosim.base.errors import Interrupted, RunError, ScenarioError
    from cosim.base.interrupts import exit_code
    from cosim.base.settings import as_toml
    from cosim.cli.check import print_warnings
    from cosim.cli.json_file import write_json
    from cosim.cli.summary import (
        announced,
        as_data,
        check,
        header,
        late_ticks,
        pictures,
        progress_bar,
        summary,
        this_command,
    )
    from cosim.cli.supervise import announce_run_folder
    from cosim.engine.simulate import columns, simulate
    from cosim.loading.files import load
    from cosim.measure.joint_limits import beyond
    from cosim.record import Run, seal
    from cosim.record.folder import CSV
    from cosim.scenario.assemble import assemble
    from cosim.scenario.recorded import with_recorded_links
    from cosim.scenario.spec import logging

    settings = [*(set_ or []), *([f"run.seed={seed}"] if seed is not None else [])]
    settings += [f"run.start={start}"] if start is not None else []
    settings += [f"run.stop={stop}"] if stop is not None else []
    settings += [f"run.record.signals={as_toml(record)}"] if record else []
    if deploy is not None:
        if links is not None:
            raise ScenarioError("--links is for runs without nodes; expected no --deploy with it")
        twin = part("twin")
        twin.run(
            scenario, deploy, clock, settings, out,
            force=force, report=plot, png=png, pdf=pdf, strict=strict, quiet=quiet, json=json,
        )  # fmt: skip
        return
    with announced(quiet, f"reading {scenario}"):
        loaded = load(scenario, settings, table)
        if fmu_log:
            loaded = logging(loaded)
        plan = assemble(loaded) if links is None else with_recorded_links(assemble(loaded), links)
    recorded = columns(plan, loaded.run.record.signals, loaded.place("run.record.signals"))
    check(loaded, recorded)
    if not recorded:
        typer.echo(
            "warning: no component has an output, so only the time is recorded; --record all "
            "records all variables",
            err=True,
        )
    folder = out or _unused_folder(Path("runs") / f"{loaded.name}-{stamp()}")

    def say(text: str) -> None:
        if not quiet:
            typer.echo(text)

    announce_run_folder(folder)
    say(header(loaded, plan))
    found = print_warnings(loaded, plan, strict=strict, quiet=quiet)
    further = {"command": this_command(), **found}
    try:
        with progress_bar(quiet) as progress:
            outcome = simulate(
                loaded, folder, progress, plan, force=force, further=further, threads=threads
            )
    except Interrupted as stop:
        typer.echo(f"{stop}; recorded until then: {stop.saved}", err=True)
        raise typer.Exit(exit_code()) from None
    except RunError as error:
        _picture_failure(error, loaded, report=plot, png=png, pdf=pdf)
        raise
    if threads > 1 and not outcome.shared and not quiet:
        typer.echo(
            f"note: found nothing that {threads} threads could share; expected 32 or more FMUs or"
            " groups of FMUs that do not wait for each other in a tick (docs/scale.md)",
            err=True,
        )
    for line in late_ticks(outcome) if not quiet else ():
        typer.echo(line, err=True)
    if outcome.ended is not None:
        say(f"{outcome.ended}, of {plan.end:g} s")
    result = Run.open(folder)
    for line in summary(loaded, result, outcome):
        say(line)
    for line in beyond(found.get("limits", {}), result):
        typer.echo(f"warning: {line}", err=True)
    if csv:
        result.to_csv(folder / CSV)
    for line in _errors(loaded, tolerance, folder) if estimate_error else ():
        say(line)
    with announced(quiet, "drawing what was recorded"):
        drawn = list(pictures(loaded, result, report=plot, png=png, pdf=pdf))
    for what, path in drawn:
        say(f"{what:<16} {path}")
    seal(folder)
    if json is not None:
        write_json(json, as_data(loaded, result, outcome))
    say(f"{'run folder':<16} {folder}")


def _picture_failure(error: RunError, scenario: Scenario, **drawn: bool) -> None:
    """Write report and figures of a run that failed, as far as it was recorded."""
    from cosim.base.errors import CosimError
    from cosim.cli.summary import pictures
    from cosim.record import Run, seal

    if error.saved:
        with suppress(CosimError):
            folder = Path(error.saved)
            found = [path for _, path in pictures(scenario, Run.open(folder), **drawn)]
            seal(folder, changed=[path.name for path in found])


def _errors(scenario: Scenario, tolerance: float, folder: Path) -> list[str]:
    """Two more runs of the scenario, which estimate errors and record nothing."""
    from cosim.cli.estimate import lines, write
    from cosim.estimate.local_error import estimate
    from cosim.scenario.assemble import assemble

    found = estimate(lambda: assemble(scenario), tolerance=tolerance)
    write(found, folder)
    return lines(found)


def _unused_folder(folder: Path) -> Path:
    """`folder`, or with -2, -3, ... behind it: two runs may start in one second."""
    n = 1
    path = folder
    while path.exists():
        n += 1
        path = folder.with_name(f"{folder.name}-{n}")
    return path
