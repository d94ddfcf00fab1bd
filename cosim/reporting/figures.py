"""Figures: recorded signals over time, one panel below the other, as a PNG.

Drawn with matplotlib's Agg canvas, without pyplot, in a fixed style that ignores the user's
matplotlibrc: the same run gives the same bytes (with the same matplotlib). matplotlib is imported
for the first figure.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.base.errors import CosimError, ScenarioError
from cosim.base.extras import require
from cosim.base.files import write_file
from cosim.base.units import printed_unit
from cosim.record.signals import Array, Signals
from cosim.reporting import many
from cosim.reporting.html import TimedEvent
from cosim.reporting.thinning import drawable, thin

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Sheet

DPI = 150

#: Colours that people with any colour vision tell apart (Okabe and Ito; the fifth and the last are
#: darker and lighter than theirs). They are those of a page, ``--s0`` and so on of its style sheet.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b58900", "#56b4e9", "#555555")
_DASHES = ("-", (0, (6, 1.5, 1, 1.5)), (0, (1, 1)))
_FAILED, _EVENT = "#B00020", "#E69F00"
#: Of a line that hides an earlier one: its gaps show the line below it. The share of the range of
#: a panel that two lines may be apart and still be one to the eye.
_GAPS, _HIDING = (0, (4, 4)), 0.004
#: Names of events: at the most so many letters, so many over the width of a panel, and rows.
_NAME, _LETTERS, _ROWS = 28, 90, 3

_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib
    "font.size": 8.5,
    "axes.titlesize": 8.5,
    "axes.labelsize": 8.5,
    "axes.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.formatter.limits": (-3, 5),
    "grid.color": "0.9",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.1,
    "lines.solid_joinstyle": "round",
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "agg.path.chunksize": 0,
}

# Margins and distances, inches.
_NARROW = 5.0
_LEFT, _RIGHT, _TOP, _BOTTOM, _GAP, _TITLE = 0.72, 0.15, 0.12, 0.5, 0.42, 0.26
_PANEL_TITLE, _LABEL_AT, _LEGEND_GAP = 0.2, 0.5, 0.08


@dataclass(frozen=True, slots=True)
class Panel:
    """One diagram: signals `y` over time, with dashed references.

    `y`: names of scalars, or of vectors, of which all entries are drawn. `labels`: one per name
    (default: the name). `reference`: numbers or signals, `reference_label` for the first of them.
    `ylabel`: without the unit, which is that of the signals. `colours`: the number of the colour of
    each line, () for those of their order.
    """

    y: tuple[str, ...]
    title: str = ""
    labels: tuple[str, ...] = ()
    reference: tuple[float | str, ...] = ()
    reference_label: str = ""
    ylabel: str = ""
    colours: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Figure:
    """Panels from top to bottom over one time axis; `size` (width, height) in inches.

    `events`: marked in every panel, named in the first. `failure`: how the run failed, below the
    title. `width`, inches, without a `size`: the height follows; a narrow figure (below 5 inches,
    such as a column of a paper) has its legends inside the panels.
    """

    panels: tuple[Panel, ...]
    title: str = ""
    size: tuple[float, float] | None = None
    width: float = 7.2
    events: tuple[TimedEvent, ...] = ()
    failure: str = ""


@dataclass(frozen=True, slots=True)
class _Line:
    label: str
    y: Array  # (n,)


def draw(spec: Figure, run: Signals, path: str | Path) -> Path:
    """Draw `spec` from `run` into `path`, a PDF by its suffix, else a PNG with 150 dots per inch.

    The file is replaced in one step.

    Raises ScenarioError naming the panel for signals that were not recorded, RunError with the
    path if it cannot be written.
    """
    if not spec.panels:
        raise ScenarioError("a figure needs at least one panel", f"figure {spec.title!r}")
    named = [name for panel in spec.panels for name in (*panel.y, *panel.reference)]
    scalars = [x for n in named if isinstance(n, str) and _has(run, n) for x in run.entries(n)]
    run = drawable(run, list(dict.fromkeys(scalars)))
    content = [
        _lines(panel, run, f"figure {spec.title!r}, panel {i + 1}")
        for i, panel in enumerate(spec.panels)
    ]
    form = pdf if Path(path).suffix == ".pdf" else png
    return draw_styled(lambda: form(_render(spec, run, content)), path)


def _has(run: Signals, name: str) -> bool:
    try:
        return bool(run.entries(name))
    except CosimError:  # the panel that names it tells why
        return False


def draw_styled(render: Callable[[], bytes], path: str | Path) -> Path:
    """Write what `render` draws in the style of these figures to the PNG `path`, in one step.

    Raises RunError with the path if it cannot be written.
    """
    load()
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        image = render()
    return _write(image, Path(path))


def png(figure: Sheet) -> bytes:
    """A figure as a PNG that does not depend on the version of matplotlib or the date."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas: Any = FigureCanvasAgg(figure)  # partly untyped
    buffer = io.BytesIO()
    canvas.print_png(buffer, metadata={"Software": None}, pil_kwargs={"compress_level": 4})
    return buffer.getvalue()


