"""``--deploy`` of ``cosim run``, ``check`` and ``export``: a deployment without its nodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from bridge.can.messages import BusMessage, bus_responses, bus_share
from bridge.can.rates import control_rate, simulated_worst
from cosim.base.errors import Interrupted, ScenarioError
from cosim.bus.timing import BusTiming, worst
from cosim.checks import Finding
from cosim.cli.options import write_json

if TYPE_CHECKING:
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
    from bridge.preflight.bus_checks import check_buses
    from cosim.bus.dbc_traffic import read_messages

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
    from cosim.cli.show import aligned

    for text in aligned(load_rows(messages, timings)):
        typer.echo(text)
    for bus, timing in timings.items():
        on_bus = [m for m in messages if m.bus == bus]
        queues = ", ".join(sorted({m.queue.name.lower() for m in on_bus}))
        typer.echo(f"\nbus {bus}" + (f", transmit queues: {queues}" if queues else ""))
        for text in aligned(message_rows(on_bus, timing)):
            typer.echo(text)


def load_rows(messages: Sequence[BusMessage], buses: Mapping[str, BusTiming]) -> list[list[str]]:
    """A row for each bus, below a heading: bit rates, messages, load, and the control rate.

    The load is that at best, on random data and at worst; the rate, Hz, on random data and at worst
    (:func:`bridge.can.rates.control_rate`).
    """
    table = [["bus", "kbit/s", "messages", "best", "mean", "worst", "control rate", "at worst"]]
    for name, timing in buses.items():
        on_bus = [m for m in messages if m.bus == name]
        share = bus_share(on_bus, timing)
        rate = f"{timing.bitrate / 1e3:g}"
        if timing.fd:
            rate += f" / {(timing.data_bitrate or timing.bitrate) / 1e3:g}"
        reached = control_rate(on_bus, timing)
        rates = [f"{reached.mean:.0f} Hz", f"{reached.worst:.0f} Hz"] if reached else ["", ""]
        table.append([name, rate, str(len(on_bus)), *(f"{part:.1%}" for part in share), *rates])
    return table


def message_rows(messages: Sequence[BusMessage], timing: BusTiming) -> list[list[str]]:
    """A row for each message of one bus, most urgent first, below a heading; times in ms.

    `response` is the worst case by analysis, `simulated` that of the simulated bus if
    all are requested at once, and then with their periods, with random data.

    Raises TimingError where two messages have one identifier or one cannot be a frame.
    """
    table = [["identifier", "message", "node", "bytes", "period", "frame", "response"]]
    table[0] += ["simulated", "in time"]
    simulated = simulated_worst(messages, timing)
    for m, response in bus_responses(messages, timing):
        period = f"{m.period * 1e3:g}" if m.period and isfinite(m.period) else "event"
        takes = "no bound" if response.worst is None else f"{response.worst / 1e6:.3f}"
        frame = f"{timing.time_ns(worst(m.length, m.kind)) / 1e6:.3f}"
        in_time = "yes" if response.meets_deadline else "no"
        identifier = f"{m.identifier:#010x}" if m.extended else f"{m.identifier:#05x}"
        table.append([identifier, m.name, m.node, str(m.length), period, frame, takes])
        seen = simulated.get((m.extended, m.identifier))
        table[-1] += ["never sent" if seen is None else f"{1e3 * seen:.3f}", in_time]
    return table


def run(scenario: Path, settings: Sequence[str], options: RunOptions) -> None:
    """Run the twin of ``options.deploy`` into a run folder, and print its numbers.

    Raises ScenarioError if the clock is not ``simulated``.
    """
    from bridge.cli.rehearse import checked, header
    from bridge.deployment.system import load_system
    from bridge.results.outcome import run_twin
    from cosim.base.clock import stopwatch
    from cosim.base.interrupts import exit_code
    from cosim.cli.summary import (
        exit_unless_passed,
        metric_facts,
        metrics_as_data,
        pictures,
        requirement_lines,
        this_command,
        wall_time,
    )
    from cosim.measure import requirements
    from cosim.measure.metric_result import summary_line
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
    judged = requirements.of_run(system.scenario, result)
    requirements.keep(folder, judged)
    for fact in (*metric_facts(system.scenario, result), wall_time(wall, length)):
        options.say(summary_line(*fact))
    for text in requirement_lines(judged):
        options.say(text)
    for what, path in pictures(system.scenario, result, options):
        options.say(summary_line(what, str(path)))
    seal(folder)
    if options.json is not None:
        metrics = metrics_as_data(system.scenario, result)
        data = {"folder": str(folder), "wall_s": wall, "metrics": metrics}
        required = {"requirements": requirements.as_data(judged)} if judged else {}
        write_json(options.json, "twin", data | required)
    options.say(summary_line("run folder", str(folder)))
    if options.strict:
        exit_unless_passed(judged)


def write_nodes(
    scenario: Path,
    deploy: str,
    folder: Path,
    names: Sequence[str],
    settings: Sequence[str],
    platforms: str,
    *,
    wasm: bool,
) -> None:
    """Write ``FOLDER/NODE.fmu`` of the nodes `names`, of all where there is none, and what they
    leave out.

    `platforms`: separated by commas; "": the host's. `wasm`: with a WebAssembly binary as well.
    Raises ScenarioError for a node that cannot be a network FMU.
    """
    from bridge.deployment.system import load_system
    from bridge.export.node_fmu import export_nodes, notes
    from fmus.build.wasm_fmu import add_wasm

    system = load_system(scenario, deploy, settings)
    chosen = list(dict.fromkeys(names)) or list(system.nodes)
    asked = [name.strip() for name in platforms.split(",") if name.strip()]
    found: dict[str, list[str]] = {}
    for name, path in zip(chosen, export_nodes(system, chosen, folder, asked), strict=True):
        if wasm:
            add_wasm(path)
        components = ", ".join(c.name for c in system.nodes[name].plan.components)
        terminals = ", ".join(system.buses_of(name))
        kind = "FMI 3.0, wasm" if wasm else "FMI 3.0"
        typer.echo(f"{path}  {kind}, CAN terminal {terminals}, with {components}")
        for note in notes(system, name):
            found.setdefault(note, []).append(name)
    for note, of in found.items():
        typer.echo(f"note: {', '.join(of)}: {note}")


def write_firmware(
    scenario: Path,
    deploy: str,
    folder: Path,
    name: str,
    settings: Sequence[str],
    *,
    target: str,
    real: bool,
) -> None:
    """Write the firmware of a node, and how it becomes an image.

    `target`: of :data:`bridge.export.firmware.TARGETS`; "": the first. Raises ScenarioError for a
    node that cannot be firmware.
    """
    from bridge.deployment.system import load_system
    from bridge.export.firmware import TARGETS, export_firmware

    target = target or TARGETS[0]
    if target not in TARGETS:
        raise ScenarioError(f"found {target!r}, expected {', '.join(TARGETS)}", "--target")
    system = load_system(scenario, deploy, settings)
    export_firmware(system, name, folder, target, real=real)
    components = ", ".join(c.name for c in system.nodes[name].plan.components)
    buses = ", ".join(system.buses_of(name))
    typer.echo(f"{folder}  node {name} for {target}, on CAN {buses}, with {components}")
    typer.echo(f"build: make -C {folder}")
