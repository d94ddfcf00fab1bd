"""``cosim run --deploy`` and ``cosim check --deploy``: a deployment offline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from cosim.base.errors import Interrupted, ScenarioError
from cosim.checks.finding import Finding
from cosim.cli.supervise import announce_run_folder

if TYPE_CHECKING:
    from bridge.can.messages import BusMessage
    from cosim.bus.timing import BusTiming


def findings(scenario: Path, deploy: str, settings: Sequence[str]) -> list[Finding]:
    """Findings on the buses; prints their loads and messages."""
    from bridge.deployment.system import load_system
    from bridge.preflight import deployment

    system = load_system(scenario, deploy, settings)
    messages, timings = deployment.messages(system), deployment.timings(system)
    typer.echo(f"{system.deployment.title}\n")
    _print_buses(messages, timings)
    return deployment.check(system)


def layout_findings(
    path: Path, bitrate: float, data_bitrate: float | None, fd: bool
) -> list[Finding]:
    """Findings on the messages of a DBC file on one bus; prints load and messages.

    `bitrate`, `data_bitrate` in bit/s; `fd`: classic messages become CAN FD frames, too. Raises
    TrafficError for a file without periodic messages.
    """
    from bridge.can.messages import BusMessage
    from bridge.preflight.bus_checks import check_buses
    from cosim.bus.dbc_traffic import read_messages
    from cosim.bus.timing import BusTiming

    found = read_messages(path)
    flexible = fd or data_bitrate is not None or any(m.format.fd for m in found)
    timing = BusTiming(bitrate, data_bitrate, flexible)
    messages = [
        BusMessage(
            name=m.name,
            identifier=m.identifier,
            length=m.length,
            period=m.period_ps * 1e-12,
            node=m.sender,
            bus=path.stem,
            extended=m.format.extended,
            fd=m.format.fd or fd,
            brs=(m.format.brs or fd) and data_bitrate is not None,
            role="drive",
        )
        for m in found
    ]
    _print_buses(messages, {path.stem: timing})
    return check_buses(messages, {path.stem: timing})


def _print_buses(messages: Sequence[BusMessage], timings: Mapping[str, BusTiming]) -> None:
    """Load and control rate of each bus, and its messages with their response times."""
    from bridge.cli.check import load_rows, message_rows
    from cosim.cli.show import aligned

    for text in aligned(load_rows(messages, timings)):
        typer.echo(text)
    for bus, timing in timings.items():
        on_bus = [m for m in messages if m.bus == bus]
        queues = ", ".join(sorted({m.queue.name.lower() for m in on_bus}))
        typer.echo(f"\nbus {bus}" + (f", transmit queues: {queues}" if queues else ""))
        for text in aligned(message_rows(on_bus, timing)):
            typer.echo(text)


def run(
    scenario: Path,
    deploy: str,
    clock: str,
    settings: Sequence[str],
    out: Path | None,
    *,
    force: bool,
    report: bool,
    png: bool,
    pdf: bool,
    strict: bool,
    quiet: bool,
    json: Path | None = None,
) -> None:
    """Run the twin into a run folder, and print its numbers.

    Raises ScenarioError if `clock` is not ``simulated``.
    """
    from bridge.cli.options import unused_folder
    from bridge.cli.rehearse import checked, header
    from bridge.deployment.system import load_system
    from bridge.results.outcome import run_twin
    from bridge.results.report import line
    from cosim.base.clock import stamp, stopwatch
    from cosim.base.interrupts import exit_code
    from cosim.cli.json_file import write_json
    from cosim.cli.summary import metrics_as_data, pictures, this_command
    from cosim.measure import declared_metrics
    from cosim.measure.metrics import evaluate
    from cosim.record import Run, claim_folder, held_folder, seal

    if clock != "simulated":
        raise ScenarioError(
            f"--clock {clock}: expected simulated; for wall time use cosim rehearse"
        )
    system = load_system(scenario, deploy, settings)
    findings = checked(system, scenario, settings, strict=strict, quiet=quiet)
    name = f"{system.scenario.name}-{system.deployment.name}-twin-{stamp()}"
    folder = out or unused_folder(Path("runs") / name)
    announce_run_folder(folder)
    watch = stopwatch()
    try:
        further = {"command": this_command(), "findings": findings}
        with held_folder(folder):
            claim_folder(folder, force=force)
            run_twin(system, folder, settings, further)
    except Interrupted as stop:
        typer.echo(f"{stop}; recorded until then: {stop.saved}", err=True)
        raise typer.Exit(exit_code()) from None
    wall = watch()
    result = Run.open(folder)
    length = system.plan.ticks * system.plan.h
    said = [header(system).replace("on the wall clock", "in simulated time")]
    said += [
        line(r.label, r.text) for r in evaluate(declared_metrics.metrics(system.scenario), result)
    ]
    said.append(
        line("wall time", f"{wall:.2f} s for {length:g} s: {length / wall:.0f} x real time")
    )
    found = pictures(system.scenario, result, report=report, png=png, pdf=pdf)
    said += [line(what, str(path)) for what, path in found]
    seal(folder)
    if json is not None:
        found_metrics = metrics_as_data(system.scenario, result)
        write_json(json, {"folder": str(folder), "wall_s": wall, "metrics": found_metrics})
    said.append(line("run folder", str(folder)))
    if not quiet:
        typer.echo("\n".join(said))
