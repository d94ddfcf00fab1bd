"""``report.html`` of a comparison: its table, with the best and worst of each column marked."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from html import escape
from itertools import groupby
from pathlib import Path
from statistics import median

import numpy as np

from cosim.base.errors import CosimError
from cosim.comparison.comparison import Comparison
from cosim.comparison.requirement_margin import RequirementMargin
from cosim.comparison.rows import ComparisonRow, columns, format_number, header, notes, rows
from cosim.comparison.spec import PortMeasure
from cosim.comparison.variants import MetricColumn
from cosim.live.page import MOST
from cosim.measure.contact_metrics import PortEnergy
from cosim.reporting.html import Badge, PageData, command, folded, table, write_page

PAGE = "report.html"
#: Points of a curve in a small picture, and the colour of its ground by how the run ended.
MINI = 60
_GROUNDS = {
    "settling": "on-the-way", "moving": "on-the-way", "growing": "grows", "diverged": "grows",
    "stopped": "stopped",
}  # fmt: skip


class PageSizeError(CosimError):
    """A page that computes runs is too large."""


def write(comparison: Comparison, folder: Path, repeat: str, live: str = "") -> Path:
    """Write the report of a comparison. `repeat`: the command that made it.

    `live`: its part that computes runs, of :mod:`cosim.comparison.live_part`, or "". Raises
    PageSizeError if the page is too large with it, CosimError if it cannot be written.
    """
    c = comparison
    every = list(rows(c))
    ended = [row for row in every if row.is_stable]
    badge = Badge("finished", f"{len(ended)} of {len(every)} rows are stable")
    subtitle = f"{c.base.path} · {c.variants.path} · seeds {', '.join(map(str, c.seeds))}"
    data = PageData(_until(c), computes=bool(live))
    tables = "".join(_blocks(c, every, data))
    reference = escape(json.dumps(list(c.variants.picture.reference)))
    over = f'<section id="overlay" data-reference="{reference}"></section>' if data.signals else ""
    told = folded("Notes", "".join(f"<p>{escape(line)}</p>" for line in notes(c)), opened=True)
    rest = (
        f"{live}{tables}<p>✓ best, ✗ worst of a column where less is better. Not ranked: rows "
        "that are not stable, under which an arm does not move, and numbers that look alike. "
        f"{_seeds(c)}</p>"
        f"{told}{_names(c)}<h2>Repeat it</h2>{command('repeat', repeat)}"
    )
    path = write_page(folder / PAGE, c.variants.title, subtitle, badge, over, data, rest)
    if live and (size := path.stat().st_size) > MOST:
        raise PageSizeError(
            f"with runs to try, the report has {size / 1e6:.1f} MB, expected at most "
            f"{MOST / 1e6:.1f} MB, so it has none; choose fewer by --controllers, --operators or "
            "--links"
        )
    return path


def _seeds(c: Comparison) -> str:
    return "Median [least, greatest] over the seeds." if len(c.seeds) > 1 else ""


def _until(c: Comparison) -> float:
    """The time at which the curves end, s."""
    ends = [float(curve.t[-1]) for o in c.outcomes for curve in o.curves if len(curve.t)]
    return min(c.variants.picture.until, max(ends, default=0.0))


def _blocks(c: Comparison, every: Sequence[ComparisonRow], data: PageData) -> Iterator[str]:
    """A table for each link law and operator, whose curves are added to `data`."""
    shown, low, high, first = columns(c), *_heights(c), _moving(every)
    head = "".join(f"<th class='number'>{escape(header(x, unit))}</th>" for x, unit in shown)
    for (link, operator), group in groupby(every, key=lambda r: (r.link, r.operator)):
        block = list(group)
        marks = [_marks(block, column, unit) for column, unit in shown]
        laid = block[:2] if (link, operator) == first else []
        lines = "".join(
            f"<tr{_kind(row)}><td class='name'>{escape(row.label)}</td>"
            f"<td>{_mini(row, data, (low, high), laid=row in laid)}</td>"
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
            f"<th class='name'>controller</th><th>curves</th>{head}<th>stable?</th></tr>{lines}"
            "</table></div>"
        )


def _heights(c: Comparison) -> tuple[float, float]:
    """The least and greatest value in small pictures: around where runs start and should end."""
    starts = [float(curve.y[0]) for o in c.outcomes for curve in o.curves if len(curve.t)]
    values = [*c.variants.picture.reference, *starts, 0.0]
    margin = 0.35 * (max(values) - min(values)) or 1.0
    return min(values) - margin, max(values) + margin


def _moving(every: Sequence[ComparisonRow]) -> tuple[str, str]:
    """The first link law and operator that make the first controller move: shown at first."""
    moved: dict[tuple[str, str], float] = {}
    for row in every:
        curves = row.outcomes[0].curves if row.outcomes[0].verdict.stable else ()
        moved.setdefault(
            (row.link, row.operator), max((float(np.ptp(x.y)) for x in curves), default=0.0)
        )
    most = max(moved.values(), default=0.0)
    return next((key for key, value in moved.items() if value >= 0.5 * most), ("", ""))


def _mini(row: ComparisonRow, data: PageData, heights: tuple[float, float], *, laid: bool) -> str:
    """The curves of a row's first run, small; a button that lays them over those of other rows."""
    outcome, (low, high) = row.outcomes[0], heights
    if not outcome.curves:
        return ""
    names, lines = [], []
    for k, curve in enumerate(outcome.curves):
        label = f"{row.label}, {row.operator}, {row.link}: {curve.name}"
        name = f"{len(data.signals)} {curve.name}"
        data.add_curve(name, curve.name, "", curve.t, curve.y)
        names.append(name)
        inside = (curve.t <= data.end) & (curve.y >= low) & (curve.y <= high)
        x, y = curve.t[inside] / data.end * 120, (high - curve.y[inside]) / (high - low) * 36
        some = slice(None, None, max(1, len(x) // MINI))
        at = " ".join(f"{a:.4g},{b:.3g}" for a, b in zip(x[some], y[some], strict=True))
        lines.append(
            f'<polyline points="{at}" fill="none" stroke="var(--s{k % 7})"><title>{escape(label)}'
            "</title></polyline>"
        )
    described = escape(f"{row.label}, {row.operator}, {row.link}")
    return (
        f'<button class="mini {_GROUNDS.get(outcome.verdict.kind, "")}" data-signals="'
        f'{escape("|".join(names))}" data-label="{described}" aria-pressed="{str(laid).lower()}" '
        f'aria-label="Curves of {described}"><svg viewBox="0 0 120 36">{"".join(lines)}</svg>'
        "</button>"
    )


def _kind(row: ComparisonRow) -> str:
    """The attribute of a row that is not ranked."""
    if row.is_ranked:
        return ""
    return f" class='unranked{'' if row.is_stable else ' unstable'}'"


def _marks(block: Sequence[ComparisonRow], column: MetricColumn, unit: str) -> dict[int, str]:
    """Classes of the best and the worst cells of a column, by row; none if they look alike."""
    if isinstance(
        column.metric, PortMeasure | PortEnergy | RequirementMargin
    ):  # less is neither better nor worse
        return {}
    values = {
        i: median(found)
        for i, row in enumerate(block)
        if row.is_ranked and (found := row.values(column))
    }
    shown = {i: format_number(value, unit) for i, value in values.items()}
    ends = [format_number(f(values.values(), default=0.0), unit) for f in (min, max)]
    if ends[0] == ends[1]:
        return {}
    kinds = dict(zip(ends, (" best", " worst"), strict=True))
    return {i: kinds[text] for i, text in shown.items() if text in kinds}


def _names(c: Comparison) -> str:
    laws = [(x, c.variants.controllers[x].title) for x in c.chosen.controllers]
    people = [(x, c.variants.operators[x].title) for x in c.chosen.operators]
    links = [(x, c.variants.links[x].title) for x in c.chosen.links]
    return "".join(
        folded(title, table(["name", ""], found))
        for title, found in (("Controllers", laws), ("Operators", people), ("Links", links))
    )
