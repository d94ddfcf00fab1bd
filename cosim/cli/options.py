"""Options that several commands share, each with one name and one meaning."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="PATH=VALUE", help="Change a value; repeatable."),
]
Force = Annotated[bool, typer.Option("--force", help="Replace an existing run folder.")]
Plot = Annotated[bool, typer.Option("--plot/--no-plot", help="Draw the figures.")]
Report = Annotated[
    bool, typer.Option("--plot/--no-plot", help="Write report.html, a page to look at the run.")
]
Png = Annotated[bool, typer.Option("--png", help="Also draw the figures of the scenario as PNG.")]
Pdf = Annotated[bool, typer.Option("--pdf", help="Also draw the figures of the scenario as PDF.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Strict = Annotated[bool, typer.Option("--strict", help="Treat warnings before the run as errors.")]
Json = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write the result as JSON.")
]
Verify = Annotated[
    bool, typer.Option("--verify/--no-verify", help="Check the SHA-256 sums of RUN first.")
]
