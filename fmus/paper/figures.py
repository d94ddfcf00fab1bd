"""Figs 1-15 in the paper's layout: one diagram per figure, as a PNG, and the numbers as CSV.

The paper's own pictures are not available. The figures show what the captions describe, until the
motion has settled. Figs 4 and 5 are graphs of this project, for
the same reason.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import cos, pi, sin
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.base.errors import RunError
from cosim.graphs.graph import PRESETS, Graph, union
from cosim.record import Run
from cosim.reporting.figures import DPI, Figure, Panel, draw, load
from fmus.paper.experiments import Q_H
from fmus.paper.measure import Array, row

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIZE = (4.6, 3.1)  # inches: a column of the paper is 3.2 wide; the legend stands beside
LAMBDA_M = r"$\lambda_{\mathcal{M}}$"
#: Rows of a CSV are this far apart, s.
APART = 0.02


@dataclass(frozen=True, slots=True)
class PaperFigure:
    """A figure of the paper: what is drawn of which case, until when (s).

    `number` of the paper; `name`: file stem; `reference`: dashed, where the operator wants it.
    """

    number: int
    name: str
    title: str
    case: str
    until: float
    y: tuple[str, ...]
    labels: tuple[str, ...]
    ylabel: str
    reference: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Window:
    """The first rows of a run, up to a time: what a figure shows. Implements Signals."""

    run: Run
    rows: int

    @property
    def t(self) -> Array:
        """Time of each row, (n,), s."""
        return self.run.t[: self.rows]

    def array(self, prefix: str) -> Array:
        """Entries of a signal, (n, m)."""
        return self.run.array(prefix)[: self.rows]

    def entries(self, prefix: str) -> tuple[str, ...]:
        """Names of those entries."""
        return self.run.entries(prefix)

    def unit(self, prefix: str) -> str:
        """Unit of a signal."""
        return self.run.unit(prefix)


def _one(number: int, name: str, gain: str, case: str, until: float) -> PaperFigure:
    title = f"Fig. {number}: positions of the robot, {LAMBDA_M} = {gain}"
    return PaperFigure(
        number, name, title, case, until, ("robot.q[0]", "robot.q[1]"),
        ("first coordinate", "second coordinate"), "position", Q_H,
    )  # fmt: skip


def _coordinates(
    first: int, what: str, case: str, until: float, robots: Mapping[str, str]
) -> tuple[PaperFigure, PaperFigure]:
    """Two figures, one a coordinate, of the positions of several robots (name: label)."""
    names = ("first coordinate", "second coordinate")
    return tuple(
        PaperFigure(
            first + k, f"fig{first + k:02d}", f"Fig. {first + k}: {what}", case, until,
            tuple(f"{robot}.q[{k}]" for robot in robots), tuple(robots.values()),
            f"position, {names[k]}", (Q_H[k],),
        )
        for k in (0, 1)
    )  # type: ignore[return-value]  # fmt: skip


_SIX = {f"robot{i}": f"robot {i}" for i in range(1, 7)}
_PAIR = {"master": "master", "slave": "slave"}
FIGURES: tuple[PaperFigure, ...] = (
    _one(1, "fig01", "6 (caption)", "teaching-6", 20.0),
    _one(1, "fig01-text", "2 (text)", "teaching-2", 20.0),
    PaperFigure(
        2, "fig02", f"Fig. 2: torques of the operator, {LAMBDA_M} = 6", "teaching-6", 20.0,
        ("robot.tau_h[0]", "robot.tau_h[1]"), ("first joint", "second joint"), "torque", (0.0,),
    ),
    _one(3, "fig03", "0", "teaching-0", 20.0),
    *_coordinates(6, f"six robots, {LAMBDA_M} = 10", "net-10-ring", 80.0, _SIX),
    *_coordinates(8, f"six robots, {LAMBDA_M} = 0", "net-0-ring", 80.0, _SIX),
    *_coordinates(10, f"six robots, {LAMBDA_M} = 10, delays", "net-delay-ring", 80.0, _SIX),
    *_coordinates(12, f"master and slave, {LAMBDA_M} = 10", "pair-10", 40.0, _PAIR),
    *_coordinates(14, f"master and slave, {LAMBDA_M} = 1", "pair-1", 40.0, _PAIR),
)  # fmt: skip


def draw_figure(figure: PaperFigure, run: Run, folder: Path) -> Path:
    """Draw a figure as ``NAME.png`` and write what is in it as ``NAME.csv``; returns the PNG.

    Raises RunError where a file cannot be written.
    """
    window = Window(run, row(run, figure.until) + 1)
    label = "$q_h$" if "position" in figure.ylabel else ""
    panel = Panel(
        y=figure.y, labels=figure.labels, reference=figure.reference, reference_label=label,
        ylabel=figure.ylabel,
    )  # fmt: skip
    write_csv(figure, window, folder / f"{figure.name}.csv")
    return draw(Figure((panel,), figure.title, SIZE), window, folder / f"{figure.name}.png")


def write_csv(figure: PaperFigure, window: Window, path: Path) -> None:
    """Write the numbers of a figure every 20 ms: ``t`` (s) and each line, named with its unit.

    Raises RunError if the file cannot be written.
    """
    columns = [window.array(name)[:, 0] for name in figure.y]
    header = ",".join(["t [s]", *(f"{name} [{window.unit(name)}]" for name in figure.y)])
    every = max(1, round(APART / (window.t[1] - window.t[0])))
    table = np.column_stack([window.t, *columns])[::every]
    try:
        np.savetxt(path, table, fmt="%.7g", delimiter=",", header=header, comments="")
    except OSError as error:
        raise RunError(f"cannot write {path}: {error.strerror}") from error


# ---- graphs -------------------------------------------------------------------------------------


def draw_graphs(preset: str, folder: Path) -> tuple[Path, Path]:
    """Draw the graphs of a preset (``fig04.png``) and their union (``fig05.png``)."""
    graphs = PRESETS[preset]
    titles = [f"$G_{k}$" for k in range(1, len(graphs) + 1)]
    together = union(graphs)
    roots = ", ".join(map(str, sorted(together.roots)))
    return (
        _sheet(graphs, titles, f"Fig. 4: interaction graphs, {preset}", folder / "fig04.png"),
        _sheet([together], [f"roots: {roots}"], "Fig. 5: their union", folder / "fig05.png"),
    )


def _sheet(graphs: Sequence[Graph], titles: Sequence[str], title: str, path: Path) -> Path:
    load()
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    n = len(graphs)
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams["font.size"] = 8.5
        figure = Figure(figsize=(max(2.6, 2.1 * n), 2.7), dpi=DPI)
        canvas: Any = FigureCanvasAgg(figure)  # partly untyped
        for k, (graph, text) in enumerate(zip(graphs, titles, strict=True)):
            ax = figure.add_axes((k / n, 0.02, 1 / n, 0.78))
            _graph(ax, graph)
            ax.set_title(text, size=9, pad=2)
        figure.text(0.5, 0.95, title, ha="center", va="center", size=10)
        canvas.print_png(str(path), metadata={"Software": None})
    return path


def _graph(ax: Axes, graph: Graph) -> None:
    """Robots on a circle, clockwise from the top; an arrow from who sends to who receives."""
    place = {
        i: (sin(2 * pi * (i - 1) / graph.n), cos(2 * pi * (i - 1) / graph.n))
        for i in range(1, graph.n + 1)
    }
    for i, j in graph.edges:
        arrow = {
            "arrowstyle": "-|>", "shrinkA": 9, "shrinkB": 9, "color": "#0072B2", "linewidth": 1.2,
        }  # fmt: skip
        ax.annotate("", xy=place[i], xytext=place[j], arrowprops=arrow)
    for i, (x, y) in place.items():
        ax.scatter([x], [y], s=190, facecolor="white", edgecolor="0.25", linewidth=0.9, zorder=3)
        ax.text(x, y, str(i), ha="center", va="center", zorder=4)
    ax.set(xlim=(-1.35, 1.35), ylim=(-1.3, 1.3), aspect="equal")
    ax.axis("off")
