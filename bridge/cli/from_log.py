"""``cosim replay --from-log``: controllers on the frames of a bus log."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from bridge.replay.from_log import ControllerReplay


def from_log(
    log: Path,
    scenario: Path,
    deploy: str,
    settings: Sequence[str] = (),
    others: Sequence[Path] = (),
) -> None:
    """Print how each controller's messages, computed again, differ from those in the log.

    `log`: a file, or a folder of one file a bus; `others`: further files. Exits with 1 where they
    differ.
    """
    from bridge.deployment.system import load_system
    from bridge.replay.from_log import replay_log

    files = sorted(log.glob("*.log")) if log.is_dir() else [log]
    found = replay_log(load_system(scenario, deploy, settings), [*files, *others])
    for node in found.nodes:
        typer.echo("\n".join(lines(node)))
    for remark in found.remarks:
        typer.echo(remark)
    typer.echo("difference: exactly 0 in every frame" if found.exact else "difference: see above")
    raise typer.Exit(int(not found.exact))


def lines(node: ControllerReplay) -> list[str]:
    """The lines of the summary of one controller."""
    from cosim.cli.show import aligned

    head = f"{node.node}: {node.compared} frames in {node.slots} slots from slot {node.first}"
    if node.unheard:
        head += f", {node.unheard} slots without a frame"
    if node.stopping:
        head += f", {node.stopping} frames of other states than active not compared"
    rows = [["value", "RMS", "largest", "at", "frames that differ", "unit"]]
    for v in node.values:
        differ = f"{v.differ}, first in slot {v.first}" if v.differ else "0"
        rows.append([v.name, f"{v.rms:.3g}", f"{v.largest:.3g}", f"{v.t:g} s", differ, v.unit])
    return [head, *aligned(rows)]
