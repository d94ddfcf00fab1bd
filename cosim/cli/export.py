"""``cosim export``: a scenario for other tools, as an SSP or as one FMU."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cosim.cli.options import Set


def export(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (.toml or .ssp).")],
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
    set_: Set = None,
) -> None:
    """Write a scenario as an SSP that other tools run, or as one FMU that contains it."""
    from cosim.base.errors import ScenarioError
    from cosim.scenario.assemble import assemble
    from cosim.ssp import load as load_ssp
    from cosim.ssp.container import write as write_container
    from cosim.ssp.export import write

    if links not in ("annotation", "fmu"):
        raise ScenarioError(f"{links!r} is neither annotation nor fmu", "--links")
    if ssp is None and fmu is None:
        raise ScenarioError("nothing to write; expected --ssp FILE or --fmu FILE", "cosim export")
    from cosim.loading.files import load

    read = load_ssp if scenario.suffix == ".ssp" else load
    loaded = read(scenario, set_ or [])
    plan = assemble(loaded)
    if ssp is not None:
        notes = write(loaded, plan, ssp, "fmu" if links == "fmu" else "annotation")
        typer.echo(f"{ssp}  SSP 1.0, {len(plan.components)} FMUs, {len(plan.links)} links")
        for note in notes:
            typer.echo(f"note: {note}")
    if fmu is not None:
        for note in write_container(loaded, plan, fmu):
            typer.echo(f"note: {note}")
        typer.echo(f"{fmu}  FMI 2.0, {len(plan.components)} FMUs inside")
