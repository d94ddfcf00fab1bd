"""``report.html`` of a comparison: its table, with the best and worst of each column marked."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from itertools import groupby
from pathlib import Path
from statistics import median

from cosim.analysis.contact_metrics import PortEnergy
from cosim.comparison.comparison import Comparison
from cosim.comparison.rows import ComparisonRow, columns, header, notes, rows
from cosim.comparison.variants import MetricColumn, PortMeasure
from cosim.reporting.html import Badge, PageData, command, folded, table, write_page

PAGE = "report.html"


def write(comparison: Comparison, folder: Path, repeat: str) -> Path:
    """Write the report of a comparison. `repeat`: the command that made it.

    Raises CosimError if it cannot be written.
    """
    c = comparison
    every = list(rows(c))
    ended = [row for row in every if all(o.verdict.stable for o in row.outcomes)]
    badge = Badge("finished", f"{len(ended)} of {len(every)} rows are stable")
    subtitle = f"{c.base.path} · {c.variants.path} · seeds {', '.join(map(str, c.seeds))}"
    body = "".join(_blocks(c, every))
    told = folded("Notes", "".join(f"<p>{escape(line)}</p>" for line in notes(c)), opened=True)
    rest = (
        f"<p>✓ best, ✗ worst of a column where less is better, among stable rows. {_seeds(c)}</p>"
        f"{told}{_names(c)}<h2>Repeat it</h2>{command('repeat', repeat)}"
    )
    return write_page(folder / PAGE, c.variants.title, subtitle, badge, body, PageData(0.0), rest)


def _seeds(c: Comparison) -> str:
    return "Median [least, greatest] over the seeds." if len(c.seeds) > 1 else ""


def _blocks(c: Comparison, every: Sequence[ComparisonRow]) -> Iterator[str]:
    shown = columns(c)
    head = "".join(f"<th class='number'>{escape(header(x, unit))}</th>" for x, unit in shown)
    for (link, operator), group in groupby(every, key=lambda r: (r.link, r.operator)):
        block = list(group)
        marks = [_marks(block, column) for column, _ in shown]
        lines = "".join(
            f"<tr><td>{escape(row.label)}</td>"
            + "".join(
                f'<td class="number{kinds.get(i, "")}">{escape(row.cell(x, unit))}</td>'
                for (x, unit), kinds in zip(shown, marks, strict=True)
            )
            + f"<td>{escape(row.stable)}</td></tr>"
            for i, row in enumerate(block)
        )
        yield (
            f"<h2>{escape(link)}, {escape(operator)}</h2>"
            f"<p>{escape(c.variants.links[link].title)}; "
            f"{escape(c.variants.operators[operator].title)}</p><div class='scroll'><table><tr>"
            f"<th>controller</th>{head}<th>stable?</th></tr>{lines}</table></div>"
        )


def _marks(block: Sequence[ComparisonRow], column: MetricColumn) -> dict[int, str]:
    """Classes of the best and the worst cell of a column, by row."""
    if isinstance(column.metric, PortMeasure | PortEnergy):  # less is neither better nor worse
        return {}
    values = {
        i: median(found)
        for i, row in enumerate(block)
        if (found := row.values(column)) and all(o.verdict.stable for o in row.outcomes)
    }
    if len(values) < 2 or min(values.values()) == max(values.values()):
        return {}
    kinds = {min(values.values()): " best", max(values.values()): " worst"}
    return {i: kinds[x] for i, x in values.items() if x in kinds}


def _names(c: Comparison) -> str:
    laws = [(x, c.variants.controllers[x].title) for x in c.chosen.controllers]
    people = [(x, c.variants.operators[x].title) for x in c.chosen.operators]
    links = [(x, c.variants.links[x].title) for x in c.chosen.links]
    return "".join(
        folded(title, table(["name", ""], found))
        for title, found in (("Controllers", laws), ("Operators", people), ("Links", links))
    )
