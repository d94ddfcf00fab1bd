"""Output of a comparison: the table as text, Markdown, CSV and JSON, and the link tables.

::

    table.md  table.csv  table.json     the comparison; CSV and JSON hold every run
    report.html                         the table as a page, the best and worst marked
    comparison.png                      the figure
    links/LINK-seedN/CHANNEL.parquet    the recorded tables, as files that a scenario can replay
    runs/                               run folders, if they are kept
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from shutil import rmtree
from typing import Any

from cosim.base.errors import ScenarioError
from cosim.base.files import write_file
from cosim.base.markdown import markdown_row
from cosim.comparison.comparison import Comparison
from cosim.comparison.page import PAGE
from cosim.comparison.rows import ComparisonRow, columns, header, notes, rows, runs_as_data
from cosim.comparison.same_links import KEPT
from cosim.comparison.variants import Controller
from cosim.engine.simulate import versions
from cosim.record.folder import SUMS, reason
from cosim.study.store import JOURNAL, STATE

RESULT, FIGURE, RUNS = "table.json", "comparison.png", "runs"
_OWN = {RESULT, "table.md", "table.csv", FIGURE, PAGE, "links", RUNS, SUMS, JOURNAL, STATE, KEPT}


def text(comparison: Comparison) -> list[str]:
    """The table for a terminal: a block a link law and operator, a line a controller."""
    v, shown = comparison.variants, columns(comparison)
    heads = ["controller", *(header(c, unit) for c, unit in shown), "stable?"]
    table = [
        [row.label, *(row.cell(c, unit) for c, unit in shown), row.stable]
        for row in rows(comparison)
    ]
    widths = [max(len(line[i]) for line in [heads, *table]) for i in range(len(heads))]
    lines: list[str] = []
    before = ""
    for (link, operator), block in groupby(
        zip(rows(comparison), table, strict=True), key=lambda pair: (pair[0].link, pair[0].operator)
    ):
        if link != before:
            lines += ["", f"link {link}: {v.links[link].title}"]
        before = link
        lines += ["", f"{operator}: {v.operators[operator].title}", _aligned(heads, widths)]
        lines += [_aligned(cells, widths) for _, cells in block]
    return [*lines, "", *_below(comparison)]


def _aligned(cells: Sequence[str], widths: Sequence[int]) -> str:
    first, *middle = (f"{cell:>{width}}" for cell, width in zip(cells, widths, strict=True))
    middle[-1] = cells[-1]
    return f"  {first.strip():<{widths[0]}}  {'  '.join(middle)}"


def _below(comparison: Comparison) -> list[str]:
    """Notes, and what was recorded of the links."""
    tables = comparison.tables.sentences(comparison.chosen.links)
    title = "link tables: the same for every controller" if comparison.tables.same else "links:"
    return [*notes(comparison), title, *(f"  {line}" for line in tables)]


def markdown(comparison: Comparison, command: str) -> str:
    """The table as Markdown, with the command that made it."""
    c, shown = comparison, columns(comparison)
    heads = ["link", "operator", "controller", *(header(x, unit) for x, unit in shown), "stable?"]
    right = ["---"] * 3 + ["---:"] * len(shown) + ["---"]
    lines = [f"# {c.variants.title}", "", f"`{command}`", ""]
    lines += [markdown_row(heads), markdown_row(right)]
    lines += [markdown_row(_cells(row, c)) for row in rows(c)]
    lines += ["", *(f"- link **{x}**: {c.variants.links[x].title}" for x in c.chosen.links)]
    lines += [f"- operator **{x}**: {c.variants.operators[x].title}" for x in c.chosen.operators]
    lines += [f"- controller {_described(c.variants.controllers[x])}" for x in c.chosen.controllers]
    return "\n".join([*lines, "", *(f"- {line.strip()}" for line in _below(c))]) + "\n"


def _described(controller: Controller) -> str:
    condition = f"; condition: {controller.condition}" if controller.condition else ""
    sends = ", ".join(controller.sends)
    return f"**{controller.name}**: {controller.title}; sends {sends}{condition}"


def _cells(row: ComparisonRow, comparison: Comparison) -> list[str]:
    numbers = [row.cell(c, unit) for c, unit in columns(comparison)]
    return [row.link, row.operator, row.label, *numbers, row.stable]


def table_csv(comparison: Comparison) -> str:
    """One line per run; numbers read back exactly, missing values are empty."""
    shown, found = columns(comparison), runs_as_data(comparison)
    fixed = [key for key in found[0] if key not in ("numbers", "uncertainties")]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*fixed, *(f"{c.name} [{unit}]" for c, unit in shown)])
    for run in found:
        numbers = [run["numbers"].get(c.name) for c, _ in shown]
        writer.writerow([*(run[key] for key in fixed), *numbers])
    return out.getvalue()


def as_data(comparison: Comparison, command: str) -> dict[str, Any]:
    """Everything: runs, columns with units, link tables, variants, versions."""
    c = comparison
    return {
        "title": c.variants.title,
        "command": command,
        "scenario": str(c.base.path),
        "variants": str(c.variants.path),
        "seeds": list(c.seeds),
        "columns": {x.name: {"label": x.label, "unit": unit} for x, unit in columns(c)},
        "controllers": {x: c.variants.controllers[x].title for x in c.chosen.controllers},
        "operators": {x: c.variants.operators[x].title for x in c.chosen.operators},
        "links": {x: c.variants.links[x].title for x in c.chosen.links},
        "link_tables": c.tables.facts(),
        "versions": versions(),
        "runs": runs_as_data(c),
    }


# ---- files --------------------------------------------------------------------------------------


def claim(folder: Path, *, force: bool = False, resume: bool = False) -> None:
    """Make the folder, or take one that is empty.

    With `force` it may hold a comparison, whose table, figure and link tables are deleted then;
    with `resume` one that is not finished. Run folders stay until they are written anew. Raises
    ScenarioError.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        present = {path.name for path in folder.iterdir()}
    except OSError as error:
        raise ScenarioError(f"cannot be used: {reason(error)}", str(folder)) from error
    unfinished = JOURNAL in present and RESULT not in present
    if unfinished and not (force or resume):
        raise ScenarioError(
            "the folder holds an unfinished comparison; use --resume to continue it, or --force to "
            "begin again",
            str(folder),
        )
    ours = (unfinished or (force and RESULT in present)) and present <= _OWN
    if present and not ours:
        expected = "an empty one, or --force to replace a comparison"
        raise ScenarioError(f"the folder is not empty; expected {expected}", str(folder))
    old = [*folder.glob("table.*"), *folder.glob("links/*/*.parquet")]
    old += [folder / name for name in (FIGURE, PAGE, SUMS)]
    for path in (*old, *(() if resume else (folder / JOURNAL, folder / STATE))):
        path.unlink(missing_ok=True)
    if not resume:
        rmtree(folder / KEPT, ignore_errors=True)


def write(comparison: Comparison, folder: Path, command: str) -> Iterator[Path]:
    """Write the table in its three forms, and the link tables; the paths written.

    Raises RunError with the path that cannot be written.
    """
    data = as_data(comparison, command)
    for name, content in (
        ("table.md", markdown(comparison, command)),
        ("table.csv", table_csv(comparison)),
        (RESULT, json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n"),
    ):
        path = folder / name
        write_file(path, content)
        yield path
    comparison.tables.save(folder / "links")
    (folder / JOURNAL).unlink(missing_ok=True)  # of results that are in the table now
    rmtree(folder / KEPT, ignore_errors=True)
    yield folder / "links"
