"""``cosim export``: a scenario as an SSP, one FMU or one FMU a node; a run as a file of data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cosim.base.parts import part
from cosim.cli.options import Set

_TOGETHER = (
    "found one of --deploy, --nodes, --node and --platforms, expected --deploy NAME --nodes FOLDER"
)


def export(
    scenario: Annotated[
        Path, typer.Argument(help="Scenario file (.toml or .ssp), or with --to a run folder.")
    ],
    to: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write a run: .csv, .parquet, .mat (MATLAB), .mcap (Foxglove), .gif.",
        ),
    ] = None,
    signal: Annotated[
        list[str] | None,
        typer.Option(metavar="PATTERN", help="With --to: these signals only; repeatable."),
    ] = None,
    ssp: Annotated[Path | None, typer.Option(help="SSP 1.0 file to write.")] = None,
    fmu: Annotated[
        Path | None, typer.Option(help="FMI 2.0 FMU of the whole loop to write.")
    ] = None,
    links: Annotated[
        str,
        typer.Option(
            help="How to write links: annotation (ignored by other tools) or fmu (delay FMUs)."
        ),
    ] = "annotation",
    deploy: Annotated[
        str | None, typer.Option(help="With --nodes: the deployment, by name or file.")
    ] = None,
    nodes: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Write each node of --deploy as a network FMU (FMI 3.0, FMI-LS-BUS 1.0, CAN).",
        ),
    ] = None,
    node: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="With --nodes: only this node; repeatable."),
    ] = None,
    platforms: Annotated[
        str,
        typer.Option(
            help="With --nodes: comma-separated, e.g. x86_64-linux,x86_64-windows.",
            show_default="host",
        ),
    ] = "",
    set_: Set = None,
) -> None:
    """Write a scenario or a run for other tools.

    A scenario becomes an SSP, one FMU, or a network FMU of each node; a run, with --to, a file of
    data. MCAP has joint states, frames and lines of the arms besides the signals.
    """
    if to is not None or signal:
        _export_run(scenario, to, signal or [])
        return
    from cosim.base.errors import ScenarioError
    from cosim.scenario.assemble import assemble
    from cosim.ssp import load as load_ssp
    from cosim.ssp.container import write as write_container
    from cosim.ssp.export import write

    if links not in ("annotation", "fmu"):
        raise ScenarioError(f"{links!r} is neither annotation nor fmu", "--links")
    if (nodes is None) is not (deploy is None) or (nodes is None and (node or platforms)):
        raise ScenarioError(_TOGETHER, "cosim export")
    if ssp is None and fmu is None and nodes is None:
        raise ScenarioError(
            "nothing to write; expected --ssp FILE, --fmu FILE, --nodes FOLDER or --to FILE",
            "cosim export",
        )
    if nodes is not None:
        writer = part("node_fmus")
        writer.write(scenario, deploy, nodes, node or [], set_ or [], platforms)
    if ssp is None and fmu is None:
        return
    from cosim.loading.files import load

    read = load_ssp if scenario.suffix == ".ssp" else load
    loaded = read(scenario, set_ or [])
    plan = assemble(loaded)
    if ssp is not None:
        notes = write(loaded, plan, ssp, "fmu" if links == "fmu" else "annotation")
        typer.echo(f"{ssp}  {len(plan.components)} FMUs, {len(plan.links)} links")
        for note in notes:
            typer.echo(f"note: {note}")
    if fmu is not None:
        for note in write_container(loaded, plan, fmu):
            typer.echo(f"note: {note}")
        typer.echo(f"{fmu}  FMI 2.0, {len(plan.components)} FMUs inside")


def _export_run(folder: Path, to: Path | None, patterns: list[str]) -> None:
    from cosim.base.errors import ScenarioError
    from cosim.record import Run
    from cosim.reporting.exported import export_run

    if to is None:
        raise ScenarioError("found --signal without --to, expected --to FILE", "cosim export")
    run = Run.open(folder)
    export_run(run, to, patterns)
    typer.echo(f"{to}  {len(run)} rows of {folder}")
