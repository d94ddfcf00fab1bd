"""``cosim report``: the report of a run folder, written again."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Annotated

import typer

from cosim.cli.options import Pdf, Png, Quiet

#: Writes the reports of rehearsals; this package does not know it.
REHEARSALS = "bridge.cli.rehearse"


def report(
    run: Annotated[Path, typer.Argument(help="Run folder.")],
    png: Png = False,
    pdf: Pdf = False,
    quiet: Quiet = False,
) -> None:
    """Write the report of a run again: a page with diagrams, arms that move, and results."""
    from cosim.cli.summary import draw_figures
    from cosim.record import Run, seal
    from cosim.record.folder import SUMS
    from cosim.reporting.recorded import recorded_scenario
    from cosim.reporting.run_report import write_report

    result = Run.open(run)
    folder = result.path.parent
    if "rehearsal" in result.metadata:
        found = [("report", importlib.import_module(REHEARSALS).rewrite_report(folder))]
    else:
        found = [("report", write_report(result))]
    if png or pdf:
        found += draw_figures(recorded_scenario(result), result, png=png, pdf=pdf)
    if (folder / SUMS).exists():
        seal(folder, changed=[path.name for _, path in found])
    for what, path in found if not quiet else ():
        typer.echo(f"{what:<16} {path}")
