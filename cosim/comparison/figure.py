"""The figure of a comparison: a small trajectory for every run of a table, in a matrix.

A row a controller, a column an operator and link law. Each cell has the same axes: time to
`until`, and the signals of the variants file with their reference dashed. The background says how
it ended: white at rest, yellow on the way or moving, red diverged or growing. With several seeds
the first is drawn.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.base.files import write_file
from cosim.comparison.comparison import Comparison
from cosim.comparison.measure import CaseOutcome, Curve
from cosim.comparison.rows import columns, format_number
from cosim.reporting.figures import DPI, load

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
_DASHED: dict[str, Any] = {"color": "0.5", "linestyle": (0, (4, 3))}
_GROUND = {
    "at rest": "#FFFFFF", "settling": "#FFF8DC", "moving": "#FFE9A8", "growing": "#F6B8A8",
    "diverged": "#F6B8A8", "stopped": "#D9D9D9",
}  # fmt: skip
# Inches: a cell (its width where there are many, and at most), the distance between cells and
# between link laws, the margins, and the width that the caption needs.
_CELL, _WIDEST, _GAP, _WIDE = (1.15, 0.62), 2.6, 0.05, 0.14
_LEFT, _RIGHT, _TOP, _BOTTOM, _WIDTH = 1.15, 0.15, 0.85, 0.62, 7.5


def draw(comparison: Comparison, path: Path) -> Path:
    """Draw a comparison into the PNG `path`. Raises RunError if it cannot be written."""
    load()
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update({"font.family": "DejaVu Sans", "font.size": 7.5})
        image = _render(comparison)
    write_file(path, image)
    return path


def _render(comparison: Comparison) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    c, cells = comparison.chosen, _Cells.of(comparison)
    sheet = Figure(figsize=(cells.width, cells.height), dpi=DPI)
    canvas: Any = FigureCanvasAgg(sheet)  # partly untyped
    # one diagram in inches: a hundred small ones would take a hundred times as long
    ax = sheet.add_axes((0.0, 0.0, 1.0, 1.0), frameon=False)
    ax.set(xlim=(0, cells.width), ylim=(0, cells.height), xticks=[], yticks=[])
    for i, link in enumerate(c.links):
        for j, operator in enumerate(c.operators):
            for k, controller in enumerate(c.controllers):
                outcome = comparison.of(link, operator, controller)[0]
                _cell(ax, cells, cells.corner(i, j, k), outcome, comparison)
            _column(ax, cells, cells.corner(i, j, len(c.controllers) - 1), operator)
    _labels(ax, cells, comparison)
    buffer = io.BytesIO()
    canvas.print_png(buffer, metadata={"Software": None}, pil_kwargs={"compress_level": 4})
    return buffer.getvalue()


@dataclass(frozen=True, slots=True)
class _Cells:
    """Places of cells, inches, and the axes that they share: `until` s, `low` to `high`."""

    counts: tuple[int, int, int]  # link laws, operators, controllers
    size: tuple[float, float]
    until: float
    low: float
    high: float

    @classmethod
    def of(cls, comparison: Comparison) -> _Cells:
        """Axes for where things start and should be, and a third as much around it."""
        c, picture = comparison.chosen, comparison.variants.picture
        curves = [curve for o in comparison.outcomes for curve in o.curves if len(curve.t)]
        values = [*picture.reference, *(float(curve.y[0]) for curve in curves), 0.0]
        ends = max((float(curve.t[-1]) for curve in curves), default=1.0)
        margin = 0.35 * (max(values) - min(values)) or 1.0
        counts = (len(c.links), len(c.operators), len(c.controllers))
        fitting = (_WIDTH - _LEFT - _RIGHT) / (counts[0] * counts[1]) - _GAP - _WIDE
        size = (min(_WIDEST, max(_CELL[0], fitting)), _CELL[1])
        return cls(
            counts, size, min(picture.until, ends), min(values) - margin, max(values) + margin
        )

    @property
    def width(self) -> float:
        """Width of the sheet."""
        links, operators, _ = self.counts
        cells = links * operators * (self.size[0] + _GAP) + (links - 1) * _WIDE
        return max(_LEFT + cells + _RIGHT, _WIDTH)

    @property
    def height(self) -> float:
        """Height of the sheet."""
        return _TOP + self.counts[2] * (self.size[1] + _GAP) + _BOTTOM

    def corner(self, link: int, operator: int, controller: int) -> tuple[float, float]:
        """Lower left corner of a cell."""
        column = link * self.counts[1] + operator
        x = _LEFT + column * (self.size[0] + _GAP) + link * _WIDE
        return x, self.height - _TOP - controller * (self.size[1] + _GAP) - self.size[1]

    def x(self, t: Any) -> Any:
        """Time, s, in inches from the corner."""
        return np.asarray(t, dtype=np.float64) / self.until * self.size[0]

    def y(self, value: Any) -> Any:
        """A value in inches from the corner; NaN outside of the cell: the line leaves it."""
        y = (np.asarray(value, dtype=np.float64) - self.low) / (self.high - self.low)
        return np.where((y >= 0) & (y <= 1), y, np.nan) * self.size[1]


def _cell(
    ax: Axes,
    cells: _Cells,
    corner: tuple[float, float],
    outcome: CaseOutcome,
    comparison: Comparison,
) -> None:
    from matplotlib.patches import Rectangle

    (x, y), (width, height), ground = corner, cells.size, _GROUND[outcome.verdict.kind]
    box = Rectangle(corner, width, height, facecolor=ground, edgecolor="0.6", linewidth=0.5)
    ax.add_patch(box)
    for value in comparison.variants.picture.reference:
        level = y + float(cells.y(value))
        ax.plot([x, x + width], [level, level], linewidth=0.5, **_DASHED)
    _curves(ax, corner, cells, outcome.curves)
    said = _cell_label(outcome, comparison)
    if said:
        patch = {"facecolor": ground, "edgecolor": "none", "alpha": 0.8, "pad": 0.8}
        x, y = x + width - 0.04, y + 0.04
        ax.text(x, y, said, ha="right", va="bottom", size=6, color="0.2", bbox=patch)


def _curves(ax: Axes, corner: tuple[float, float], cells: _Cells, curves: Sequence[Curve]) -> None:
    for k, curve in enumerate(curves):
        colour = _COLOURS[k % len(_COLOURS)]
        within = curve.t <= cells.until
        x, y = corner[0] + cells.x(curve.t[within]), corner[1] + cells.y(curve.y[within])
        ax.plot(x, y, color=colour, linewidth=0.8, solid_joinstyle="round")


def _cell_label(outcome: CaseOutcome, comparison: Comparison) -> str:
    """The first time that there is, or what became of the run."""
    v = outcome.verdict
    if not v.ended:
        return v.text.removeprefix("no: ")
    if not v.stable:
        return v.kind
    times = [x for x, unit in columns(comparison) if unit == "s" and x.name in outcome.numbers]
    if not times:
        return ""
    text = format_number(outcome.numbers[times[0].name][0], "s")
    return text if text == "never" else f"{text} s"


def _column(ax: Axes, cells: _Cells, lowest: tuple[float, float], operator: str) -> None:
    """The operator above a column of cells, and the time axis below it."""
    x, y = lowest
    middle, top = x + cells.size[0] / 2, cells.height - _TOP
    ax.text(middle, top + 0.08, operator, ha="center", weight="bold")
    ax.text(x, y - 0.06, "0", ha="left", va="top", size=6, color="0.3")
    end = f"{cells.until:g} s"
    ax.text(x + cells.size[0], y - 0.06, end, ha="right", va="top", size=6, color="0.3")


def _labels(ax: Axes, cells: _Cells, comparison: Comparison) -> None:
    """Controllers on the left, link laws above, and what is drawn below."""
    c = comparison.chosen
    for k, controller in enumerate(c.controllers):
        y = cells.corner(0, 0, k)[1] + cells.size[1] / 2
        ax.text(_LEFT - 0.08, y, controller, ha="right", va="center", size=8)
    for i, link in enumerate(c.links):
        first, last = cells.corner(i, 0, 0)[0], cells.corner(i, len(c.operators) - 1, 0)[0]
        x = (first + last + cells.size[0]) / 2
        ax.text(x, cells.height - _TOP + 0.32, f"link: {link}", ha="center", size=9)
    title = comparison.variants.title
    ax.text(_LEFT, cells.height - 0.12, title, ha="left", va="top", size=10)
    _caption(ax, comparison)


def _caption(ax: Axes, comparison: Comparison) -> None:
    """Explain the lines, the numbers and the grounds."""
    from matplotlib.patches import Rectangle

    x, y = _LEFT, 0.3
    names = [curve.name for curve in max((o.curves for o in comparison.outcomes), key=len)]
    for k, name in enumerate(names):
        ax.plot([x, x + 0.22], [y, y], color=_COLOURS[k % len(_COLOURS)], linewidth=1.2)
        x = _draw_text(ax, x + 0.27, y, name)
    if comparison.variants.picture.reference:
        ax.plot([x, x + 0.22], [y, y], linewidth=0.7, **_DASHED)
        x = _draw_text(ax, x + 0.27, y, "reference")
    labels = [column.label for column, unit in columns(comparison) if unit == "s"]
    if labels:
        _draw_text(ax, x, y, f"number: {', or else '.join(labels)}")
    x, y, found = _LEFT, 0.11, {o.verdict.kind for o in comparison.outcomes}
    for kind in (kind for kind in _GROUND if kind in found):
        box = Rectangle((x, y - 0.06), 0.2, 0.12, facecolor=_GROUND[kind], edgecolor="0.6")
        ax.add_patch(box)
        x = _draw_text(ax, x + 0.25, y, kind)


def _draw_text(ax: Axes, x: float, y: float, text: str) -> float:
    """Write a text at (x, y); where the next thing may begin."""
    ax.text(x, y, text, va="center", size=7)
    return x + 0.055 * len(text) + 0.16
