"""Figs 4 and 5: graphs of six robots of this project, because the paper's are not available."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, pi, sin
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.links.graphs import PRESETS, Graph, union
from cosim.reporting.figures import DPI, load

if TYPE_CHECKING:
    from matplotlib.axes import Axes


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
