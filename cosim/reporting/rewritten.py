"""The report of a run folder, written again."""

from __future__ import annotations

from pathlib import Path

from cosim.base.parts import part
from cosim.record import Run, seal
from cosim.record.folder import SUMS
from cosim.reporting.run_report import write_report


def rewrite(run: Run) -> Path:
    """Write the report of a run or a rehearsal, from its files. Raises CosimError."""
    folder = run.path.parent
    rehearsed = "rehearsal" in run.metadata
    path: Path = part("rehearsals").rewrite_report(folder) if rehearsed else write_report(run)
    if (folder / SUMS).exists():
        seal(folder, changed=[path.name])
    return path
