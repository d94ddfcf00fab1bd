"""The figure of a comparison: a small trajectory for every run of a table, in a matrix.

A row a controller, a column an operator and link law. Each cell has the same axes: time to
`until`, and the signals of the variants file with their reference dashed. The background says how
it ended: white at rest, yellow on the way or moving, red diverged or growing. With several seeds
the first is drawn.
"""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.compare.comparison import Comparison
from cosim.compare.measure import Curve, Outcome
from cosim.compare.rows import columns, shown
from cosim.errors import RunError
from cosim.report.figures import DPI, load

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
_DASHED: dict[str, Any] = {"color": "0.5", "linestyle": (0, (4, 3))}
_GROUND = {
    "at rest": "#FFFFFF", "settling": "#FFF8DC", "moving": "#FFE9A8", "growing": "#F6B8A8",
    "diverged": "#F6B8A8", "stopped": "#D9D9D9",
}  # fmt: skip
# Inches: a cell, the distance between cells and between link laws, and the margins.
_CELL, _GAP, _WIDE = (1.15, 0.62), 0.05, 0.14
_LEFT, _RIGHT, _TOP, _BOTTOM = 1.15, 0.15, 0.85, 0.5
_WIDTH = 7.5  # at least, so that the caption fits


def draw(comparison: Comparison, path: Path) -> Path:
    """Draw a comparison into the PNG `path`. Raises RunError if it cannot be written."""
    load()
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update({"font.family": "DejaVu Sans", "font.size": 7.5})
        image = _render(comparison)
    try:
        path.write_bytes(image)
    except OSError as error:
        raise RunError(f"cannot write {path}: {os.strerror(error.errno or 0)}") from error
    return path


def _render(comparison: Comparison) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    c, (cell, tall) = comparison.chosen, _CELL
    across = [(link, operator) for link in c.links for operator in c.operators]
    width = _LEFT + len(across) * (cell + _GAP) + (len(c.links) - 1) * _WIDE + _RIGHT
    width = max(width, _WIDTH)
    height = _TOP + len(c.controllers) * (tall + _GAP) + _BOTTOM
    sheet = Figure(figsize=(width, height), dpi=DPI)
    canvas: Any = FigureCanvasAgg(sheet)  # partly untyped
    # one diagram in inches: a hundred small ones would take a hundred times as long
    ax = sheet.add_axes((0.0, 0.0, 1.0, 1.0), frameon=False)
    ax.set(xlim=(0, width), ylim=(0, height), xticks=[], yticks=[])
    scale = _Scale.of(comparison)
    for i, (link, operator) in enumerate(across):
        x = _LEFT + i * (cell + _GAP) + c.links.index(link) * _WIDE
        for j, controller in enumerate(c.controllers):
            y = height - _TOP - j * (tall + _GAP) - tall
            _cell(ax, (x, y), scale, comparison.of(link, operator, controller)[0], comparison)
        ax.text(x + cell / 2, height - _TOP + 0.08, operator, ha="center", weight="bold")
        _time_axis(ax, x, height - _TOP - len(c.controllers) * (tall + _GAP), scale)
    _labels(ax, comparison, height)
    buffer = io.BytesIO()
    canvas.print_png(buffer, metadata={"Software": None}, pil_kwargs={"compress_level": 4})
    return buffer.getvalue()


class _Scale:
    """From (s, unit) of any run to inches in a cell."""

    def __init__(self, until: float, low: float, high: float) -> None:
        self.until, self._low, self._high = until, low, high

    @classmethod
    def of(cls, comparison: Comparison) -> _Scale:
        """What fits where things start and should be, and half as much around it."""
        picture = comparison.variants.picture
        curves = [curve for o in comparison.outcomes for curve in o.curves if len(curve.t)]
        values = [*picture.reference, *(float(curve.y[0]) for curve in curves), 0.0]
        ends = max((float(curve.t[-1]) for curve in curves), default=1.0)
        low, high = min(values), max(values)
        margin = 0.35 * (high - low) or 1.0
        return cls(min(picture.until, ends), low - margin, high + margin)

    def x(self, t: Any) -> Any:
        """Time, s, in inches."""
        return np.asarray(t, dtype=np.float64) / self.until * _CELL[0]

    def y(self, value: Any) -> Any:
        """A value in inches; NaN where it leaves the cell, so that the line does."""
        y = (np.asarray(value, dtype=np.float64) - self._low) / (self._high - self._low)
        return np.where((y >= 0) & (y <= 1), y, np.nan) * _CELL[1]


