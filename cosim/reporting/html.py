"""One self-contained HTML page: no request leaves it, and its pictures move in any browser.

The plots are drawn by uPlot (MIT licence), whose released files the build puts into ``assets/``;
they are copied into the page.
"""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import RunError
from cosim.base.files import write_file
from cosim.base.units import engineering, prefixed, readable
from cosim.reporting.thinning import Thinned

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
#: All that a page may use: its own scripts and styles; one that computes has a worker too.
_COMPUTES = " 'wasm-unsafe-eval'; worker-src blob:"
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

    def data(self, greatest: float = 0.0) -> dict[str, Any]:
        """The data that the page reads. `greatest`: the greatest magnitude of its signals."""
        series: list[dict[str, Any]] = [{"name": name, "label": x} for name, x in self.series]
        for one, colour in zip(series, self.colours, strict=False):
            one["colour"] = colour
        scale, unit = prefixed(max([greatest, *map(abs, self.reference)]), self.unit)
        return {
            "title": self.title, "unit": unit, "scale": scale, "series": series,
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

    `greatest`: magnitude of each signal, by which its unit gets a prefix where people read it.
    `arms_note`: a sentence below the arms. `live`: the address, below that of the page, from which
    values of the signals come while it is open; the joints of its arms are names of signals.
    `computes`: it runs WebAssembly in a worker of its own.
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
    computes: bool = False
    begin: float = 0.0
    greatest: dict[str, float] = field(default_factory=dict)

    def add(self, name: str, unit: str, values: Array, dt: float, most: int) -> None:
        """Add a signal (n,) with a value every `dt` s: at most `most` of them, every extreme."""
        kept = Thinned(len(values), max(4, most))
        kept.add(values)
        self.add_thinned(name, unit, kept, dt)

    def add_thinned(self, name: str, unit: str, kept: Thinned, dt: float) -> None:
        """Add a signal with a sample every `dt` s, of which some are kept."""
        self.greatest[name] = kept.greatest
        scale, shown = prefixed(kept.greatest, unit)
        self.signals[name] = {
            "unit": shown, "scale": scale, "dt": dt, "i": packed(kept.rows, "<u4"),
            "y": packed(kept.y, "<f4"),
        }  # fmt: skip

    def add_curve(self, name: str, label: str, unit: str, t: NDArray[Any], y: NDArray[Any]) -> None:
        """Add a curve, thinned already: `t` (s) and `y`, (n,)."""
        self.signals[name] = {
            "label": label, **self._shown(name, unit, y), "t": packed(t, "<f4"),
            "y": packed(y, "<f4"),
        }  # fmt: skip

    def _shown(self, name: str, unit: str, values: Array) -> dict[str, Any]:
        """The unit in which a person reads a signal (n,), and the factor to it."""
        finite = values[np.isfinite(values)]
        self.greatest[name] = float(np.abs(finite).max()) if finite.size else 0.0
        scale, shown = prefixed(self.greatest[name], unit)
        return {"unit": shown, "scale": scale}

    def text(self) -> str:
        """The data as JSON that may stand inside an element of the page."""
        document = {
            "end": self.end, "start": self.start, "frame": self.frame, "signals": self.signals,
            "panels": [p.data(self._most(p)) for p in self.panels],
            "events": [e.data() for e in self.events],
            "arms": self.arms, "live": self.live,
            **({"begin": self.begin} if self.begin else {}),
        }  # fmt: skip
        return embedded(document)

    def _most(self, panel: PlottedPanel) -> float:
        return max((self.greatest.get(name, 0.0) for name, _ in panel.series), default=0.0)


def embedded(document: Mapping[str, Any]) -> str:
    """A document as JSON that may stand inside an element of the page."""
    return json.dumps(document, separators=(",", ":")).replace("</", "<\\/")


def packed(values: NDArray[Any], kind: str) -> str:
    """Numbers (n,) as the page decodes them: little-endian bytes in base64."""
    with np.errstate(over="ignore"):
        return base64.b64encode(values.astype(kind).tobytes()).decode("ascii")


# ---- pieces of a page -------------------------------------------------------------------------


class Card(NamedTuple):
    """A number that matters: its `label`, its `value` with the unit, and a `note` below.

    `key`: its name in files, which is seen when the pointer rests on the card; `word`: a verdict
    that the value tells.
    """

    label: str
    value: str
    key: str = ""
    note: str = ""
    word: str = ""


def cards(numbers: Iterable[tuple[str, str] | Card]) -> str:
    """Boxes with the numbers that matter: cards, or (label, value)."""
    found = "".join(_card(Card(*number)) for number in numbers)
    return f'<section class="cards" aria-label="Results">{found}</section>' if found else ""


def _card(card: Card) -> str:
    label = escape(whole(capital(card.label)))
    title = f' title="{escape(card.key)}"' if card.key else ""
    note = f"<i>{escape(whole(card.note))}</i>" if card.note else ""
    value = marked(card.value, card.word)
    return f'<div class="card"{title}><span>{label}</span><b>{value}</b>{note}</div>'


def marked(text: str, word: str) -> str:
    """HTML of a text that tells the verdict `word`, in its colour and with its mark."""
    if word not in _MARKS:
        return escape(text)
    return f'<span class="told {word}">{_MARKS[word]} {escape(text)}</span>'


def capital(text: str) -> str:
    """A text with a capital first letter, unless its first word is a symbol or a name of a file."""
    word = re.split(r"[ ,]", text)[0]
    return (
        text[:1].upper() + text[1:] if len(word) > 1 and word.replace("'", "").isalpha() else text
    )


def whole(text: str) -> str:
    """A text in which no line breaks between a number and its unit."""
    return re.sub(r"(?<=\d) (?=(?!to\b|on\b|and\b)[^\W\d]{1,4}\b|%)", "\u00a0", text)


def table(
    head: Sequence[str],
    rows: Iterable[Sequence[str]],
    numbers: int = 0,
    links: Mapping[str, str] | None = None,
    marks: Sequence[str] = (),
) -> str:
    """A table of texts; its last `numbers` columns are aligned to the right.

    `links`: where texts of the first column lead to, relative to the page; `marks`: the verdict of
    each row, which colours its first column.
    """
    first, links = len(head) - numbers, links or {}
    words = iter(marks)

    def cell(tag: str, i: int, text: str) -> str:
        kind = ' class="number"' if i >= first else ""
        inside = marked(text, next(words, "")) if tag == "td" and i == 0 else escape(text)
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


def histogram(
    title: str,
    unit: str,
    values: Array,
    marks: Mapping[str, float],
    often: NDArray[np.int64] | None = None,
) -> str:
    """A histogram of values (n,) as a drawing; `marks`: labelled values, all in `unit`.

    `often`: how often each value was, (n,); default: once.
    """
    finite = np.isfinite(values)
    values, often = values[finite], None if often is None else often[finite]
    if not values.size:
        return ""
    factor, shown = prefixed(float(np.abs(values).max()), unit)
    values = factor * values
    low, high = float(values.min()), float(values.max())
    high = high if high > low else low + (abs(low) or 1.0)
    counts, edges = np.histogram(values, bins=40, range=(low, high), weights=often)
    most, width = int(counts.max()), 480 / len(counts)
    bars = "".join(
        f'<rect x="{40 + i * width:.1f}" y="{150 - 110 * n / most:.1f}" width="{width - 1:.1f}" '
        f'height="{110 * n / most:.1f}" fill="var(--s0)"><title>{readable(edges[i])} to '
        f"{readable(edges[i + 1])} {escape(shown)}: {n}</title></rect>"
        for i, n in enumerate(counts)
        if n
    )
    lines, free = [], [0.0] * 3
    for label, mark in sorted(marks.items(), key=lambda pair: pair[1]):
        x, text = 40 + 480 * (factor * mark - low) / (high - low), engineering(mark, unit, 3)
        half = 3.4 * len(f"{label} {text}")
        row = next((k for k in range(3) if x - half > free[k]), 0)
        free[row] = x + half
        lines.append(
            f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{14 + 12 * row}" y2="150" stroke="var(--s1)" '
            f'stroke-dasharray="4 3"/><text x="{min(x, 558 - half):.1f}" y="{11 + 12 * row}" '
            f'text-anchor="middle">{escape(label)} {escape(text)}</text>'
        )
    ticks = round_ticks(low, high)
    below = "".join(
        f'<line x1="{x:.1f}" x2="{x:.1f}" y1="150" y2="154" stroke="var(--line)"/>'
        f'<text class="faint" x="{x:.1f}" y="168" text-anchor="middle">{readable(tick)}'
        f"{f' {escape(shown)}' if tick == ticks[-1] else ''}</text>"
        for tick in ticks
        for x in [40 + 480 * (tick - low) / (high - low)]
    )
    above = (
        f'<text class="faint" x="36" y="44" text-anchor="end">{most}</text>'
        '<text class="faint" x="36" y="153" text-anchor="end">0</text>'
    )
    return (
        f'<figure><figcaption>{escape(title)}</figcaption><svg class="chart" viewBox="0 0 560 176" '
        f'role="img" aria-label="{escape(title)}"><line x1="40" x2="520" y1="150" y2="150" '
        f'stroke="var(--line)"/>{bars}{"".join(lines)}{below}{above}</svg></figure>'
    )


def round_ticks(low: float, high: float) -> list[float]:
    """Multiples of 1, 2 or 5 times a power of ten from `low` to `high`, in the same unit."""
    power = 10.0 ** np.floor(np.log10((high - low) / 6.0))
    step = next(step for k in (1, 2, 5, 10) if (high - low) / (step := k * power) < 6.0)
    return [float(k * step) for k in range(int(np.ceil(low / step)), int(high // step) + 1)]


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
    if data.computes:
        policy = policy.replace(
            "script-src 'unsafe-inline'", f"script-src 'unsafe-inline'{_COMPUTES}"
        )
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
