"""The page of a certified region: a map over the least and the greatest delay, in three colours."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from cosim.base.errors import ScenarioError
from cosim.certify.region import Region, State, region
from cosim.certify.scenario import cut_loop
from cosim.links.table import DrawnTable
from cosim.loading.files import load
from cosim.record.folder import held_folder
from cosim.reporting.html import Badge, PageData, write_page
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario

#: As in the figures of sweeps: blue inside, red beyond, grey what is not known. What is broken is
#: hatched as well, for prints without colours.
_COLOURS: dict[State, str] = {"certified": "#4575b4", "unknown": "#c8c8c8", "broken": "#d73027"}
_MEANINGS: dict[State, str] = {
    "certified": "stable for all delays between the two, however they vary: proven",
    "unknown": "neither proven nor broken",
    "broken": "some delays between the two make a motion grow: constant ones, or an adversary's",
}
_SIDE, _LEFT, _BELOW = 420, 78, 56
#: A sign that can be seen on all colours, in the light and in the dark.
_SIGN = (
    "font-size: 26px; dominant-baseline: central; fill: black; stroke: white; stroke-width: 3px; "
    "paint-order: stroke"
)
#: Delays on a side of a map.
_STEPS = 16


@dataclass(frozen=True, slots=True)
class Mark:
    """A place on the map: a sign, its meaning, and the least and the greatest delay, s."""

    sign: str
    meaning: str
    least: float
    greatest: float


def drawing(region: Region, marks: Sequence[Mark] = ()) -> str:
    """The map as SVG, with `marks` where they are on it."""
    times = [d * region.period for d in region.delays]
    n, size = len(times), _SIDE / len(times)
    cells, hatched = [], list[str]()
    for i in range(n):
        for j in range(i, n):
            state = region.state(i, j)
            if state == "broken":
                hatched.append(_hatch(_LEFT + i * size, _SIDE - (j + 1) * size, size))
            text = f"{times[i]:g} to {times[j]:g} s: {state}"
            cells.append(
                f'<rect x="{_LEFT + i * size:.1f}" y="{_SIDE - (j + 1) * size:.1f}" '
                f'width="{size:.1f}" height="{size:.1f}" fill="{_COLOURS[state]}" '
                f'stroke="white" stroke-width="0.5"><title>{text}</title></rect>'
            )
    every = -(-n // 6)
    ticks = []
    for k in range(0, n, every):
        at, label = (k + 0.5) * size, f"{times[k]:.3g}"
        ticks.append(
            f'<text x="{_LEFT + at:.1f}" y="{_SIDE + 18}" text-anchor="middle">{label}</text>'
        )
        ticks.append(
            f'<text x="{_LEFT - 6}" y="{_SIDE - at + 5:.1f}" text-anchor="end">{label}</text>'
        )
    names = (
        f'<text x="{_LEFT + _SIDE / 2}" y="{_SIDE + 42}" text-anchor="middle">least delay, s</text>'
        f'<text transform="translate(18 {_SIDE / 2}) rotate(-90)" text-anchor="middle">'
        "greatest delay, s</text>"
    )
    signs = []
    step = (times[-1] - times[0]) / max(1, n - 1) or 1.0
    for mark in marks:
        x, y = ((b - times[0]) / step * size + size / 2 for b in (mark.least, mark.greatest))
        if x <= _SIDE and y <= _SIDE:
            signs.append(
                f'<text x="{_LEFT + x:.1f}" y="{_SIDE - y:.1f}" text-anchor="middle" '
                f'style="{_SIGN}">{mark.sign}'
                f"<title>{escape(mark.meaning)}</title></text>"
            )
    return (
        f'<svg viewBox="0 0 {_LEFT + _SIDE + 10} {_SIDE + _BELOW}" role="img" '
        f'aria-label="Certified region" class="chart" '
        f'fill="currentColor">{"".join(cells)}{_lines("".join(hatched))}{"".join(signs)}{"".join(ticks)}{names}</svg>'
    )


def _hatch(x: float, y: float, size: float) -> str:
    """Three diagonals of a cell."""
    half = size / 2
    return (
        f"M{x:.1f} {y + half:.1f}l{half:.1f} {-half:.1f}M{x:.1f} {y + size:.1f}l{size:.1f} "
        f"{-size:.1f}M{x + half:.1f} {y + size:.1f}l{half:.1f} {-half:.1f}"
    )


def _lines(path: str) -> str:
    return f'<path d="{path}" stroke="white" stroke-width="1.2" stroke-opacity="0.7"/>'


def write(region: Region, title: str, marks: Sequence[Mark], folder: Path) -> Path:
    """Write ``region.html``. Raises CosimError if it cannot be written."""
    legend = "".join(
        f'<li><svg width="12" height="12" aria-hidden="true"><path d="M0 0h12v12H0z" '
        f'fill="{_COLOURS[s]}"/>{_lines(_hatch(0, 0, 12)) if s == "broken" else ""}</svg> '
        f"<b>{s}</b>: {escape(text)}</li>"
        for s, text in _MEANINGS.items()
    )
    legend += "".join(
        f"<li>{m.sign} {escape(m.meaning)}: {m.least:g} to {m.greatest:g} s</li>" for m in marks
    )
    note = (
        "<p>All links have the same bounds. The map is of the linear loop, of small motions about "
        "the end of the run: even where it is certified, a single delay can break a large motion, "
        "for which <code>cosim falsify</code> searches. Proofs are checked and not kept.</p>"
    )
    return write_page(
        folder / "region.html", title, "certified region", Badge("finished", said(region)),
        f'{drawing(region, marks)}<ul style="list-style: none; padding: 0">{legend}</ul>',
        PageData(0.0), note,
    )  # fmt: skip


def said(region: Region) -> str:
    """The region in words: the greatest certified delays, and the least that break the loop."""
    times = [d * region.period for d in region.delays]
    top = region.highest[0]
    found = (
        f"certified from {times[0]:g} s up to {times[top]:g} s"
        if top >= 0
        else (f"nothing is certified from {times[0]:g} s on")
    )
    constant = [t for t, bad in zip(times, region.unstable, strict=True) if bad]
    grown = [times[j] for i, j in region.grown if i == 0]
    broken = [f"a constant delay of {constant[0]:g} s"] if constant else []
    if grown and (not constant or grown[0] < constant[0]):
        broken.append(f"an adversary up to {grown[0]:g} s")
    return f"{found}; broken by {' and by '.join(broken)}" if broken else f"{found}; not broken"


def mapped(
    scenario: Scenario,
    high: float,
    falsified: Path | None,
    folder: Path,
    say: Callable[[str], None] = lambda text: None,
) -> list[str]:
    """Write the map of a scenario over delays up to `high` (s) into `folder`; the result in words.

    `falsified`: a folder of ``cosim falsify``, whose failure is marked. Raises ScenarioError.
    """
    marks = [] if falsified is None else [failure(falsified)]
    loop, opened = cut_loop(scenario)
    first = int(loop.feeds_through)  # periods
    last = max(first + 1, round(high / loop.period))
    few = min(_STEPS, last - first + 1)
    delays = sorted({round(first + k * (last - first) / (few - 1)) for k in range(few)})
    found = region(loop, opened, delays, say)
    known = [x for x in loop.links if x.greatest is not None]
    if known:
        low = min(x.least / x.sends for x in known)
        top = max(x.most / x.sends for x in known)
        marks.append(Mark("○", "the delays of the links", low * loop.period, top * loop.period))
    with held_folder(folder):
        path = write(found, scenario.title, marks, folder)
    return [f"{'region':<12} {said(found)}", f"{'map':<12} {path}"]


def failure(folder: Path) -> Mark:
    """The least and the greatest delay of the failure in a folder of ``cosim falsify``.

    Raises ScenarioError if there is none.
    """
    file = folder / "failing.toml"
    if not file.exists():
        raise ScenarioError(
            f"{folder}: found no failing.toml; expected the folder of a failure of cosim falsify"
        )
    laws = [link.table.law for link in assemble(load(file)).links
            if isinstance(link.table, DrawnTable)]  # fmt: skip
    if not laws:
        raise ScenarioError(f"{file}: found no delays of links; expected a law for each link")
    low, high = min(x.minimum for x in laws), max(x.maximum for x in laws)
    return Mark("×", "the failure of cosim falsify, of a large motion", low, high)
