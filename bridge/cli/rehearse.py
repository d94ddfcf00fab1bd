"""``cosim rehearse``: a scenario on the wall clock, one process a node, over real buses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cosim.cli.options import Force, Json, Pdf, Png, Quiet, Report, Strict
from cosim.cli.supervise import allow_terminal_input, announce_run_folder

if TYPE_CHECKING:
    from bridge.deployment.system import System
    from bridge.rehearsal.supervisor import Settings
    from bridge.results.rehearsal_outcome import RehearsalOutcome
    from bridge.results.verdict import Verdict

Deploy = Annotated[
    str,
    typer.Option(
        "--deploy",
        show_default=False,
        help="Deployment: a file, or a name in deploy/ next to the scenario. Default: the "
        "scenario's name, or can.",
    ),
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="PATH=VALUE",
        help="Change a value of the scenario, or of the deployment: deploy.nodes.…; repeatable.",
    ),
]
Interface = Annotated[
    str | None,
    typer.Option(
        "--interface", "-i", help="python-can interface of all CAN buses; cosim: simulated."
    ),
]
Realtime = Annotated[
    bool,
    typer.Option(
        "--realtime/--no-realtime", help="Request real-time priority from the operating system."
    ),
]
Channel = Annotated[
    list[str] | None,
    typer.Option("--channel", "-c", metavar="BUS=CHANNEL", help="Channel of a bus; repeatable."),
]
Bitrate = Annotated[int | None, typer.Option("--bitrate", "-b", help="Bit rate, bit/s.")]
DataBitrate = Annotated[int | None, typer.Option(help="Bit rate of CAN FD data phases, bit/s.")]
Fd = Annotated[bool | None, typer.Option("--fd/--no-fd", help="CAN FD or classic CAN.")]


def rehearse(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (.toml).")],
    deploy: Deploy = "",
    set_: Set = None,
    seed: Annotated[int | None, typer.Option(help="Seed of links and topology.")] = None,
    interface: Interface = None,
    channel: Channel = None,
    bitrate: Bitrate = None,
    data_bitrate: DataBitrate = None,
    fd: Fd = None,
    latency: Annotated[
        bool,
        typer.Option(
            "--latency/--no-latency",
            help="Add the link delays of the scenario to those of the bus.",
        ),
    ] = True,
    nodes: Annotated[
        str | None,
        typer.Option(metavar="A,B", help="Start these nodes only; the others are already running."),
    ] = None,
    clock: Annotated[
        str,
        typer.Option(
            help="Clock: wall, simulated (the time of simulated CAN buses, with -i cosim), or "
            "lockstep (as fast as samples arrive; Zenoh only)."
        ),
    ] = "wall",
    faults: Annotated[
        Path | None,
        typer.Option(metavar="SCRIPT", help="Fault script: faults to inject (see docs/faults.md)."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Run folder to write. Default: a new folder in runs/.")
    ] = None,
    force: Force = False,
    twin: Annotated[
        bool, typer.Option("--twin/--no-twin", help="Compare with the simulated twin.")
    ] = True,
    log: Annotated[
        list[str] | None,
        typer.Option(
            "--log",
            metavar="FORMAT",
            help="Format of the bus logs: log (candump), blf, asc or mf4.",
        ),
    ] = None,
    realtime: Realtime = True,
    hardware: Annotated[
        bool,
        typer.Option(
            "--hardware", help="Allow frames that can move real drives; asks for confirmation."
        ),
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask for confirmation.")] = False,
    plot: Report = True,
    png: Png = False,
    pdf: Pdf = False,
    strict: Strict = False,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Run a scenario in real time, one process per node, on real buses; then check the run.

    Exit status 1 if the run failed: a node stopped early, the replay differs from the run, samples
    were received that were not sent, or an injected fault is not in the report. Exit status 3 if
    the result is inconclusive because this machine was too slow.
    """
    from bridge.cli.options import bus_settings, clock_settings, refuse_in_simulated_time
    from bridge.deployment import spec as deployments
    from bridge.deployment.system import load_system

    path = deployments.find(scenario, deploy)
    changes = [*(set_ or [])]
    changes += [f"run.seed={seed}"] if seed is not None else []
    changes += [] if latency else ["deploy.latency=false"]
    changes += clock_settings(deployments.load(path), clock)
    changes += bus_settings(
        deployments.load(path), interface, channel or [], bitrate, data_bitrate, fd
    )
    system = load_system(scenario, str(path), changes)
    refuse_in_simulated_time(
        system.deployment, faults=faults is not None, nodes=nodes is not None, hardware=hardware
    )
    found = checked(system, scenario, changes, strict=strict, quiet=quiet)
    if hardware and not yes:
        with allow_terminal_input():
            typer.confirm("Frames of this run may move real drives. Go on?", abort=True)
    from bridge.rehearsal.supervisor import Settings

    settings = Settings(
        scenario=scenario, deployment=path, changes=tuple(changes), realtime=realtime,
        real=hardware, script=str(faults) if faults else "", nodes=_selected_nodes(system, nodes),
        say=(lambda text: None) if quiet else typer.echo,
    )  # fmt: skip
    _run(
        system,
        settings,
        _folder(system, out),
        force,
        twin,
        tuple(log or ("log",)),
        {"report": plot, "png": png, "pdf": pdf},
        found,
        quiet,
        json,
    )


