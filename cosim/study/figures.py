"""Figures over the axes of a sweep: maps, lines and points, as PNG.

=======  ===========================================================================================
map      x and y: axes with few values; colour: `reduce` of z over all runs of a cell; grey: none
line     x: an axis; `reduce` of the measure y over all runs there, one line for each value of `by`,
         and a band from the least to the largest
points   x, y and z: axes or measures that are numbers; each run a point, coloured by z
=======  ===========================================================================================

`z` of a map and `y` of a line are measures, or ``stable`` (0 or 1; its mean is a share). A measure
of a run that failed is no number and is left out.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.base.files import write_file
from cosim.base.names import unknown
from cosim.record.signals import Array
from cosim.reporting.figures import DPI, load
from cosim.study.spec import SweepFigureSpec
from cosim.study.study import Study
from cosim.study.summary import cell
from cosim.study.table import SweepTable, column, entries, groups

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.linewidth": 0.6,
    "lines.linewidth": 1.2,
    "legend.frameon": False,
    "legend.fontsize": 8,
}
_GREY = "0.8"
_REDUCE: Mapping[str, Callable[[Array], Any]] = {
    "mean": np.mean, "median": np.median, "min": np.min, "max": np.max,
}  # fmt: skip
#: Cells of a map, at most, whose numbers are written into them.
_WRITTEN = 150


def check(study: Study, axes: Sequence[str], units: Mapping[str, str]) -> None:
    """Refuse figures of what is not there. Raises ScenarioError with the place in the study."""
    measures = ("stable", *units)
    for name, spec in study.figures.items():
        wanted = {
            "map": (("x", axes), ("y", axes), ("z", measures)),
            "line": (("x", axes), ("y", measures), ("by", ("", *axes))),
            "points": tuple((key, (*axes, *measures)) for key in ("x", "y", "z")),
        }[spec.kind]
        for key, known in wanted:
            given = getattr(spec, key)
            if given not in known:
                raise ScenarioError(
                    unknown(given, known, "column"),
                    study.place("figures", name, key),
                )


def draw_all(study: Study, table: SweepTable, folder: Path) -> list[Path]:
    """Draw every figure of the study into ``folder/NAME.png``. Raises RunError with the path."""
    if not table.records:
        return []
    return [_draw(spec, table, folder / f"{name}.png") for name, spec in study.figures.items()]


def _draw(spec: SweepFigureSpec, table: SweepTable, path: Path) -> Path:
    def content(ax: Axes) -> None:
        {"map": _map, "line": _line, "points": _points}[spec.kind](ax, spec, table)
        ax.set_title(spec.title)

    return draw(content, path)


def draw(content: Callable[[Axes], None], path: Path) -> Path:
    """A figure of one panel, which `content` fills, as PNG. Raises RunError with the path."""
    load()
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        figure = Figure(figsize=(6.4, 4.6), dpi=DPI, layout="constrained")
        canvas: Any = FigureCanvasAgg(figure)
        ax = figure.add_subplot()
        content(ax)
        image = io.BytesIO()
        canvas.print_png(image)
    write_file(path, image.getvalue())
    return path


def _reduced(spec: SweepFigureSpec, records: Sequence[Mapping[str, Any]], name: str) -> float:
    x = column(records, name)
    x = x[~np.isnan(x)]
    return float(_REDUCE[spec.reduce](x)) if len(x) else float("nan")


def _values(table: SweepTable, axis: str) -> list[Any]:
    """The values of an axis: numbers in order, texts as listed."""
    values = list(dict.fromkeys(entries(table.records, axis)))
    return sorted(values) if all(isinstance(v, int | float) for v in values) else values


def _name(table: SweepTable, name: str, given: str) -> str:
    unit = table.units.get(name, "1")
    return given or (name if unit == "1" else f"{name} [{unit}]")


def _map(ax: Axes, spec: SweepFigureSpec, table: SweepTable) -> None:
    xs, ys = _values(table, spec.x), _values(table, spec.y)
    z = np.full((len(ys), len(xs)), np.nan)
    for (x, y), records in groups(table, (spec.x, spec.y)).items():
        z[ys.index(y), xs.index(x)] = _reduced(spec, records, spec.z)
    share = spec.z == "stable"
    shown = np.ma.masked_invalid(z)
    ax.set_facecolor(_GREY)
    mesh = ax.pcolormesh(
        shown, cmap="RdYlBu" if share else "viridis", edgecolors="white", linewidth=0.4,
        vmin=0 if share else None, vmax=1 if share else None,
    )  # fmt: skip
    _write_in(ax, z, mesh)
    for axis, values in ((ax.xaxis, xs), (ax.yaxis, ys)):
        keep = range(0, len(values), -(-len(values) // 16))
        axis.set_ticks([i + 0.5 for i in keep], [_short(values[i]) for i in keep])
    ax.set_xlabel(_name(table, spec.x, spec.xlabel))
    ax.set_ylabel(_name(table, spec.y, spec.ylabel))
    bar = ax.figure.colorbar(mesh, ax=ax)
    bar.set_label(spec.zlabel or ("share stable" if share else _name(table, spec.z, "")))


def _write_in(ax: Axes, z: Array, mesh: Any) -> None:
    """Numbers into the cells, where there are few; white on dark, black on light."""
    if z.size > _WRITTEN:
        return
    for (row, col), value in np.ndenumerate(z):
        text = f"{value:.2g}" if np.isfinite(value) else "never" if value > 0 else ""
        red, green, blue, _ = mesh.to_rgba(value) if np.isfinite(value) else (1, 1, 1, 1)
        dark = 0.3 * red + 0.6 * green + 0.1 * blue < 0.5
        ax.text(
            col + 0.5, row + 0.5, text, ha="center", va="center", fontsize=6.5,
            color="white" if dark else "black",
        )  # fmt: skip


def _short(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else cell(value)


def _line(ax: Axes, spec: SweepFigureSpec, table: SweepTable) -> None:
    xs = _values(table, spec.x)
    numeric = all(isinstance(v, int | float) for v in xs)
    series = _values(table, spec.by) if spec.by else [None]
    found = groups(table, (spec.x, spec.by) if spec.by else (spec.x,))
    for value, colour in zip(series, colours(len(series)), strict=True):
        there = [(i, x) for i, x in enumerate(xs) if ((x, value) if spec.by else (x,)) in found]
        records = [found[(x, value) if spec.by else (x,)] for _, x in there]
        at = [float(x) if numeric else float(i) for i, x in there]
        middle = [_reduced(spec, r, spec.y) for r in records]
        if not np.isfinite(middle).any():
            continue
        columns = [column(r, spec.y) for r in records]
        low = [float(np.min(c[~np.isnan(c)], initial=np.inf)) for c in columns]
        high = [float(np.max(c[~np.isnan(c)], initial=-np.inf)) for c in columns]
        band = np.isfinite(low) & np.isfinite(high)
        ax.fill_between(at, low, high, where=band.tolist(), color=colour, alpha=0.2, linewidth=0)
        label = _short(value) if spec.by else ""
        ax.plot(at, middle, color=colour, marker="o", markersize=3, label=label)
    if not numeric:
        ax.set_xticks(range(len(xs)), [cell(x) for x in xs])
    if spec.by:
        ax.legend(title=spec.by)
    _scales(ax, spec, logx=numeric and spec.logx)
    ax.grid(color="0.9", linewidth=0.5)
    ax.set_xlabel(_name(table, spec.x, spec.xlabel))
    ax.set_ylabel(_name(table, spec.y, spec.ylabel))


def colours(n: int) -> list[Any]:
    """`n` colours: Okabe and Ito's for a few lines, a scale for many."""
    import matplotlib

    few = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
    scale = matplotlib.colormaps["viridis"]
    return list(few[:n]) if n <= len(few) else [scale(i / (n - 1) * 0.95) for i in range(n)]