def pdf(figure: Sheet) -> bytes:
    """A figure as a PDF, without a date."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="pdf", metadata={"CreationDate": None, "Producer": None})
    return buffer.getvalue()


def load(*, lean: bool = False) -> None:
    """Import matplotlib now, before the first figure.

    A third of the import time is spent on tables of properties for the docstrings of its classes.
    `lean` omits these (200 instead of 280 ms), for commands, which do not show docstrings.

    Raises ScenarioError if matplotlib is not installed.
    """
    require("matplotlib")
    if lean and "matplotlib.figure" not in sys.modules:
        import matplotlib.artist

        table = matplotlib.artist.kwdoc
        matplotlib.artist.kwdoc = lambda artist: ""
        try:
            import matplotlib.backends.backend_agg
            import matplotlib.figure
        finally:
            matplotlib.artist.kwdoc = table
    import matplotlib.backends.backend_agg
    import matplotlib.figure


# ---- what is drawn -------------------------------------------------------------------------------


def _lines(panel: Panel, run: Signals, place: str) -> tuple[list[_Line], list[_Line]]:
    """The lines of a panel and of its references, a number being a line of one value."""
    if not panel.y:
        raise ScenarioError("a panel needs at least one signal in 'y'", place)
    try:
        labels = panel.labels + panel.y[len(panel.labels) :]
        lines = [line for name, label in zip(panel.y, labels, strict=False)
                 for line in _entries(run, name, label)]  # fmt: skip
        if len(lines) > many.LINES:
            stacked = np.column_stack([line.y for line in lines])
            lines = [_Line(name, y) for name, y in many.quantile_lines(stacked)]
        references: list[_Line] = []
        for reference in panel.reference:
            label = panel.reference_label if not references else ""
            if isinstance(reference, str):
                references += _entries(run, reference, label or reference)
            else:
                references.append(_Line(label, np.array([float(reference)])))
    except CosimError as error:
        raise ScenarioError(str(error), place) from error
    return lines, references


def _entries(run: Signals, name: str, label: str) -> Iterator[_Line]:
    values, names = run.array(name), run.entries(name)
    for i, entry in enumerate(names):
        index = entry.removeprefix(name) if len(names) > 1 else ""
        y = values[:, i]
        yield _Line(label + index, np.where(np.abs(y) < 1e150, y, np.nan))  # what Agg can place


def axis_label(panel: Panel, run: Signals) -> str:
    """Label of a panel's y axis: its own label or the common part of its signals, and the unit."""
    units = list(dict.fromkeys(run.unit(entry) for name in panel.y for entry in run.entries(name)))
    shared = {name.partition(".")[2] or name for name in panel.y}
    text = panel.ylabel or (shared.pop() if len(shared) == 1 else "")
    shown = ", ".join(filter(None, map(printed_unit, units)))
    return f"{text} [{shown}]".strip() if shown else text


# ---- how it is drawn -----------------------------------------------------------------------------


def _render(spec: Figure, run: Signals, content: list[tuple[list[_Line], list[_Line]]]) -> Sheet:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Sheet

    count = len(spec.panels)
    width, height = spec.size or (spec.width, _height(spec))
    figure = Sheet(figsize=(width, height), dpi=DPI)
    canvas: Any = FigureCanvasAgg(figure)  # partly untyped
    axes: list[Axes] = []
    for panel, (lines, references) in zip(spec.panels, content, strict=True):
        ax = figure.add_axes((0.1, 0.1, 0.8, 0.8), sharex=axes[0] if axes else None)
        axes.append(ax)
        _plot(ax, run.t, lines, references, panel.colours)
        ax.set_ylabel(axis_label(panel, run))
        if panel.title:
            ax.set_title(panel.title, loc="left", pad=4)
        ax.tick_params(labelbottom=len(axes) == count)
        _mark(ax, spec.events, width, named=len(axes) == 1)
    axes[-1].set_xlabel("time [s]")
    if width < _NARROW:
        for ax in axes:
            ax.legend(loc="best", handlelength=1.6, labelspacing=0.3, borderpad=0.2)
        legend = 0.0
    else:
        legend = max(_legend_width(ax, canvas) for ax in axes)
    _arrange(figure, axes, spec, legend)
    return figure


def _height(spec: Figure) -> float:
    """The height of a figure that is as wide as it says, inches."""
    panels = len(spec.panels)
    each = min(2.0, 0.4 * spec.width)
    titles = _TITLE * (1 + bool(spec.failure))
    return _TOP + _BOTTOM + each * panels + _GAP * (panels - 1) + titles


