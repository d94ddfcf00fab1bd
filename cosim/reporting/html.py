"""One self-contained HTML page: no request leaves it, and its pictures move in any browser.

The plots are drawn by uPlot (MIT licence), whose released files the build puts into ``assets/``;
they are copied into the page.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import RunError
from cosim.base.files import write_file
from cosim.reporting.thinning import thin

Array = NDArray[np.float64]
#: The words of a verdict, everywhere the same; "finished": nothing was to be judged. The last three
#: are about two runs.
Word = Literal[
    "passed", "failed", "inconclusive", "error", "finished", "running",
    "identical", "equal", "different",
]  # fmt: skip
_MARKS: Mapping[str, str] = {
    "passed": "✓", "failed": "✗", "inconclusive": "?", "error": "✗", "finished": "●",
    "running": "▶", "identical": "=", "equal": "≈", "different": "≠",
}  # fmt: skip
#: Scripts and styles of the page itself are all that it may use.
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
    "base-uri 'none'; form-action 'none'"
)


@dataclass(frozen=True, slots=True)
class Badge:
    """The verdict of a report: how it ended, and one sentence why."""

    word: Word
    reason: str = ""

    @property
    def html(self) -> str:
        """The verdict as a badge with the sentence behind it."""
        badge = f'<span class="verdict {self.word}">{_MARKS[self.word]} {self.word}</span>'
        return f"<p>{badge} {escape(self.reason)}</p>"


@dataclass(frozen=True, slots=True)
class PlottedPanel:
    """One diagram: (name, label) of signals of one `unit` over time, and dashed `reference` lines.

    `place`: the element of the page that it stands in; `colours`: the number of the colour of each
    signal, () for those of their order.
    """

    title: str
    unit: str
    series: tuple[tuple[str, str], ...]
    reference: tuple[float, ...] = ()
    place: str = "panels"
    colours: tuple[int, ...] = ()

    def data(self) -> dict[str, Any]:
        """The data that the page reads."""
        series: list[dict[str, Any]] = [{"name": name, "label": x} for name, x in self.series]
        for one, colour in zip(series, self.colours, strict=False):
            one["colour"] = colour
        return {
            "title": self.title, "unit": self.unit, "series": series,
            "reference": list(self.reference), "place": self.place,
        }  # fmt: skip


@dataclass(frozen=True, slots=True)
class TimedEvent:
    """Something that happened from `t` to `to`, s, marked in every diagram."""

    t: float
    label: str
    to: float | None = None

    def data(self) -> dict[str, Any]:
        """The data that the page reads."""
        found: dict[str, Any] = {"t": self.t, "label": self.label}
        return found if self.to is None else {**found, "to": self.to}


@dataclass(slots=True)
class PageData:
    """The content of a page: signals from `begin` to `end` (s), diagrams, events, arms.

    `arms_note`: a sentence below the arms. `live`: the address, below that of the page, from which
    values of the signals come while it is open; the joints of its arms are names of signals.
    """

    end: float
    frame: float = 0.05
    signals: dict[str, dict[str, Any]] = field(default_factory=dict)
    panels: list[PlottedPanel] = field(default_factory=list)
    events: list[TimedEvent] = field(default_factory=list)
    arms: list[dict[str, Any]] = field(default_factory=list)
    arms_note: str = ""
    start: float = 0.0
    live: str = ""
    begin: float = 0.0

    def add(self, name: str, unit: str, values: Array, dt: float, most: int) -> None:
        """Add a signal (n,) with a value every `dt` s: at most `most` of them, every extreme."""
        rows = thin(values, max(4, most))
        self.signals[name] = {
            "unit": unit, "dt": dt, "i": packed(rows, "<u4"), "y": packed(values[rows], "<f4"),
        }  # fmt: skip

    def add_curve(self, name: str, label: str, unit: str, t: NDArray[Any], y: NDArray[Any]) -> None:
        """Add a curve, thinned already: `t` (s) and `y`, (n,)."""
        self.signals[name] = {
            "label": label, "unit": unit, "t": packed(t, "<f4"), "y": packed(y, "<f4"),
        }  # fmt: skip

    def text(self) -> str:
        """The data as JSON that may stand inside an element of the page."""
        document = {
            "end": self.end, "start": self.start, "frame": self.frame, "signals": self.signals,
            "panels": [p.data() for p in self.panels], "events": [e.data() for e in self.events],
            "arms": self.arms, "live": self.live,
            **({"begin": self.begin} if self.begin else {}),
        }  # fmt: skip
        return embedded(document)


def embedded(document: Mapping[str, Any]) -> str:
    """A document as JSON that may stand inside an element of the page."""
    return json.dumps(document, separators=(",", ":")).replace("</", "<\\/")


def packed(values: NDArray[Any], kind: str) -> str:
    """Numbers (n,) as the page decodes them: little-endian bytes in base64."""
    with np.errstate(over="ignore"):
        return base64.b64encode(values.astype(kind).tobytes()).decode("ascii")


# ---- pieces of a page -------------------------------------------------------------------------


def cards(numbers: Iterable[tuple[str, str]]) -> str:
    """Boxes with the numbers that matter: (label, value)."""
    found = "".join(
        f'<div class="card"><span>{escape(label)}</span><b>{escape(value)}</b></div>'
        for label, value in numbers
    )
    return f'<section class="cards" aria-label="Results">{found}</section>' if found else ""


def table(
    head: Sequence[str],
    rows: Iterable[Sequence[str]],
    numbers: int = 0,
    links: Mapping[str, str] | None = None,
) -> str:
    """A table of texts; its last `numbers` columns are aligned to the right.

    `links`: where texts of the first column lead to, relative to the page.
    """
    first, links = len(head) - numbers, links or {}

    def cell(tag: str, i: int, text: str) -> str:
        kind = ' class="number"' if i >= first else ""
        inside = escape(text)
        if tag == "td" and i == 0 and text in links:
            inside = f'<a href="{escape(links[text])}">{inside}</a>'
        return f"<{tag}{kind}>{inside}</{tag}>"

    top = "".join(cell("th", i, text) for i, text in enumerate(head))
    body = "".join(
        f"<tr>{''.join(cell('td', i, text) for i, text in enumerate(row))}</tr>" for row in rows
    )
    return f'<div class="scroll"><table><tr>{top}</tr>{body}</table></div>'


def folded(title: str, content: str, *, opened: bool = False) -> str:
    """A part of the page that can be closed."""
    state = " open" if opened else ""
    return f"<details{state}><summary>{escape(title)}</summary>{content}</details>"


def command(name: str, text: str) -> str:
    """A command to copy."""
    return (
        f'<div class="copy"><code id="{name}">{escape(text)}</code>'
        f'<button data-copy="{name}" hidden>Copy</button></div>'
    )


def picture(path: Path, title: str) -> str:
    """A PNG file inside the page. Raises RunError if it cannot be read."""
    try:
        data = base64.b64encode(path.read_bytes()).decode("ascii")
    except OSError as error:
        raise RunError(f"{path}: cannot be read: {error}") from None
    return (
        f'<figure><img src="data:image/png;base64,{data}" alt="{escape(title)}">'
        f"<figcaption>{escape(title)}</figcaption></figure>"
    )


def histogram(title: str, unit: str, values: Array, marks: Mapping[str, float]) -> str:
    """A histogram of values (n,) as a drawing; `marks`: labelled values, all in `unit`."""
    values = values[np.isfinite(values)]
    if not values.size:
        return ""
    low, high = float(values.min()), float(values.max())
    high = high if high > low else low + (abs(low) or 1.0)
    counts, edges = np.histogram(values, bins=40, range=(low, high))
    most, width = counts.max(), 480 / len(counts)
    bars = "".join(
        f'<rect x="{40 + i * width:.1f}" y="{150 - 120 * n / most:.1f}" width="{width - 1:.1f}" '
        f'height="{120 * n / most:.1f}" fill="var(--s0)"><title>{edges[i]:.4g} to '
        f"{edges[i + 1]:.4g} {escape(unit)}: {n}</title></rect>"
        for i, n in enumerate(counts)
        if n
    )
    lines = []
    for k, (label, value) in enumerate(marks.items()):
        x = 40 + 480 * (value - low) / (high - low)
        lines.append(
            f'<line x1="{x:.1f}" x2="{x:.1f}" y1="26" y2="150" stroke="var(--s1)" '
            f'stroke-dasharray="4 3"/><text x="{x:.1f}" y="{12 + 12 * (k % 2)}" '
            f'text-anchor="middle">{escape(label)} {value:.3g}</text>'
        )
    ends = (
        f'<text class="faint" x="40" y="168">{low:.4g}</text><text class="faint" x="520" y="168" '
        f'text-anchor="end">{high:.4g} {escape(unit)}</text>'
    )
    return (
        f'<figure><figcaption>{escape(title)}</figcaption><svg class="chart" viewBox="0 0 560 176" '
        f'role="img" aria-label="{escape(title)}"><line x1="40" x2="520" y1="150" y2="150" '
        f'stroke="var(--line)"/>{bars}{"".join(lines)}{ends}</svg></figure>'
    )


# ---- the page ---------------------------------------------------------------------------------


def page_text(
    title: str,
    subtitle: str,
    verdict: Badge,
    summary: str,
    data: PageData,
    rest: str,
    points: str = "",
) -> str:
    """The text of a page: `summary` and `rest` are HTML above and below the diagrams.

    `points`: the runs of a study as JSON, for the elements of :mod:`cosim.reporting.points`. Raises
    CosimError where uPlot is not installed.
    """
    moving = bool(data.arms)
    label = "Arms over time; drag to turn" if moving else ""
    arm = f'<svg class="arm" id="arm" role="img" aria-label="{label}" viewBox="-1 -1 2 2"></svg>'
    names = f'<p class="arms" id="arms"></p><p class="arms">{escape(data.arms_note)}</p>'
    body = f"""<main><header><h1>{escape(title)}</h1><p>{escape(subtitle)}</p>
{verdict.html}</header>{summary}{_BAR if data.signals else ""}
<div class="top{"" if moving else " alone"}"><section id="panels" aria-label="Diagrams"></section>
{f'<aside class="aside">{arm}{names}</aside>' if moving else ""}</div>
{_CHOOSER if data.panels else ""}{rest}
{_FOOT if data.signals else ""}</main>"""
    script = f"<script>{_asset('common.js')}</script>"
    if data.signals:
        script += (
            f'<script type="application/json" id="data">{data.text()}</script>'
            f"<script>{_asset('uPlot.iife.js')}</script><script>{_asset('report.js')}</script>"
        )
    if points:
        script += (
            f'<script type="application/json" id="points">{points}</script>'
            f"<script>{_asset('points.js')}</script>"
        )
    style = (_asset("uPlot.min.css") if data.signals else "") + _asset("report.css")
    policy = _POLICY + ("; connect-src 'self'" if data.live else "")
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1"><style>{style}</style></head>
<body>{body}{script}</body></html>
"""


