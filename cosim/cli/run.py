"""``cosim run``: a scenario, offline, as fast as the machine allows."""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cosim.base.copies import replace
from cosim.base.parts import part
from cosim.base.units import time_text
from cosim.cli.options import OutputOptions, RunSettings, wall_seconds, write_json

if TYPE_CHECKING:
    from cosim.base.errors import RunError
    from cosim.checkpoint import CheckpointInterval, CheckpointKeeper
    from cosim.engine.simulate import RunOutcome
    from cosim.measure.robustness import Robustness
    from cosim.record import Run
    from cosim.scenario.spec import Scenario
    from cosim.schedule.plan import Plan


class RunOptions(OutputOptions, frozen=True):
    """The data that a run reads and writes, and its way to run."""

    table: Annotated[
        Path | None,
        typer.Option(
            "--input", metavar="FILE", help="Feed the inputs of a single FMU from a table (.csv)."
        ),
    ] = None
    links: Annotated[
        Path | None,
        typer.Option(metavar="RUN", help="Use the recorded link delays and losses of this run."),
    ] = None
    csv: Annotated[bool, typer.Option("--csv", help="Also write trajectories.csv.")] = False
    fmu_log: Annotated[
        bool, typer.Option("--fmu-log", help="Write the log of every FMU to NAME.fmu.log.")
    ] = False
    live: Annotated[
        bool | None,
        typer.Option(
            "--live/--no-live",
            help="Let readers of report.html move values and run the scenario again; default: if "
            "it can be, in 2.5 MB.",
        ),
    ] = None
    threads: Annotated[
        int, typer.Option(min=1, max=256, help="Threads that share many FMUs; same results.")
    ] = 1
    checkpoint: Annotated[
        str | None,
        typer.Option(
            metavar="TIME",
            help="Save the state at such intervals of wall time (60s), or of the run (t=10s).",
        ),
    ] = None
    resume: Annotated[
        Path | None,
        typer.Option(metavar="RUN", help="Continue the run of this folder from its checkpoint."),
    ] = None
    deploy: Annotated[
        str | None,
        typer.Option(
            "--deploy", help="Simulate this deployment: nodes, codecs and buses (the twin)."
        ),
    ] = None
    clock: Annotated[
        str,
        typer.Option(
            "--clock", help="Clock of --deploy: simulated (for real time: cosim rehearse)."
        ),
    ] = "simulated"


def run(
    settings: RunSettings,
    options: RunOptions,
    scenario: Annotated[
        Path | None,
        typer.Argument(help="Scenario (.toml), system of another tool (.ssp), or FMU (.fmu)."),
    ] = None,
) -> None:
    """Run a scenario; write trajectories, metadata, link tables and a report to a folder."""
    from cosim.base.errors import ScenarioError
    from cosim.cli.check import print_warnings
    from cosim.cli.summary import check, exit_unless_passed, header, this_command
    from cosim.engine.simulate import columns
    from cosim.record import Run

    keeper = None
    if options.resume is not None:
        scenario, settings, options, keeper = _resumed(scenario, settings, options)
    if scenario is None:
        raise typer.BadParameter("found no scenario; expected cosim run SCENARIO, or --resume RUN")
    if options.live:
        _check_live(options)
    if options.checkpoint is not None and keeper is None:
        keeper = _keeper(scenario, settings, options)
    if options.deploy is not None:
        if options.links is not None:
            raise ScenarioError("--links is for runs without nodes; expected no --deploy with it")
        part("twin").run(scenario, settings.all, options)
        return
    loaded, plan = _read(scenario, settings, options)
    recorded = columns(plan, loaded.run.record.signals, loaded.place("run.record.signals"))
    check(loaded, recorded)
    if not recorded:
        typer.echo(
            "warning: no component has an output, so only the time is recorded; --record all "
            "records all variables",
            err=True,
        )
    report = None
    if options.plot and options.live is not False:
        again = shlex.join(["cosim", "run", str(scenario), *_repeated(settings, options)])
        report = _live_report(loaded, plan, settings.all, again, options)
    folder = options.folder(loaded.name)
    options.say(header(loaded, plan))
    found = print_warnings(
        loaded, plan, strict=options.strict, quiet=options.quiet, computed=options.strict
    )
    command = this_command() if keeper is None else keeper.command
    outcome = _simulated(
        loaded, plan, folder, {"command": command, **found}, options, report, keeper
    )
    _print_notes(outcome, plan, options)
    judged = _finish(loaded, Run.open(folder), outcome, found.get("limits", {}), options, report)
    if keeper is not None:
        keeper.end()
    if options.strict:
        exit_unless_passed(judged)