def _selected_nodes(system: System, nodes: str | None) -> tuple[str, ...]:
    """Nodes that are named; none: all. Raises ScenarioError for one that is not there."""
    from cosim.base.errors import ScenarioError

    named = tuple(name.strip() for name in nodes.split(",")) if nodes else ()
    for name in named:
        if name not in system.nodes:
            known = ", ".join(system.nodes)
            raise ScenarioError(f"--nodes: no node {name!r}; there are: {known}")
    return named


def _folder(system: System, out: Path | None) -> Path:
    from bridge.cli.options import unused_folder
    from cosim.base.clock import stamp

    name = f"{system.scenario.name}-{system.deployment.name}-{stamp()}"
    return out or unused_folder(Path("runs") / name)


def _run(
    system: System,
    settings: Settings,
    folder: Path,
    force: bool,
    twin: bool,
    formats: tuple[str, ...],
    drawn: Mapping[str, bool],
    found: list[dict[str, Any]],
    quiet: bool,
    json: Path | None,
) -> None:
    from dataclasses import replace

    from bridge.faults.load import load
    from bridge.preflight import host
    from bridge.rehearsal import injector
    from bridge.rehearsal.supervisor import Rehearsal
    from bridge.results.data import as_data
    from bridge.results.outcome import begin, clear, complete
    from cosim.base.errors import Interrupted
    from cosim.base.interrupts import exit_code
    from cosim.cli.json_file import write_json
    from cosim.cli.summary import progress_bar, this_command
    from cosim.record import claim_folder, held_folder

    host.check(system, settings.nodes)
    script = load(Path(settings.script)) if settings.script else None
    if script is not None:
        settings = replace(settings, events=injector.events(script, system))
    with held_folder(folder):
        if force:
            clear(folder)
        announce_run_folder(folder)
        claim_folder(folder, force=force)
        if not quiet:
            typer.echo(header(system))
        facts = {
            "settings": list(settings.changes), "faults": settings.script, "real": settings.real,
            "command": this_command(), "findings": found,
        }  # fmt: skip
        begin(system, folder, facts)
        interrupted = False
        with Rehearsal(system, settings, folder) as rehearsal:
            try:
                with progress_bar(quiet) as progress:
                    rehearsal.run(lambda t, end: progress(round(t * 1e3), round(end * 1e3)))
            except Interrupted:
                interrupted = True
            rehearsal.end()
            outcome = complete(
                system, folder, rehearsal.ended, facts,
                with_twin=twin, formats=formats, script=script,
            )  # fmt: skip
        verdict = _say(system, outcome, drawn, quiet)
        if json is not None:
            write_json(json, as_data(system, outcome))
        if interrupted:
            typer.echo(f"interrupted; recorded until then: {folder}", err=True)
            raise typer.Exit(exit_code())
        if verdict.exit_code:
            raise typer.Exit(verdict.exit_code)


