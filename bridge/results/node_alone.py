"""The run folder of a node that runs alone (``cosim node``): its signals, what its links held."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bridge.deployment.system import System
from bridge.recording import run_folder
from bridge.records.node_lives import Life
from bridge.records.records import LifeEnd, Statement
from bridge.replay import replay
from bridge.results.outcome import begin
from bridge.wiring.wiring import Rows
from cosim.base.clock import realtime_offset_ns
from cosim.record import seal, write_metadata
from cosim.record.folder import FINISHED, LIVE, NODES, PART, STOPPED, SUMS, TRAJECTORIES


def begin_node(system: System, folder: Path, facts: Mapping[str, Any]) -> dict[str, Any]:
    """Write ``run.json``; what an earlier life has left in the folder is replaced."""
    (folder / NODES).mkdir(parents=True, exist_ok=True)
    for name in (TRAJECTORIES, LIVE, PART, SUMS):
        (folder / name).unlink(missing_ok=True)
    return begin(system, folder, facts)


def complete_node(
    system: System, folder: Path, report: Statement, facts: Mapping[str, Any]
) -> Mapping[Life, Rows]:
    """Complete the folder and return the rows (slots,) of the node. `facts`: of :func:`begin_node`.

    Raises RunError if a file cannot be written.
    """
    nodes = folder / NODES
    rows = replay.load(nodes) if report.slots else {}
    if rows:
        offset = realtime_offset_ns()
        run_folder.collect(system, rows, nodes, folder, wall_ns=offset)
    whole = report.end in (LifeEnd.FINISHED, LifeEnd.ENDED)
    how = {"status": FINISHED if whole else STOPPED, "error": report.error or None}
    write_metadata(folder, {**facts, **how})
    seal(folder)
    return rows