def _check_live(options: RunOptions) -> None:
    """Refuse options that a live report cannot go with. Raises ScenarioError."""
    from cosim.base.errors import ScenarioError

    given = {"--no-plot": not options.plot, "--deploy": options.deploy is not None,
             "--links": options.links is not None}  # fmt: skip
    for name, found in given.items():
        if found:
            raise ScenarioError(f"found --live with {name}; expected one of them")


def _keeper(scenario: Path, settings: RunSettings, options: RunOptions) -> CheckpointKeeper:
    """The object that keeps the state of a run. Raises ScenarioError."""
    from cosim.base.errors import ScenarioError
    from cosim.checkpoint import CheckpointKeeper
    from cosim.cli.summary import this_command

    if options.deploy is not None:
        raise ScenarioError("found --checkpoint with --deploy, whose nodes are not saved")
    given = {
        "command": this_command(), "place": os.getcwd(), "scenario": str(scenario),
        "settings": settings.all, "threads": options.threads, "fmu_log": options.fmu_log,
        "table": None if options.table is None else str(options.table),
        "links": None if options.links is None else str(options.links),
    }  # fmt: skip
    return CheckpointKeeper(_interval(options.checkpoint or ""), given)


def _interval(text: str) -> CheckpointInterval:
    """The interval of ``--checkpoint``: ``60s`` of wall time, ``t=10s`` of the run.

    Raises ScenarioError.
    """
    from cosim.base.errors import ScenarioError
    from cosim.checkpoint import CheckpointInterval

    simulated = text.startswith("t=")
    time = wall_seconds(text.removeprefix("t="), "--checkpoint")
    if simulated and not time:
        raise ScenarioError(f"found {text!r}, expected a time such as t=10s", "--checkpoint")
    return CheckpointInterval(time, simulated)


def _resumed(
    scenario: Path | None, settings: RunSettings, options: RunOptions
) -> tuple[Path, RunSettings, RunOptions, CheckpointKeeper]:
    """The command that began the run of a folder, with what shows its result as given here.

    Raises ScenarioError.
    """
    from cosim.base.errors import ScenarioError
    from cosim.checkpoint import CheckpointInterval, CheckpointKeeper, Resumption

    assert options.resume is not None
    usual = RunOptions()
    kept = ("out", "force", "table", "links", "fmu_log", "threads", "deploy", "clock")
    words = [f"--{name.replace('_', '-')}" for name in kept
             if getattr(options, name) != getattr(usual, name)]  # fmt: skip
    words += ["a scenario"] * (scenario is not None) + settings.all
    if words:
        raise ScenarioError(
            f"found {', '.join(words)} with --resume; expected it alone, or with --checkpoint and "
            "options of the output, since the run continues as it began"
        )
    found = Resumption.open(options.resume)
    given = found.given
    if os.getcwd() != given["place"]:
        raise ScenarioError(
            f"the run began in {given['place']}; expected --resume to be called there",
            str(options.resume),
        )
    if found.note:
        typer.echo(f"note: {found.note}; the checkpoint before it is used", err=True)
    options.say(f"resumed at t = {found.time:.6g} s: {given['command']}")
    table, links = (None if given[x] is None else Path(given[x]) for x in ("table", "links"))
    begun = replace(
        options, out=options.resume, table=table, links=links, threads=given["threads"],
        fmu_log=given["fmu_log"],
    )  # fmt: skip
    interval = CheckpointInterval(*found.found.facts["interval"])
    if options.checkpoint is not None:
        interval = _interval(options.checkpoint)
    keeper = CheckpointKeeper(interval, given, found)
    return Path(given["scenario"]), RunSettings(set_=given["settings"]), begun, keeper


def _repeated(settings: RunSettings, options: RunOptions) -> Iterator[str]:
    """The options of a command that computes the same run."""
    if options.table is not None:
        yield from ("--input", str(options.table))
    if options.live:
        yield "--live"
    for setting in settings.all:
        yield from ("--set", setting)


def _live_report(
    loaded: Scenario, plan: Plan, given: Sequence[str], again: str, options: RunOptions
) -> Callable[[Run], Path]:
    """The function that writes the report of a run, which the command `again` repeats.

    It is live if it can be. `given`: the settings of the scenario. Raises LiveError with the
    component that no page can compute, if a live report was asked for; if not, nothing is done
    before the run.
    """
    asked = None
    if options.live:
        from cosim.live import bundle

        asked = bundle(loaded, given, plan)

    def make() -> Mapping[str, Any]:
        from cosim.live import LiveError, bundle

        if options.links is not None:
            raise LiveError("its links have the delays of another run (--links)")
        return bundle(loaded, given, plan, asked=False) if asked is None else asked

    def write(run: Run) -> Path:
        from cosim.live.page import write_if_live
        from cosim.measure.metric_result import summary_line
        from cosim.record.digest import digest

        found = digest(run)
        path, reason = write_if_live(run, make, again, found)
        if not reason:
            options.say(summary_line("digest", found))
        elif options.live:
            typer.echo(f"warning: the report is not live: {reason}", err=True)
        return path

    return write


