"""``report.html`` of a sweep: a map of the runs, axes that filter them, and a table of them."""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from cosim.reporting.html import Badge, PageData, cards, command, folded, write_page
from cosim.reporting.points import PointColumn, PointView, elements, points
from cosim.study.study import Study
from cosim.study.summary import lines, repeats_the_table
from cosim.study.table import SweepTable, column, entries

PAGE = "report.html"
#: Axes beside each other at most; further measures can be chosen for the map.
PARALLEL = 12
#: Runs on a page, at most: they take about 4 MB.
SHOWN = 20_000
#: How the runs of a cell of the map become one number.
_REDUCTIONS = {"mean": "mean", "median": "median", "min": "least", "max": "greatest"}


def write(found: SweepTable, study: Study, folder: Path, repeat: str) -> Path:
    """Write the report of a sweep. `repeat`: the command that made it.

    Raises CosimError if it cannot be written.
    """
    records = found.records
    lost = sum(map(bool, entries(records, "reason")))
    stable = int(column(records, "stable").sum())
    said = f"{len(records)} of {found.points} runs, {stable} stable"
    said += f", {lost} stopped before their end" if lost else ""
    if len(records) > SHOWN:
        records = records[:: -(-len(records) // SHOWN)]
        said += f"; the page shows {len(records)} of them, evenly spaced in the table"
    kept = study.keep == "trajectories"
    drawn = points(
        list(_columns(found, records, asked_for(study))),
        list(_views(study, found)),
        entries(records, "reason"),
        folders=entries(records, "run") if kept else (),
        repeat=f"cosim run {shlex.quote(os.path.relpath(study.scenario))}",
        settings=[json.loads(text) for text in entries(records, "settings")],
    )
    points_too = "" if repeats_the_table(found) else ", summary.csv every point"
    files = f"<p>table.parquet has every run with its settings{points_too}.</p>"
    text = escape("\n".join(lines(found)))
    rest = (
        f"{elements(_REDUCTIONS) if records else ''}<h2>Repeat it</h2>{command('repeat', repeat)}"
        f'{folded("Ranges", f"""<pre class="mono">{text}</pre>""")}{folded("Files", files)}'
    )
    numbers = [("runs", str(len(found.records))), ("stable", f"{stable}"), ("stopped", f"{lost}")]
    return write_page(
        folder / PAGE, study.title, folder.name, Badge("finished", said), cards(numbers),
        PageData(0.0), rest, drawn if records else "",
    )  # fmt: skip


def asked_for(study: Study) -> set[str]:
    """The columns that the study names: in ``[stable]``, ``[boundary]`` and its figures."""
    found = {*study.stable, *([study.boundary.of] if study.boundary else ())}
    for figure in study.figures.values():
        found |= {figure.x, figure.y, figure.z, figure.by}
    return found


def _columns(
    found: SweepTable, records: Sequence[Mapping[str, Any]], asked: set[str]
) -> Iterator[PointColumn]:
    """Axes, whether a run is stable, and measures, those that are `asked` for first.

    These are in the table and filter it, whatever they are; of the others, parts of measures are
    for the map only.
    """
    for name in found.axes:
        values = entries(records, name)
        yield PointColumn(name, "", values, axis=True, parallel=True, listed=True)
    stable = column(records, "stable").tolist()
    yield PointColumn("stable", "", stable, axis=False, parallel=True, listed=False)
    room = PARALLEL - len(found.axes) - 1
    for name in sorted(found.units, key=lambda name: name not in asked):
        main = name in asked or "." not in name
        room -= main
        parallel = name in asked or (main and room >= 0)
        values = column(records, name).tolist()
        yield PointColumn(
            name, found.units[name], values, axis=False, parallel=parallel, listed=main
        )


def _views(study: Study, found: SweepTable) -> Iterator[PointView]:
    """The figures of the study, then the first two columns with the share of stable runs."""
    names = [*found.axes, *found.units, "stable"]
    for name, spec in study.figures.items():
        z = (spec.by or spec.x) if spec.kind == "line" else spec.z
        yield PointView(spec.title or name, spec.x, spec.y, z, spec.reduce)
    yield PointView("Stable runs", names[0], names[min(1, len(names) - 1)], "stable")