def checked(
    system: System, path: Path, settings: Sequence[str], *, strict: bool, quiet: bool
) -> list[dict[str, Any]]:
    """Check scenario and deployment, as ``cosim check --deploy`` does; print and return what
    :func:`report_findings` does. Errors of the scenario alone do not prevent a run.

    The scenario at `path` with `settings` is checked as it is offline: what the deployment adds to
    it, such as limits of age, is judged with the deployment.
    """
    from bridge.preflight import deployment
    from cosim.cli.check import print_warnings
    from cosim.loading.files import load
    from cosim.scenario.assemble import assemble

    alone = load(path, [s for s in settings if not s.startswith("deploy.")])
    found = print_warnings(alone, assemble(alone), strict=strict, quiet=quiet)["findings"]
    more = [f for f in deployment.check(system) if f.as_data() not in found]
    return [*found, *report_findings(more, strict=strict, quiet=quiet)]


def report_findings(findings: object, *, strict: bool, quiet: bool) -> list[dict[str, Any]]:
    """Print the warnings of a check, unless `quiet`; return them as data, for ``run.json``.

    Raises ScenarioError if there is an error, or with `strict` a warning.
    """
    from collections.abc import Iterable
    from typing import cast

    from cosim.base.errors import ScenarioError
    from cosim.checks import Finding

    found = list(cast(Iterable[Finding], findings))
    serious = ("error", "warning") if strict else ("error",)
    errors = [f for f in found if f.severity in serious]
    for f in found:
        if f.severity == "warning" and not quiet:
            typer.echo(f"check: {f.line}", err=True)
    if errors:
        raise ScenarioError("; ".join(f.line for f in errors))
    return [f.as_data() for f in found if f.severity == "warning"]


def rewrite_report(folder: Path) -> Path:
    """Write the report of a rehearsal again, from its files. Raises CosimError."""
    from bridge.cli.replay import recorded_system
    from bridge.results.outcome import reopen
    from bridge.results.page import describe

    system = recorded_system(folder)
    return describe(system, reopen(system, folder))


def header(system: System) -> str:
    """The line that says what is about to run."""
    d = system.deployment
    nodes = ", ".join(f"{n} ({1 / p.h:g} Hz)" for n, p in system.nodes.items())
    buses = ", ".join(
        f"{n} = {b.interface} {b.channel}" if b.kind == "can" else f"{n} = Zenoh"
        for n, b in d.buses.items()
    )
    length = system.plan.ticks * system.plan.h
    clock = "in simulated time" if d.clock == "simulated" else "on the wall clock"
    return f"{system.scenario.title}\n{d.title}: {nodes}; {buses}; {length:g} s {clock}"


def _say(
    system: System, outcome: RehearsalOutcome, drawn: Mapping[str, bool], quiet: bool
) -> Verdict:
    from bridge.realtime.lateness import draw
    from bridge.results import verdict as verdicts
    from bridge.results.outcome import lines, metric_lines
    from bridge.results.page import write_page
    from bridge.results.report import line
    from cosim.cli.summary import pictures
    from cosim.record import Run, seal

    run = Run.open(outcome.folder)
    said = [*metric_lines(system, outcome, run), *lines(system, outcome)]
    found = verdicts.judge(system, outcome)
    if drawn["report"]:
        said.append(line("report", str(write_page(system, run, outcome, found, said))))
    figures = pictures(system.scenario, run, **{**drawn, "report": False})
    said += [line(what, str(path)) for what, path in figures]
    if drawn["png"]:
        late = {str(r.life): r.lateness for r in outcome.reports}
        said.append(line("figure", str(draw(late, outcome.folder / "lateness.png"))))
    seal(outcome.folder)
    said.append(line("verdict", found.text(success_text(outcome))))
    said.append(line("run folder", str(outcome.folder)))
    if not quiet:
        typer.echo("\n".join(said))
    elif found.exit_code:
        typer.echo(f"error: {found.text()}", err=True)
    return found


def success_text(outcome: RehearsalOutcome) -> str:
    """The summary of a run that passed."""
    from bridge.records.records import Gone, LifeEnd

    missed = sum(r.lateness.missed for r in outcome.reports)
    slots = sum(r.slots for r in outcome.reports)
    share = f"{missed} of {slots} slots missed" if missed else "no slot missed"
    ended = [n.detail for n in outcome.notes if isinstance(n, Gone) and n.end is LifeEnd.ENDED]
    how = "; ".join(ended) or "every node finished"
    return f"{how}, {share}, replays exactly"