def _points(ax: Axes, spec: SweepFigureSpec, table: SweepTable) -> None:
    try:
        x, y, z = (column(table.records, name) for name in (spec.x, spec.y, spec.z))
    except ValueError:
        said = f"{spec.x}, {spec.y}, {spec.z}: not all of them are numbers"
        raise ScenarioError(said, "figure of points") from None
    bad = ~np.isfinite(z)
    ax.scatter(x[bad], y[bad], color=_GREY, s=14, edgecolors="0.4", linewidths=0.4)
    share = spec.z == "stable"
    drawn = ax.scatter(
        x[~bad], y[~bad], c=z[~bad], s=14, cmap="RdYlBu" if share else "viridis",
        edgecolors="0.4", linewidths=0.2, vmin=0 if share else None, vmax=1 if share else None,
    )  # fmt: skip
    ax.figure.colorbar(drawn, ax=ax).set_label(spec.zlabel or _name(table, spec.z, ""))
    _scales(ax, spec, logx=spec.logx)
    ax.grid(color="0.9", linewidth=0.5)
    ax.set_axisbelow(True)
    ax.set_xlabel(_name(table, spec.x, spec.xlabel))
    ax.set_ylabel(_name(table, spec.y, spec.ylabel))


def _scales(ax: Axes, spec: SweepFigureSpec, *, logx: bool) -> None:
    if logx:
        ax.set_xscale("log")
    if spec.logy:
        ax.set_yscale("log")