def _read(scenario: Path, settings: RunSettings, options: RunOptions) -> tuple[Scenario, Plan]:
    from cosim.cli.summary import announced
    from cosim.loading.files import load
    from cosim.scenario.assemble import assemble
    from cosim.scenario.spec import logging

    with announced(options.quiet, f"reading {scenario}"):
        loaded = load(scenario, settings.all, options.table)
        if options.fmu_log:
            loaded = logging(loaded)
        plan = assemble(loaded)
        if options.links is not None:
            from cosim.scenario.recorded import with_recorded_links

            plan = with_recorded_links(plan, options.links)
        return loaded, plan


def _simulated(
    loaded: Scenario,
    plan: Plan,
    folder: Path,
    further: dict[str, Any],
    options: RunOptions,
    report: Callable[[Run], Path] | None,
    keeper: CheckpointKeeper | None,
) -> RunOutcome:
    """The outcome of the run. Ends the command when it is interrupted."""
    from cosim.base.errors import Interrupted, RunError
    from cosim.base.interrupts import exit_code
    from cosim.cli.summary import progress_bar
    from cosim.engine.simulate import Execution, simulate

    execution = Execution(options.threads, keeper)
    try:
        with progress_bar(options.quiet) as progress:
            return simulate(
                loaded, folder, progress, plan,
                force=options.force, further=further, execution=execution,
            )  # fmt: skip
    except Interrupted as stop:
        typer.echo(f"{stop}; recorded until then: {stop.saved}", err=True)
        if keeper is not None:
            typer.echo(f"to continue: cosim run --resume {shlex.quote(stop.saved)}", err=True)
        raise typer.Exit(exit_code()) from None
    except RunError as error:
        _picture_failure(error, loaded, options, report)
        raise


def _print_notes(outcome: RunOutcome, plan: Plan, options: RunOptions) -> None:
    """Print what did not go as the user may expect, to standard error."""
    from cosim.cli.summary import late_ticks

    notes = late_ticks(outcome)
    threads = options.threads
    if threads > 1 and not outcome.shared:
        text = (
            f"note: found nothing that {threads} threads could share; expected 32 or more FMUs or"
            " groups of FMUs that do not wait for each other in a tick (docs/scale.md)"
        )
        notes = [text, *notes]
    for line in notes if not options.quiet else ():
        typer.echo(line, err=True)
    if outcome.ended is not None:
        options.say(f"{outcome.ended}, of {time_text(plan.end)}")


def _finish(
    loaded: Scenario,
    result: Run,
    outcome: RunOutcome,
    limits: dict[str, Any],
    options: RunOptions,
    report: Callable[[Run], Path] | None,
) -> Sequence[Robustness]:
    """Print the numbers of a run; write its table, pictures and sums. Its requirements."""
    from cosim.cli.summary import announced, as_data, pictures, summary
    from cosim.measure import requirements
    from cosim.measure.joint_limits import beyond
    from cosim.measure.metric_result import summary_line
    from cosim.record import seal
    from cosim.record.folder import CSV

    folder = result.path.parent
    judged = requirements.of_run(loaded, result)
    requirements.keep(folder, judged)
    for line in summary(loaded, result, outcome, judged):
        options.say(line)
    for line in beyond(limits, result):
        typer.echo(f"warning: {line}", err=True)
    if options.csv:
        result.to_csv(folder / CSV)
    with announced(options.quiet, "drawing what was recorded"):
        drawn = list(pictures(loaded, result, options, report))
    for what, path in drawn:
        options.say(summary_line(what, str(path)))
    seal(folder)
    if options.json is not None:
        from cosim.record.digest import digest

        found = {**as_data(loaded, result, outcome, judged), "digest": digest(result)}
        write_json(options.json, "run", found)
    options.say(summary_line("run folder", str(folder)))
    return judged


def _picture_failure(
    error: RunError,
    scenario: Scenario,
    wanted: OutputOptions,
    report: Callable[[Run], Path] | None,
) -> None:
    """Write report and figures of a run that failed, as far as it was recorded."""
    from cosim.base.errors import CosimError
    from cosim.cli.summary import pictures, requirement_lines
    from cosim.measure import requirements
    from cosim.record import Run, seal

    if error.saved:
        with suppress(CosimError):
            folder = Path(error.saved)
            judged = requirements.of_run(scenario, Run.open(folder))
            requirements.keep(folder, judged)
            for line in requirement_lines(judged):
                wanted.say(line)
            found = [path for _, path in pictures(scenario, Run.open(folder), wanted, report)]
            seal(folder, changed=[path.name for path in found])
