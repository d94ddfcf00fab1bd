"""Figs 1-15 in the paper's layout: one diagram per figure, as a PNG, and the numbers as CSV.

The paper's own pictures are not available. The figures show what the captions describe, until the
motion has settled. Figs 4 and 5 are the graphs chosen here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cosim.base.errors import RunError
from cosim.record import Run
from cosim.reporting.figures import Figure, Panel, draw
from fmus.paper.experiments import Q_H
from fmus.paper.measure import Array, row

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
