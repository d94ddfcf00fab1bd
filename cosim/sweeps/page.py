"""``report.html`` of a sweep: how many runs are stable, the range of each measure, every run."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from cosim.reporting.html import Badge, PageData, command, folded, table, write_page
from cosim.sweeps.summary import cell, lines
from cosim.sweeps.table import SweepTable

PAGE = "report.html"
#: Runs that the page lists: a larger table is in ``table.parquet``.
ROWS = 10_000


def write(found: SweepTable, title: str, folder: Path, repeat: str) -> Path:
    """Write the report of a sweep. `repeat`: the command that made it.

    Raises CosimError if it cannot be written.
    """
    lost = sum(bool(r["reason"]) for r in found.records)
    stable = sum(bool(r["stable"]) for r in found.records)
    said = f"{len(found.records)} of {found.points} runs, {stable} stable"
    said += f", {lost} stopped before their end" if lost else ""
    text = escape("\n".join(lines(found)))
    rest = f"<h2>Runs</h2>{_runs(found)}<h2>Repeat it</h2>{command('repeat', repeat)}" + folded(
        "Files", "<p>table.parquet has every run, summary.csv every point.</p>"
    )
    body = f'<pre class="mono">{text}</pre>'
    badge = Badge("finished", said)
    return write_page(folder / PAGE, title, folder.name, badge, body, PageData(0.0), rest)


def _runs(found: SweepTable) -> str:
    measures = [name for name in found.units if "." not in name]
    head = ["", *found.axes, *(f"{name} [{found.units[name]}]" for name in measures), "why"]
    rows = [
        [_mark(r), *(cell(r[axis]) for axis in found.axes),
         *(cell(r.get(name)) for name in measures), str(r["reason"])]
        for r in found.records[:ROWS]
    ]  # fmt: skip
    more = len(found.records) - ROWS
    note = f"<p>… and {more} runs in table.parquet</p>" if more > 0 else ""
    return table(head, rows) + note


def _mark(record: Mapping[str, Any]) -> str:
    return "✓ stable" if record["stable"] else "✗ stopped" if record["reason"] else "✗ not stable"
