"""Options that several commands share, each with one name and one meaning."""

from __future__ import annotations

from typing import Annotated

import typer

Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="PATH=VALUE", help="Change a value; repeatable."),
]
Force = Annotated[bool, typer.Option("--force", help="Replace an existing run folder.")]
Plot = Annotated[bool, typer.Option("--plot/--no-plot", help="Draw the figures.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Strict = Annotated[bool, typer.Option("--strict", help="Treat warnings before the run as errors.")]
Verify = Annotated[
    bool, typer.Option("--verify/--no-verify", help="Check the SHA-256 sums of RUN first.")
]
