"""``cosim report``: the report of a run folder, written again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cosim.cli.options import Pdf, Png, Quiet

#: How wide figures may be, m.
LEAST, MOST = 0.05, 1.0


def report(
    run: Annotated[Path, typer.Argument(help="Run folder.")],
    png: Png = False,
    pdf: Pdf = False,
    width: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH",
            help='Width of the figures of --png and --pdf, such as "88 mm", a column of a paper. '
            "Default: 183 mm.",
        ),
    ] = None,
    recover: Annotated[
        bool,
        typer.Option(
            "--recover", help="Only complete the folder of a run that was killed or lacked disk."
        ),
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Write the report of a run again: a page with diagrams, arms that move, and results.

    Every command reads the folder of a run that was killed as it is; other tools need the complete
    files, which --recover writes.
    """
    if recover:
        from cosim.engine.recovery import repair

        typer.echo(repair(run) or "complete: nothing is to be recovered")
        return
    from cosim.base.convert import number
    from cosim.base.errors import ScenarioError
    from cosim.cli.summary import draw_figures
    from cosim.live.page import rewrite_live
    from cosim.measure.metric_result import summary_line
    from cosim.record import Run, seal
    from cosim.record.folder import SUMS
    from cosim.reporting.recorded import recorded_scenario
    from cosim.reporting.rewritten import rewrite

    wide = None if width is None else number(width, "m", "--width")
    if wide is not None and not LEAST <= wide <= MOST:
        raise ScenarioError(f"found {wide:g} m, expected {LEAST:g} m to {MOST:g} m", "--width")
    result = Run.open(run)
    folder = result.path.parent
    found = [("report", rewrite_live(result) or rewrite(result))]
    if png or pdf:
        found += draw_figures(recorded_scenario(result), result, png=png, pdf=pdf, width=wide)
    if (folder / SUMS).exists():
        seal(folder, changed=[path.name for _, path in found])
    for what, path in found if not quiet else ():
        typer.echo(summary_line(what, str(path)))
