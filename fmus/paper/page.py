"""``report.html`` of a reproduction: every claim beside what was measured, and the figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from cosim.reporting import html
from cosim.reporting.html import Badge, PageData, cards, command, folded, picture, write_page

PAGE = "report.html"


def write(rows: Sequence[Mapping[str, Any]], folder: Path, repeat: str) -> Path:
    """Write the report of the claims `rows` (as in ``claims.json``) with the figures in `folder`.

    `repeat`: the command that made it. Raises CosimError if it cannot be written.
    """
    failed = [str(row["name"]) for row in rows if not row["passed"]]
    said = f"{len(rows) - len(failed)} of {len(rows)} claims hold"
    badge = Badge("failed" if failed or not rows else "passed", said)
    numbers = [("claims", str(len(rows))), ("hold", str(len(rows) - len(failed)))]
    numbers += [("do not hold", ", ".join(failed))] if failed else []
    sections = "".join(
        folded(title, _claims(list(claims)), opened=True)
        for title, claims in groupby(rows, key=lambda row: str(row["section"]))
    )
    pictures = "".join(picture(path, path.stem) for path in sorted(folder.glob("fig*.png")))
    figures = f'<h2>Figures</h2><div class="charts">{pictures}</div>' if pictures else ""
    rest = f"{figures}<h2>Claims</h2>{sections}<h2>Repeat it</h2>{command('repeat', repeat)}"
    title = "Towards Manipulability of Interactive Lagrangian Systems: reproduction"
    summary = cards(numbers)
    return write_page(folder / PAGE, title, folder.name, badge, summary, PageData(0.0), rest)


def _claims(claims: Sequence[Mapping[str, Any]]) -> str:
    head = ["claim", "holds", "statement", "source", "expected", "measured"]
    rows = [
        [
            str(row["name"]),
            "✓" if row["passed"] else "✗ no",
            f"{row['text']}{' (a hypothesis is broken on purpose)' if row['breaks'] else ''}"
            + (f"; {row['note']}" if row["note"] else ""),
            str(row["source"]),
            f"{row['expected']}{_unit(row)}",
            _measured(row["measured"]),
        ]
        for row in claims
    ]
    links = {str(row["name"]): f"runs/{row['cases'][0]}/" for row in claims if row["cases"]}
    return html.table(head, rows, 2, links)


def _unit(row: Mapping[str, Any]) -> str:
    return "" if row["unit"] == "1" else f" {row['unit']}"


def _measured(value: object) -> str:
    if isinstance(value, float | int):
        return f"{value:.4g}"
    return "nothing" if value is None else "never" if value == "inf" else str(value)