def _plot(
    ax: Axes, t: Array, lines: list[_Line], references: list[_Line], colours: tuple[int, ...]
) -> None:
    hiding = _hiding([line.y for line in lines])
    numbers = colours if len(colours) == len(lines) else range(len(lines))
    for i, (line, number) in enumerate(zip(lines, numbers, strict=True)):
        index = thin(line.y)
        colour = COLOURS[number % len(COLOURS)]
        dash = _GAPS if hiding[i] else _DASHES[i // len(COLOURS) % len(_DASHES)]
        ax.plot(t[index], line.y[index], color=colour, linestyle=dash, label=line.label)
    dashed: dict[str, Any] = {"color": "0.25", "linestyle": (0, (5, 3)), "linewidth": 0.9}
    for line in references:
        label = line.label or "_"  # matplotlib leaves labels that begin so out of the legend
        if len(line.y) == 1:
            ax.axhline(line.y[0], label=label, zorder=1.5, **dashed)
        else:
            index = thin(line.y)
            ax.plot(t[index], line.y[index], label=label, zorder=1.5, **dashed)
    if len(t) > 1:
        ax.set_xlim(t[0], t[-1])


def _hiding(lines: Sequence[Array]) -> list[bool]:
    """True for each line (n,) of a panel that would hide an earlier one."""
    finite = [y[np.isfinite(y)] for y in lines]
    ends = [value for y in finite if y.size for value in (y.min(), y.max())]
    near = _HIDING * (max(ends) - min(ends)) if ends else 0.0

    def same(a: Array, b: Array) -> bool:
        both = np.isfinite(a) & np.isfinite(b)
        return bool(both.any()) and float(np.abs(a[both] - b[both]).max()) <= near

    return [any(same(y, earlier) for earlier in lines[:i]) for i, y in enumerate(lines)]


def _mark(ax: Axes, events: Sequence[TimedEvent], width: float, *, named: bool) -> None:
    """Mark events as lines and bands; names stand in the first row that is free."""
    low, high = ax.get_xlim()
    free = [low] * _ROWS
    letters = _LETTERS * width / 7.2
    for event in sorted(events, key=lambda event: event.t):
        to = event.t if event.to is None else event.to
        if to < low or event.t > high:
            continue
        start = max(event.t, low)
        ax.axvspan(start, min(to, high), color=_EVENT, alpha=0.18, linewidth=0, zorder=0.5)
        ax.axvline(start, color=_EVENT, linewidth=0.8, zorder=0.6)
        name = event.label if len(event.label) <= _NAME else f"{event.label[: _NAME - 1]}…"
        row = next((k for k in range(_ROWS) if start >= free[k]), None)
        if named and row is not None:
            ax.annotate(
                f" {name}", (start, 1.0 - 0.08 * row), xycoords=("data", "axes fraction"), va="top",
                size=6.5, color="0.3", annotation_clip=True,
            )  # fmt: skip
            free[row] = start + (len(name) + 2) * (high - low) / letters


def _legend_width(ax: Axes, canvas: Any) -> float:
    """Put the legend right of the axes; its width, inches."""
    legend = ax.legend(
        loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0, borderpad=0.2,
        handlelength=1.9, handletextpad=0.6, labelspacing=0.4,
    )  # fmt: skip
    return float(legend.get_window_extent(canvas.get_renderer()).width) / DPI


def _arrange(figure: Sheet, axes: list[Axes], spec: Figure, legend: float) -> None:
    """Place axes, legends and titles; all lengths in inches until the last step."""
    width, height = figure.get_size_inches()
    inner = max(width - _LEFT - _LEGEND_GAP - legend - _RIGHT, 0.3 * width)
    title = (_TITLE if spec.title else 0.0) + (_TITLE if spec.failure else 0.0)
    gap = _GAP if any(panel.title for panel in spec.panels[1:]) else _GAP / 2
    top = _TOP + title + (_PANEL_TITLE if spec.panels[0].title else 0.0)
    panel = (height - top - _BOTTOM - gap * (len(axes) - 1)) / len(axes)
    for i, ax in enumerate(axes):
        bottom = height - top - panel * (i + 1) - gap * i
        ax.set_position((_LEFT / width, bottom / height, inner / width, panel / height))
        ax.yaxis.set_label_coords(-_LABEL_AT / inner, 0.5)
        legend_box = ax.get_legend()
        if legend_box is not None and legend > 0.0:
            legend_box.set_bbox_to_anchor((1.0 + _LEGEND_GAP / inner, 1.0), ax.transAxes)
    texts = [
        (spec.title, 10 if width >= _NARROW else 8.5, "black"),
        (_cut(spec.failure, width), 8, _FAILED),
    ]
    for row, (text, size, colour) in enumerate(x for x in texts if x[0]):
        figure.text((_LEFT + inner / 2) / width, 1 - (_TOP + _TITLE * (row + 0.5)) / height, text,
                    ha="center", va="center", size=size, color=colour)  # fmt: skip


def _cut(failure: str, width: float) -> str:
    """A failure as one line that fits a figure `width` inches wide."""
    text = f"FAILED: {' '.join(failure.split())}" if failure else ""
    most = int(width * 14)
    return text if len(text) <= most else f"{text[: most - 1]}…"


def _write(image: bytes, path: Path) -> Path:
    write_file(path, image)
    return path
