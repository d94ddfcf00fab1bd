"""``cosim recover``: complete the folder of a run that was killed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def recover(
    run: Annotated[Path, typer.Argument(help="Run folder of an interrupted run.")],
) -> None:
    """Complete a run folder after the run was killed or the disk was full.

    Every command reads such a folder as it is; other tools need the complete files.
    """
    from cosim.engine.recovery import repair

    typer.echo(repair(run) or "complete: nothing is to be recovered")
