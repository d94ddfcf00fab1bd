"""``cosim export``: a scenario as an SSP, one FMU or one FMU a node; a run as a file of data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cosim.base.convert import Struct, field
from cosim.base.parts import part
from cosim.cli.options import Set

_TOGETHER = (
    "found one of --deploy, --nodes, --node, --platforms and --wasm, expected --deploy NAME --nodes"
    " FOLDER"
)
_FIRMWARE = (
    "found --firmware, --target or --real without the others, expected --deploy NAME --node NODE"
    " --firmware FOLDER, and no --nodes"
)


class RunFileOptions(Struct, frozen=True):
    """A run as a file of data."""

    to: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write a run: .csv, .parquet, .mat (MATLAB), .mcap (Foxglove), .gif.",
        ),
    ] = None
    signal: Annotated[
        list[str],
        typer.Option(metavar="PATTERN", help="With --to: these signals only; repeatable."),
    ] = field(default_factory=list)


class SystemOptions(Struct, frozen=True):
    """A scenario for tools that simulate."""

    ssp: Annotated[Path | None, typer.Option(help="SSP 1.0 file to write.")] = None
    fmu: Annotated[Path | None, typer.Option(help="FMI 2.0 FMU of the whole loop to write.")] = None
    links: Annotated[
        str,
        typer.Option(
            help="How to write links: annotation (ignored by other tools) or fmu (delay FMUs)."
        ),
    ] = "annotation"


class NodeFmuOptions(Struct, frozen=True):
    """The nodes of a deployment as network FMUs."""

    deploy: Annotated[
        str | None,
        typer.Option(help="With --nodes or --firmware: the deployment, by name or file."),
    ] = None
    nodes: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Write each node of --deploy as a network FMU (FMI 3.0, FMI-LS-BUS 1.0, CAN).",
        ),
    ] = None
    node: Annotated[
        list[str],
        typer.Option(
            metavar="NAME",
            help="With --nodes: only this node; repeatable. With --firmware: this node.",
        ),
    ] = field(default_factory=list)
    platforms: Annotated[
        str,
        typer.Option(
            help="With --nodes: comma-separated, e.g. x86_64-linux,x86_64-windows.",
            show_default="host",
        ),
    ] = ""
    wasm: Annotated[
        bool, typer.Option("--wasm", help="With --nodes: with a WebAssembly binary as well.")
    ] = False


class FirmwareOptions(Struct, frozen=True):
    """A node of a deployment as firmware."""

    firmware: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Write the --node of --deploy as C for a microcontroller, which make builds.",
        ),
    ] = None
    target: Annotated[
        str,
        typer.Option(
            help="With --firmware: cortex-m4, cortex-m7, riscv32 or native.",
            show_default="cortex-m4",
        ),
    ] = ""
    real: Annotated[
        bool,
        typer.Option("--real", help="With --firmware: it may move real drives."),
    ] = False


def export(
    scenario: Annotated[
        Path, typer.Argument(help="Scenario file (.toml or .ssp), or with --to a run folder.")
    ],
    file: RunFileOptions,
    system: SystemOptions,
    network: NodeFmuOptions,
    image: FirmwareOptions,
    set_: Set = None,
) -> None:
    """Write a scenario or a run for other tools.

    A scenario becomes an SSP, one FMU, a network FMU of each node, or the firmware of one; a run,
    with --to, a file of data. MCAP has joint states, frames and lines of the arms besides the
    signals.
    """
    if file.to is not None or file.signal:
        _export_run(scenario, file.to, file.signal)
        return
    from cosim.base.errors import ScenarioError

    if system.links not in ("annotation", "fmu"):
        raise ScenarioError(f"{system.links!r} is neither annotation nor fmu", "--links")
    if image.firmware is not None or image.target or image.real:
        _export_firmware(scenario, network, image, set_ or [])
        return
    nodes = network.nodes
    if (nodes is None) is not (network.deploy is None) or (
        nodes is None and (network.node or network.platforms or network.wasm)
    ):
        raise ScenarioError(_TOGETHER, "cosim export")
    if system.ssp is None and system.fmu is None and nodes is None:
        raise ScenarioError(
            "nothing to write; expected --ssp FILE, --fmu FILE, --nodes FOLDER, --firmware FOLDER"
            " or --to FILE",
            "cosim export",
        )
    if nodes is not None:
        part("twin").write_nodes(
            scenario,
            network.deploy,
            nodes,
            network.node,
            set_ or [],
            network.platforms,
            wasm=network.wasm,
        )
    if system.ssp is not None or system.fmu is not None:
        _export_system(scenario, set_ or [], system)


def _export_firmware(
    scenario: Path, network: NodeFmuOptions, image: FirmwareOptions, settings: list[str]
) -> None:
    from cosim.base.errors import ScenarioError

    alone = network.nodes is None and not network.platforms and not network.wasm
    if image.firmware is None or network.deploy is None or len(network.node) != 1 or not alone:
        raise ScenarioError(_FIRMWARE, "cosim export")
    part("twin").write_firmware(
        scenario,
        network.deploy,
        image.firmware,
        network.node[0],
        settings,
        target=image.target,
        real=image.real,
    )


def _export_system(scenario: Path, settings: list[str], system: SystemOptions) -> None:
    from cosim.loading.files import load
    from cosim.scenario.assemble import assemble
    from cosim.ssp import load as load_ssp
    from cosim.ssp.container import write as write_container
    from cosim.ssp.export import write

    read = load_ssp if scenario.suffix == ".ssp" else load
    loaded = read(scenario, settings)
    plan = assemble(loaded)
    if system.ssp is not None:
        notes = write(loaded, plan, system.ssp, "fmu" if system.links == "fmu" else "annotation")
        typer.echo(f"{system.ssp}  {len(plan.components)} FMUs, {len(plan.links)} links")
        for note in notes:
            typer.echo(f"note: {note}")
    if system.fmu is not None:
        for note in write_container(loaded, plan, system.fmu):
            typer.echo(f"note: {note}")
        typer.echo(f"{system.fmu}  FMI 2.0, {len(plan.components)} FMUs inside")


def _export_run(folder: Path, to: Path | None, patterns: list[str]) -> None:
    from cosim.base.errors import ScenarioError
    from cosim.record import Run
    from cosim.reporting.exported import export_run

    if to is None:
        raise ScenarioError("found --signal without --to, expected --to FILE", "cosim export")
    run = Run.open(folder)
    export_run(run, to, patterns)
    typer.echo(f"{to}  {len(run)} rows of {folder}")
