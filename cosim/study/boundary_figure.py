"""``boundary.png``: the points of a search and the boundary between them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.study.axes import Drawn
from cosim.study.boundary import SearchedRegion, regions
from cosim.study.figures import colours, draw
from cosim.study.study import Study
from cosim.study.table import SweepTable

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FIGURE = "boundary.png"
INSIDE, BEYOND = "#4575b4", "#d73027"


def draw_boundary(study: Study, table: SweepTable, folder: Path) -> list[Path]:
    """Draw the figure of a study with a boundary. Raises RunError with the path."""
    found, spec = regions(study, table), study.boundary
    if spec is None or not found:
        return []
    said = "stable" if spec.of == "stable" else f"{spec.of} ≤ {spec.level:g}"

    def content(ax: Axes) -> None:
        {1: _line, 2: _plane, 3: _space}[len(found[0].axes)](ax, found, said)
        ax.set_title(study.title)

    return [draw(content, folder / FIGURE)]


def _label(region: SearchedRegion, said: str) -> str:
    return ", ".join(map(str, region.chosen.values())) or said


def _line(ax: Axes, found: Sequence[SearchedRegion], said: str) -> None:
    """One axis: the points of each search in a row, the boundary as strokes."""
    for row, region in enumerate(found):
        x, inside = region.values(region.at)[:, 0], region.side < 0.0
        for mask, colour, name in ((inside, INSIDE, said), (~inside, BEYOND, f"not {said}")):
            label = name if row == 0 else None
            ax.plot(x[mask], np.full(mask.sum(), row), "o", color=colour, ms=4, label=label)
        for at in region.values(region.crossings()[0])[:, 0]:
            ax.plot([at, at], [row - 0.3, row + 0.3], color="black")
            ax.annotate(f"{at:.4g}", (at, row + 0.32), ha="center", fontsize=8)
    ax.set_yticks(range(len(found)), [_label(region, said) for region in found])
    ax.set_ylim(-0.7, len(found) - 0.3)
    ax.legend(loc="lower center", ncols=2)
    _scale(ax, found[0].axes[:1])


def _plane(ax: Axes, found: Sequence[SearchedRegion], said: str) -> None:
    """Two axes: the points, and the boundary as lines between them."""
    from matplotlib.tri import Triangulation

    few = colours(len(found))
    for region, colour in zip(found, few, strict=True):
        x, y = region.values(region.at).T
        one, inside = len(found) == 1, region.side < 0.0
        for mask, name, filled in ((inside, said, INSIDE), (~inside, f"not {said}", BEYOND)):
            shown: dict[str, Any] = {"color": filled} if one else {"color": colour, "alpha": 0.3}
            ax.plot(x[mask], y[mask], "." if one or filled == INSIDE else "x", markersize=4,
                    label=name if one else None, **shown)  # fmt: skip
        corners = region.simplices()
        if len(corners) and inside.any() and not inside.all():
            line = "black" if one else colour
            mesh = Triangulation(x, y, corners)
            ax.tricontour(mesh, region.side, levels=[0.0], colors=[line])
            ax.plot([], [], color=line, label="boundary" if one else _label(region, said))
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=3)
    _scale(ax, found[0].axes)


def _space(ax: Axes, found: Sequence[SearchedRegion], said: str) -> None:
    """Three axes: places of the boundary over two of them, the third as colour."""
    third = found[0].axes[2]
    for region, marker in zip(found, "osD^v<>p*hXd" * len(found), strict=False):
        x, y, z = region.values(region.crossings()[0]).T
        drawn = ax.scatter(
            x, y, c=z, s=12, marker=marker, label=_label(region, said), vmin=third.a, vmax=third.b
        )
    ax.figure.colorbar(drawn, ax=ax).set_label(f"{third.name} on the boundary")
    if len(found) > 1:
        ax.legend()
    _scale(ax, found[0].axes[:2])


def _scale(ax: Axes, axes: Sequence[Drawn]) -> None:
    shown: list[tuple[Any, Any, Any]] = [
        (ax.set_xscale, ax.set_xlabel, ax.set_xlim),
        (ax.set_yscale, ax.set_ylabel, ax.set_ylim),
    ]
    for axis, (set_scale, set_label, set_limits) in zip(axes, shown, strict=False):
        set_scale("log" if axis.law == "loguniform" else "linear")
        set_label(f"{axis.name} [{axis.unit}]" if axis.unit else axis.name)
        set_limits(axis.a, axis.b)
    ax.grid(color="0.9", linewidth=0.5)
    ax.set_axisbelow(True)
