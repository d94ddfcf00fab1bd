"""A picture of a CAN bus over time: frames by node, errors, waiting frames, and the load."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import RunError
from cosim.bus.transmissions import Outcome, busy_share
from cosim.reporting.figures import DPI, draw_styled, png

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST = 5000
"""Transmissions in one picture; more could not be told apart."""
_SENT, _FAILED, _UNDER_WAY, _WAITING = "#0072B2", "#D55E00", "#56B4E9", "0.85"
_LABELLED = 40
_UNITS = ((10**12, "s"), (10**9, "ms"), (10**6, "us"))


def draw_timeline(
    path: str | Path,
    busy: NDArray[np.void],
    names: Sequence[str],
    start_ps: int,
    end_ps: int,
    *,
    labels: Mapping[int, str] | None = None,
    waiting: Sequence[tuple[int, int, int]] = (),
    title: str = "",
) -> Path:
    """Draw the bus between two times (ps) as a PNG: a row for each node, and the load below.

    `busy`: rows of ``cosim.bus.transmissions.transmissions``, shape (n,). A frame is blue, a failed
    attempt with its error frame orange and hatched, what is under way at the end light blue.
    `names`: of the nodes. `labels`: a text for each request, such as its identifier; drawn where
    there is room. `waiting`: (node, start, end) in ps of requests that waited, grey. The lowest row
    shows disturbances of the idle bus, if there are any. The load is that of 50 windows.

    Raises RunError when the window is empty, has more than 5000 transmissions, or the file cannot
    be written.
    """
    rows = busy[(busy["end"] > start_ps) & (busy["start"] < end_ps)]
    if end_ps <= start_ps or len(rows) > MOST:
        raise RunError(
            f"{path}: found {len(rows)} transmissions in {(end_ps - start_ps) / 1e12:g} s, expected"
            f" a window above 0 with at most {MOST}"
        )
    size, unit = next(((s, u) for s, u in _UNITS if end_ps - start_ps >= s), _UNITS[-1])

    def render() -> bytes:
        from matplotlib.figure import Figure as Sheet

        lanes = [*names, "no node"] if (rows["node"] < 0).any() else list(names)
        height = 1.9 + 0.3 * len(lanes)
        figure = Sheet(figsize=(9.0, height), dpi=DPI)
        top = 0.3 if title else 0.12
        above = (0.11, 1.25 / height, 0.87, (0.3 * len(lanes)) / height)
        ax = figure.add_axes(above)
        below = figure.add_axes((0.11, 0.42 / height, 0.87, 0.7 / height), sharex=ax)
        _lanes(ax, rows, lanes, waiting, size)
        _texts(ax, rows, labels or {}, len(names), size, end_ps - start_ps)
        _load(below, busy, start_ps, end_ps, size)
        ax.set_xlim(start_ps / size, end_ps / size)
        ax.tick_params(labelbottom=False)
        below.set_xlabel(f"time [{unit.replace('us', 'µs')}]")
        _legend(ax, rows, bool(waiting))
        if title:
            figure.text(0.11, 1 - top / 2 / height, title, va="center", size=10)
        return png(figure)

    return draw_styled(render, path)


def _lanes(
    ax: Axes,
    rows: NDArray[np.void],
    lanes: Sequence[str],
    waiting: Sequence[tuple[int, int, int]],
    size: int,
) -> None:
    for node, start, end in waiting:
        ax.broken_barh([(start / size, (end - start) / size)], (node - 0.14, 0.28), color=_WAITING)
    lane = np.where(rows["node"] < 0, len(lanes) - 1, rows["node"])
    for outcome, colour in (
        (Outcome.SENT, _SENT),
        (Outcome.FAILED, _FAILED),
        (Outcome.UNDER_WAY, _UNDER_WAY),
    ):
        for place in range(len(lanes)):
            mine = rows[(rows["outcome"] == outcome) & (lane == place)]
            spans = [(a / size, (b - a) / size) for a, b in mine[["start", "end"]].tolist()]
            hatch = "/////" if outcome == Outcome.FAILED else None
            ax.broken_barh(
                spans, (place - 0.36, 0.72), facecolor=colour, edgecolor="white", linewidth=0.4,
                hatch=hatch,
            )  # fmt: skip
    ax.set_yticks(range(len(lanes)), lanes)
    ax.set_ylim(len(lanes) - 0.5, -0.5)


def _texts(
    ax: Axes,
    rows: NDArray[np.void],
    labels: Mapping[int, str],
    nodes: int,
    size: int,
    window_ps: int,
) -> None:
    """The label of each frame that is wide enough for it."""
    if len(rows) > 10 * _LABELLED:
        return
    for row in rows:
        text = labels.get(int(row["request"]), "")
        share = (int(row["end"]) - int(row["start"])) / window_ps
        if not text or share < len(text) * 0.007 or not 0 <= row["node"] < nodes:
            continue
        middle = (int(row["start"]) + int(row["end"])) / 2 / size
        ax.text(
            middle, row["node"], text, ha="center", va="center", color="white", size=6.5,
            clip_on=True,
        )  # fmt: skip


def _load(ax: Axes, busy: NDArray[np.void], start_ps: int, end_ps: int, size: int) -> None:
    window = max(1, (end_ps - start_ps) // 50)
    shares = 100 * busy_share(busy, start_ps, end_ps, window)
    edges = np.append(np.arange(start_ps, end_ps, window), end_ps) / size
    ax.stairs(shares[:, 0], edges, fill=True, color=_SENT)
    ax.stairs(shares[:, 1], edges, fill=True, color=_FAILED)
    ax.set_ylim(0, 100)
    ax.set_ylabel("load [%]")


def _legend(ax: Axes, rows: NDArray[np.void], waiting: bool) -> None:
    from matplotlib.patches import Patch

    shown = [Patch(color=_SENT, label="frame")]
    if (rows["outcome"] == Outcome.FAILED).any():
        failed = Patch(facecolor=_FAILED, edgecolor="white", label="failed, error frame")
        failed.set_hatch("/////")
        shown.append(failed)
    if (rows["outcome"] == Outcome.UNDER_WAY).any():
        shown.append(Patch(color=_UNDER_WAY, label="under way"))
    if waiting:
        shown.append(Patch(color=_WAITING, label="waiting"))
    ax.legend(
        handles=shown, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(shown),
        borderaxespad=0.1, handlelength=1.2,
    )  # fmt: skip
