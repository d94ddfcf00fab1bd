"""``cosim run --deploy`` and ``cosim check --deploy``: a deployment offline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from cosim.base.errors import Interrupted, ScenarioError
from cosim.checks.finding import Finding

if TYPE_CHECKING:
    from bridge.can.messages import BusMessage
    from cosim.bus.timing import BusTiming
    from cosim.cli.run import RunOptions


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


def run(scenario: Path, settings: Sequence[str], options: RunOptions) -> None:
    """Run the twin of ``options.deploy`` into a run folder, and print its numbers.

    Raises ScenarioError if the clock is not ``simulated``.
    """
    from bridge.cli.rehearse import checked, header
    from bridge.deployment.system import load_system
    from bridge.results.outcome import run_twin
    from bridge.results.report import line
    from cosim.base.clock import stopwatch
    from cosim.base.interrupts import exit_code
    from cosim.cli.json_file import write_json
    from cosim.cli.summary import metrics_as_data, pictures, this_command
    from cosim.measure import declared_metrics
    from cosim.measure.metrics import evaluate
    from cosim.record import Run, claim_folder, held_folder, seal

    if options.clock != "simulated":
        raise ScenarioError(
            f"--clock {options.clock}: expected simulated; for wall time use cosim rehearse"
        )
    system = load_system(scenario, options.deploy or "", settings)
    findings = checked(system, scenario, settings, options)
    folder = options.folder(f"{system.scenario.name}-{system.deployment.name}-twin")
    watch = stopwatch()
    try:
        with held_folder(folder):
            claim_folder(folder, force=options.force)
            facts = {"command": this_command(), "findings": findings}
            run_twin(system, folder, settings, facts)
    except Interrupted as stop:
        typer.echo(f"{stop}; recorded until then: {stop.saved}", err=True)
        raise typer.Exit(exit_code()) from None
    wall, length = watch(), system.plan.ticks * system.plan.h
    result = Run.open(folder)
    options.say(header(system).replace("on the wall clock", "in simulated time"))
    for r in evaluate(declared_metrics.metrics(system.scenario), result):
        options.say(line(r.label, r.text))
    speed = f"{wall:.2f} s for {length:g} s: {length / wall:.0f} x real time"
    options.say(line("wall time", speed))
    for what, path in pictures(system.scenario, result, options):
        options.say(line(what, str(path)))
    seal(folder)
    if options.json is not None:
        metrics = metrics_as_data(system.scenario, result)
        write_json(options.json, {"folder": str(folder), "wall_s": wall, "metrics": metrics})
    options.say(line("run folder", str(folder)))
