"""``cosim rehearse``: a scenario on the wall clock, one process a node, over real buses."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bridge.cli.options import DeployOptions, HardwareOptions
from bridge.cli.rehearsal_options import RehearsalOptions
from cosim.cli.options import OutputOptions, write_json

if TYPE_CHECKING:
    from bridge.deployment.system import System
    from bridge.faults.script import FaultScript
    from bridge.node.handle import SlotImage
    from bridge.rehearsal.kept_run import KeptRun
    from bridge.rehearsal.replacement import ReplacingRun
    from bridge.rehearsal.supervisor import Settings
    from bridge.results.rehearsal_outcome import RehearsalOutcome
    from bridge.results.verdict import Verdict


def rehearse(
    deploy: DeployOptions,
    hardware: HardwareOptions,
    options: RehearsalOptions,
    scenario: Annotated[Path | None, typer.Argument(help="Scenario file (.toml).")] = None,
) -> None:
    """Run a scenario in real time, one process per node, on real buses; then check the run.

    Exit status 1 if the run failed: a node stopped early, the replay differs from the run, samples
    were received that were not sent, or an injected fault is not in the report. Exit status 3 if
    the result is inconclusive because this machine was too slow.
    """
    from bridge.cli import checkpoints
    from bridge.cli.options import refuse_in_simulated_time
    from bridge.deployment.system import load_system
    from bridge.rehearsal.outside import parse
    from bridge.rehearsal.supervisor import Settings

    kept = None
    if options.resume is not None:
        kept, options = checkpoints.resumed(scenario, deploy, hardware, options)
        scenario, path = Path(kept.given["scenario"]), Path(kept.given["deployment"])
        changes: list[str] = kept.given["settings"]
    elif scenario is None:
        text = "found no scenario; expected cosim rehearse SCENARIO, or --resume RUN"
        raise typer.BadParameter(text)
    else:
        path, changes = _given(scenario, deploy, hardware, options)
        if options.checkpoint is not None:
            kept = checkpoints.begun(scenario, path, changes, options)
    system = load_system(scenario, str(path), changes)
    refuse_in_simulated_time(
        system.deployment,
        faults=options.faults is not None and not options.firmware,
        nodes=options.nodes is not None,
        outside=bool(options.outside),
        hardware=hardware.hardware,
    )
    if kept is not None:
        kept.check(system)
    found = checked(system, scenario, changes, options)
    hardware.confirm("run")
    settings = Settings(
        scenario=scenario,
        deployment=path,
        changes=tuple(changes),
        realtime=options.realtime,
        real=hardware.hardware,
        script=str(options.faults) if options.faults else "",
        nodes=_selected_nodes(system, options.nodes),
        outside=parse(options.outside or [], system),
        say=options.say,
        images=images(system, options.firmware),
    )
    _run(system, settings, options, found, kept)


def _given(
    scenario: Path, deploy: DeployOptions, hardware: HardwareOptions, options: RehearsalOptions
) -> tuple[Path, list[str]]:
    """The deployment, and the changes of scenario and deployment. Raises ScenarioError."""
    from bridge.deployment import spec as deployments
    from bridge.deployment.changes import clock_settings

    path = deployments.find(scenario, deploy.deploy)
    changes = [*deploy.set_]
    changes += [f"run.seed={options.seed}"] if options.seed is not None else []
    changes += [] if options.latency else ["deploy.latency=false"]
    changes += clock_settings(deployments.load(path), _clock(hardware, options))
    changes += deploy.settings(deployments.load(path))
    return path, changes


def _clock(hardware: HardwareOptions, options: RehearsalOptions) -> str:
    """The clock; with hosts lock-step. Raises ScenarioError for what hosts cannot have."""
    from cosim.base.errors import ScenarioError

    if options.hosts is None:
        return options.clock
    given = {
        "--nodes": options.nodes, "--outside": options.outside, "--faults": options.faults,
        "--firmware": options.firmware, "--hardware": hardware.hardware,
        "--clock simulated": options.clock == "simulated",
    }  # fmt: skip
    for option, said in given.items():
        if said:
            raise ScenarioError(f"found {option} with --hosts, expected it without: lock-step only")
    return "lockstep"


def _selected_nodes(system: System, nodes: str | None) -> tuple[str, ...]:
    """Nodes that are named; none: all. Raises ScenarioError for one that is not there."""
    from cosim.base.errors import ScenarioError

    named = tuple(name.strip() for name in nodes.split(",")) if nodes else ()
    for name in named:
        if name not in system.nodes:
            known = ", ".join(system.nodes)
            raise ScenarioError(f"--nodes: no node {name!r}; there are: {known}")
    return named


def images(system: System, given: Sequence[str]) -> dict[str, SlotImage]:
    """The images of nodes, ``NODE=IMAGE``, each asked whether it is this node of this deployment.

    Raises ScenarioError for one that is not, and without the simulated clock.
    """
    from bridge.export.firmware import firmware
    from bridge.firmware.emulator import Emulator
    from bridge.firmware.slots import check
    from bridge.node.handle import SlotImage
    from cosim.base.errors import ScenarioError

    found: dict[str, SlotImage] = {}
    for text in given:
        name, equals, image = text.partition("=")
        if not equals or name not in system.nodes or name in found:
            known = ", ".join(n for n in system.nodes if n not in found)
            raise ScenarioError(f"--firmware {text}: expected NODE=IMAGE, with one of {known}")
        if system.deployment.clock != "simulated":
            raise ScenarioError(
                f"--firmware {text}: found the {system.deployment.clock} clock, expected --clock "
                "simulated, with -i cosim; on the wall clock, run the image with cosim node "
                "--firmware and start the others with --nodes"
            )
        tables = firmware(system, name, "native").token
        check(system, name, Emulator(Path(image), name), tables)
        found[name] = SlotImage(str(Path(image).absolute()), tables.hex())
    return found


def _run(
    system: System,
    settings: Settings,
    options: RehearsalOptions,
    found: list[dict[str, Any]],
    kept: KeptRun | None,
) -> None:
    """The rehearsal and its results. Ends the command unless the verdict is good."""
    from bridge.faults.load import load
    from bridge.preflight import host
    from bridge.rehearsal import injector
    from bridge.rehearsal.replacement import ReplacingRun
    from bridge.results.data import as_data
    from bridge.results.outcome import clear
    from cosim.base.copies import replace
    from cosim.cli.summary import this_command
    from cosim.record import claim_folder, held_folder

    host.check(system, settings.nodes)
    script = load(Path(settings.script)) if settings.script else None
    if script is not None:
        settings = replace(settings, events=injector.events(script, system, images=settings.images))
    folder = options.folder(f"{system.scenario.name}-{system.deployment.name}")
    file, placed = None, None
    if options.hosts is not None:
        from bridge.rehearsal import host_file
        from bridge.rehearsal.remote import on_hosts

        file = host_file.load(options.hosts)
        started, placed = on_hosts(system, file, settings.changes, folder)
        settings = replace(settings, starter=started, warm_up=0.0)
    facts = {
        "settings": list(settings.changes), "faults": settings.script, "real": settings.real,
        "command": kept.given["command"] if kept else this_command(), "findings": found,
    }  # fmt: skip
    resumed = kept is not None and kept.is_resumed
    with held_folder(folder):
        if options.force or resumed:
            clear(folder, resumed=resumed)
        claim_folder(folder, force=options.force or resumed, resumed=resumed)
        if kept is not None:
            settings = replace(settings, keeping=kept.begin(system, folder))
        options.say("\n".join([header(system), *(placed.lines() if placed else ())]))
        most = 0 if kept is None else options.replace
        running = ReplacingRun(kept, system, settings, folder, file=file, most=most)
        outcome, interrupted = _rehearsed(system, running, folder, facts, script, options)
        verdict = _say(system, outcome, options)
        if options.json is not None:
            write_json(options.json, "rehearse", as_data(system, outcome))
        if interrupted:
            raise _interrupted(folder, kept)
        if kept is not None and outcome.finished:
            kept.end(folder)
        if verdict.exit_code:
            raise typer.Exit(verdict.exit_code)


def _interrupted(folder: Path, kept: KeptRun | None) -> typer.Exit:
    """The end of a command that a signal has ended; says how its run is continued."""
    from cosim.base.interrupts import exit_code

    typer.echo(f"interrupted; recorded until then: {folder}", err=True)
    if kept is not None:
        again = f"cosim rehearse --resume {shlex.quote(str(folder))}"
        typer.echo(f"to continue: {again}", err=True)
    return typer.Exit(exit_code())


def _rehearsed(
    system: System,
    running: ReplacingRun,
    folder: Path,
    facts: dict[str, Any],
    script: FaultScript | None,
    options: RehearsalOptions,
) -> tuple[RehearsalOutcome, bool]:
    """The outcome, and whether a signal ended the run."""
    from bridge.rehearsal.remote import RemoteHosts
    from bridge.results.outcome import begin, complete
    from cosim.base.errors import Interrupted
    from cosim.cli.summary import progress_bar

    def tell(sentence: str) -> None:
        typer.echo(f"note: {sentence}", err=True)

    begin(system, folder, facts)
    interrupted = False
    try:
        with progress_bar(options.quiet) as progress:
            running.run(lambda t, end: progress(round(t * 1e3), round(end * 1e3)), tell)
    except Interrupted:
        interrupted = True
    if isinstance(running.starter, RemoteHosts):
        facts = {**facts, "hosts": running.starter.facts()}
    outcome = complete(
        system, folder, running.ended, facts,
        with_twin=options.twin, formats=tuple(options.log), script=script,
    )  # fmt: skip
    return outcome, interrupted


def checked(
    system: System, path: Path, settings: Sequence[str], options: OutputOptions
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
    strict, quiet = options.strict, options.quiet
    plan = assemble(alone)
    found = print_warnings(alone, plan, strict=strict, quiet=quiet, computed=strict)["findings"]
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
    from bridge.node.lockstep import is_lockstep

    d = system.deployment
    nodes = ", ".join(f"{n} ({1 / p.h:g} Hz)" for n, p in system.nodes.items())
    buses = ", ".join(
        f"{n} = {b.interface} {b.channel}" if b.kind == "can" else f"{n} = Zenoh"
        for n, b in d.buses.items()
    )
    length = system.plan.ticks * system.plan.h
    clock = "in simulated time" if d.clock == "simulated" else "on the wall clock"
    clock = "in lock-step" if is_lockstep(system) else clock
    return f"{system.scenario.title}\n{d.title}: {nodes}; {buses}; {length:g} s {clock}"


def _say(system: System, outcome: RehearsalOutcome, options: OutputOptions) -> Verdict:
    """Draw what is wanted, and print the results."""
    from bridge.realtime.lateness import draw
    from bridge.results import verdict as verdicts
    from bridge.results.outcome import lines, metric_lines
    from bridge.results.page import write_page
    from bridge.results.timeline import causes_text, happenings
    from cosim.base.copies import replace
    from cosim.cli.summary import pictures
    from cosim.measure.metric_result import summary_line
    from cosim.record import Run, seal

    run = Run.open(outcome.folder)
    said = [*metric_lines(system, outcome, run), *lines(system, outcome)]
    found = verdicts.judge(system, outcome)
    if options.plot:
        said.append(summary_line("report", str(write_page(system, run, outcome, found, said))))
    figures = pictures(system.scenario, run, replace(options, plot=False))
    said += [summary_line(what, str(path)) for what, path in figures]
    if options.png:
        late = {str(r.life): r.lateness for r in outcome.reports}
        said.append(summary_line("figure", str(draw(late, outcome.folder / "lateness.png"))))
    seal(outcome.folder)
    if found.word is not verdicts.Word.PASSED and (first := happenings(system, outcome)):
        said.append(summary_line("first causes", causes_text(first)))
    said.append(summary_line("verdict", found.text(success_text(outcome))))
    said.append(summary_line("run folder", str(outcome.folder)))
    if not options.quiet:
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
