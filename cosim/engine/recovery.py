"""Completion of the folder of an interrupted run, so that every tool can read it."""

from __future__ import annotations

from pathlib import Path

from cosim.base.errors import ScenarioError
from cosim.links.storage import recover_tables
from cosim.record.folder import (
    LIVE,
    METADATA,
    RECOVERED,
    RUNNING,
    TRAJECTORIES,
    is_unfinished,
    journals,
    read_metadata,
    write_metadata,
)
from cosim.record.recover import complete, is_recording
from cosim.record.run import Run


def repair(folder: Path, why: str = "cut short") -> str:
    """Complete the trajectories, tables and ``run.json`` of `folder`; until when it is recorded.

    `why`: what ended the run, for ``run.json``. A folder that is complete stays as it is, and the
    text is empty. Raises ScenarioError where the run still goes on or there is none, RunError where
    nothing can be written.
    """
    if not folder.is_dir():
        raise ScenarioError("there is no such run folder", str(folder))
    if is_recording(folder):
        raise ScenarioError("the run is still active; there is nothing to recover", str(folder))
    facts = read_metadata(folder)
    running = facts.get("status", "") == RUNNING
    cut = is_unfinished(folder) or (running and bool(journals(folder)))
    if not cut and not running:
        if not (folder / TRAJECTORIES).exists():
            raise ScenarioError("no run folder: nothing was recorded in it", str(folder))
        return ""
    if cut:
        complete(folder)
    recover_tables(folder)
    (folder / LIVE).unlink(missing_ok=True)
    if (folder / METADATA).exists():
        write_metadata(folder, {**facts, "status": RECOVERED, "error": facts.get("error") or why})
    if not (folder / TRAJECTORIES).exists():
        return "nothing was recorded"
    run = Run.open(folder)
    return f"recorded until t = {run.span[1]:.6g} s" if len(run) else "nothing was recorded"