def _cell(
    ax: Axes, corner: tuple[float, float], scale: _Scale, outcome: Outcome, comparison: Comparison
) -> None:
    from matplotlib.patches import Rectangle

    x, y = corner
    ground = _GROUND[outcome.verdict.kind]
    ax.add_patch(Rectangle(corner, *_CELL, facecolor=ground, edgecolor="0.6", linewidth=0.5))
    for value in comparison.variants.picture.reference:
        level = y + float(scale.y(value))
        ax.plot([x, x + _CELL[0]], [level, level], linewidth=0.5, **_DASHED)
    _curves(ax, corner, scale, outcome.curves)
    said = _said(outcome, comparison)
    ax.text(x + _CELL[0] - 0.04, y + 0.04, said, ha="right", va="bottom", size=6, color="0.2")


def _curves(ax: Axes, corner: tuple[float, float], scale: _Scale, curves: Sequence[Curve]) -> None:
    for k, curve in enumerate(curves):
        colour = _COLOURS[k % len(_COLOURS)]
        within = curve.t <= scale.until
        x, y = corner[0] + scale.x(curve.t[within]), corner[1] + scale.y(curve.y[within])
        ax.plot(x, y, color=colour, linewidth=0.8, solid_joinstyle="round")


def _said(outcome: Outcome, comparison: Comparison) -> str:
    """The first time that there is, or what became of the run."""
    v = outcome.verdict
    if not v.ended:
        return v.text.removeprefix("no: ")
    if not v.stable:
        return v.kind
    times = [x for x, unit in columns(comparison) if unit == "s" and x.name in outcome.numbers]
    if not times:
        return ""
    text = shown(outcome.numbers[times[0].name][0], "s")
    return text if text == "never" else f"{text} s"


def _time_axis(ax: Axes, x: float, y: float, scale: _Scale) -> None:
    for share in (0.0, 1.0):
        text = f"{share * scale.until:g} s" if share else "0"
        align = "right" if share else "left"
        ax.text(x + share * _CELL[0], y - 0.02, text, ha=align, va="top", size=6, color="0.3")


def _labels(ax: Axes, comparison: Comparison, height: float) -> None:
    """Controllers on the left, link laws above, and what is drawn below."""
    c, (cell, tall) = comparison.chosen, _CELL
    for j, controller in enumerate(c.controllers):
        y = height - _TOP - j * (tall + _GAP) - tall / 2
        ax.text(_LEFT - 0.08, y, controller, ha="right", va="center", size=8)
    span = len(c.operators) * (cell + _GAP)
    for i, link in enumerate(c.links):
        x = _LEFT + i * (span + _WIDE) + (span - _GAP) / 2
        ax.text(x, height - _TOP + 0.32, f"link: {link}", ha="center", size=9)
    ax.text(_LEFT, height - 0.12, comparison.variants.title, ha="left", va="top", size=10)
    _caption(ax, comparison)


def _caption(ax: Axes, comparison: Comparison) -> None:
    """What the lines, the numbers and the grounds are."""
    from matplotlib.patches import Rectangle

    x, y = _LEFT, 0.17
    names = [curve.name for curve in max((o.curves for o in comparison.outcomes), key=len)]
    for k, name in enumerate(names):
        ax.plot([x, x + 0.22], [y, y], color=_COLOURS[k % len(_COLOURS)], linewidth=1.2)
        x = _word(ax, x + 0.27, y, name)
    if comparison.variants.picture.reference:
        ax.plot([x, x + 0.22], [y, y], linewidth=0.7, **_DASHED)
        x = _word(ax, x + 0.27, y, "reference")
    found = {o.verdict.kind for o in comparison.outcomes}
    for kind in (kind for kind in _GROUND if kind in found):
        box = Rectangle((x, y - 0.06), 0.2, 0.12, facecolor=_GROUND[kind], edgecolor="0.6")
        ax.add_patch(box)
        x = _word(ax, x + 0.25, y, kind)
    labels = [column.label for column, unit in columns(comparison) if unit == "s"]
    if labels:
        _word(ax, x, y, f"number: {', or else '.join(labels)}")


def _word(ax: Axes, x: float, y: float, text: str) -> float:
    """Write a text at (x, y); where the next thing may begin."""
    ax.text(x, y, text, va="center", size=7)
    return x + 0.06 * len(text) + 0.18