def write_page(
    path: Path,
    title: str,
    subtitle: str,
    verdict: Badge,
    summary: str,
    data: PageData,
    rest: str,
    points: str = "",
) -> Path:
    """Write a report: :func:`page_text` as a file.

    Raises RunError if it cannot be written, CosimError where uPlot is not installed.
    """
    page = page_text(title, subtitle, verdict, summary, data, rest, points)
    write_file(path, page)
    return path


_BAR = """<div id="bar"><button id="play">▶ Play</button><select id="speed" aria-label="Speed">
<option value="0.25">¼ ×</option><option value="1" selected>1 ×</option>
<option value="4">4 ×</option><option value="10">10 ×</option></select>
<input type="range" id="time" min="0" max="1" value="0" aria-label="Time"><output id="now"></output>
<button id="whole">Whole run</button></div>"""
_FOOT = """<footer>Drag in a diagram to zoom, double-click or “Whole run” to return; the arrow keys
move the time. Thinned signals keep every extreme. Diagrams: uPlot, MIT licence, © Leon Sorokin.
</footer>"""
_CHOOSER = """<details id="chooser"><summary>All signals</summary>
<input type="search" id="filter" placeholder="Find a signal" aria-label="Find a signal">
<div id="signals"></div><section id="chosen"></section></details>"""


@cache
def _asset(name: str) -> str:
    text = (files("cosim.reporting") / "assets" / name).read_text(encoding="utf-8")
    return text.replace("</script", "<\\/script")
