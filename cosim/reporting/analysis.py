"""Figures of an analysis: manipulability over time, the port by frequency, effort and energy.

Drawn with matplotlib's Agg canvas, without pyplot; matplotlib is imported by the first figure.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.analysis.analysis import Analysis
from cosim.analysis.recorded_port import RecordedPort
from cosim.base.files import write_file
from cosim.base.units import printed_unit
from cosim.measure.manipulability import Curve, local_growth
from cosim.predict.facts import Array
from cosim.record.piecewise import Repeated
from cosim.reporting.figures import COLOURS, load
from cosim.reporting.thinning import Thinned

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.labelsize": 8.5,
    "axes.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": "0.9",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.2,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "legend.fontsize": 8,
    "legend.frameon": False,
}
_CLOSED: dict[str, Any] = {"linestyle": (0, (5, 3)), "linewidth": 1.0}
_REFERENCE: dict[str, Any] = {"color": "0.35", "linestyle": (0, (1, 1.5)), "linewidth": 0.9}


def draw(found: Analysis, folder: Path) -> list[Path]:
    """Draw the figures into `folder`, which is made; their paths. Raises RunError."""
    load()
    import matplotlib

    folder.mkdir(parents=True, exist_ok=True)
    figures = [("manipulability", _manipulability, 2)]
    if found.swept:
        figures.append(("port", _port, 3 if found.port.collocated else 1))
    figures.append(("effort", _effort, 2 if found.recorded.moving else 1))
    paths = []
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        for name, paint, panels in figures:
            paths.append(_save(found, paint, panels, folder / f"{name}.png"))
    return paths


def _save(found: Analysis, paint: Any, panels: int, path: Path) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 0.7 + 2.3 * panels), dpi=150, layout="constrained")
    canvas: Any = FigureCanvasAgg(figure)
    axes = figure.subplots(panels, 1, sharex=True, squeeze=False)[:, 0]
    paint(found, list(axes))
    figure.suptitle(f"{found.title}: port {found.port.arm}", fontsize=10)
    image = io.BytesIO()
    canvas.print_png(image, metadata={"Software": None})
    write_file(path, image.getvalue())
    return path


# ---- over time ----------------------------------------------------------------------------------


def _manipulability(found: Analysis, axes: Sequence[Axes]) -> None:
    above, below = axes
    r = found.recorded
    t, M = _even(r)
    if len(t):
        above.loglog(t, M, color=COLOURS[0], label="$M^t$ of the run")
    limit = np.full(len(t), inf) if found.bound is None else found.bound(t)
    if len(t) and np.isfinite(limit).all():
        label = "upper bound O6 (θ known, together, from rest)"
        above.loglog(t, limit, color=COLOURS[1], label=label, **_CLOSED)
    above.set_ylabel(f"$M^t$ [{printed_unit(r.unit)}]")
    above.set_title("manipulability: ‖response‖₂ over ‖force‖₂ up to t")
    t, slope = local_growth(Repeated(lambda: r.M), r.last)
    late = t > r.last / 3000
    t, slope = t[late], slope[late]
    below.semilogx(t, slope, color=COLOURS[0], label="slope of the run")
    for value, text in ((1.0, "constant push"), (0.5, "hand at rest"), (0.0, "finite")):
        below.axhline(value, **_REFERENCE)
        below.annotate(
            text, (0.008, value), xycoords=("axes fraction", "data"), ha="left", va="bottom",
            fontsize=7.5, color="0.35",
        )  # fmt: skip
    if len(slope):
        below.set_ylim(min(-0.2, slope.min() - 0.1), max(1.25, slope.max() + 0.1))
    below.set_ylabel("d log M / d log t")
    below.set_xlabel("time [s]")
    _legends(axes[:1])


def _effort(found: Analysis, axes: Sequence[Axes]) -> None:
    r = found.recorded
    forces = Repeated(lambda: ((x.t, np.sqrt((x.force**2).sum(axis=1))) for x in r))
    axes[0].plot(*_thinned(forces, r.rows), color=COLOURS[0])
    axes[0].set_ylabel(f"|force| [{printed_unit(r.units[0])}]")
    axes[0].set_title("force of the operator")
    if r.moving:
        axes[1].plot(*_thinned(Repeated(lambda: r.E), r.rows), color=COLOURS[2])
        axes[1].axhline(0.0, **_REFERENCE)
        axes[1].set_ylabel("E [J]")
        what = "what went in less what came out at the far end" if r.far else "what went in"
        axes[1].set_title(f"passivity observer: {what}")
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(r.first, r.last)


def _thinned(curve: Curve, rows: int) -> tuple[Array, Array]:
    """Times, s, and values of a curve that keep every extreme."""
    kept, at, times = Thinned(rows), 0, list[Array]()
    for _, y in curve:
        kept.add(y)
    for t, _ in curve:
        times.append(t[kept.rows[slice(*np.searchsorted(kept.rows, (at, at + len(t))))] - at])
        at += len(t)
    return np.concatenate(times), kept.y


# ---- over frequency -----------------------------------------------------------------------------


def _port(found: Analysis, axes: Sequence[Axes]) -> None:
    for colour, one in zip(COLOURS, found.swept, strict=False):
        measured, form = one.measured, one.drawn
        axes[0].loglog(
            measured.omega, measured.size, "o", color=colour, markersize=3, label=_named(one.title)
        )
        if form is not None:
            axes[0].loglog(form.omega, form.size, color=colour, **_CLOSED)
        if len(axes) > 1:
            _passivity(axes[1], one.title, measured, colour, "o")
            _damping(axes[2], one.title, measured, colour, "o")
            if form is not None:
                _passivity(axes[1], "", form, colour, "")
                _damping(axes[2], "", form, colour, "")
    axes[0].set_ylabel(f"|G| [{printed_unit(found.recorded.unit)}]")
    axes[0].set_title("gain from force to position (points: test forces; dashed: closed form)")
    if len(axes) > 1:
        axes[1].axhline(0.0, **_REFERENCE)
        axes[1].set_ylabel("min Re Y / |Y|")
        axes[1].set_title("passive where not below 0")
        axes[2].axhline(0.0, **_REFERENCE)
        axes[2].set_ylabel("Re Z [N·m·s/rad]")
        axes[2].set_title("felt damping, least over directions")
        low, high = axes[2].get_ylim()
        if high > 50 * max(1.0, abs(low)):
            axes[2].set_ylim(low, 50 * max(1.0, abs(low)))
    axes[-1].set_xlabel("ω [rad/s]")
    _legends(axes[:1])


def _passivity(ax: Axes, label: str, gain: Any, colour: str, marker: str) -> None:
    share = gain.real_part() / np.linalg.norm(gain.admittance, 2, axis=(1, 2))
    _line(ax, label, gain.omega, share, colour, marker)


def _damping(ax: Axes, label: str, gain: Any, colour: str, marker: str) -> None:
    Z = gain.impedance
    least = np.linalg.eigvalsh((Z + np.conj(np.swapaxes(Z, 1, 2))) / 2)[:, 0]
    _line(ax, label, gain.omega, least, colour, marker)


def _line(ax: Axes, label: str, omega: Array, y: Array, colour: str, marker: str) -> None:
    style: dict[str, Any] = {"linestyle": "none", "marker": marker, "markersize": 3}
    ax.semilogx(omega, y, color=colour, label=label or "_", **(style if marker else _CLOSED))


def _legends(axes: Sequence[Axes]) -> None:
    for ax in axes:
        if ax.get_legend_handles_labels()[0]:
            ax.legend(loc="best")


def _even(r: RecordedPort, most: int = 2000) -> tuple[Array, Array]:
    """Times, s, and M^t, at rows that are even over log t."""

    def good(t: Array, M: Array) -> tuple[Array, Array]:
        rows = np.isfinite(M) & (M > 0) & (t > r.last / 3000)
        return t[rows], M[rows]

    ends = [t[[0, -1]] for t, _ in (good(*piece) for piece in r.M) if len(t)]
    if not ends:
        return np.empty(0), np.empty(0)
    wanted, done = np.geomspace(ends[0][0], ends[-1][-1], most), 0
    found: list[tuple[Array, Array]] = []
    for t, M in (good(*piece) for piece in r.M):
        ready = int(np.searchsorted(wanted, t[-1], side="right")) if len(t) else done
        rows = np.unique(np.searchsorted(t, wanted[done:ready]))
        found.append((t[rows], M[rows]))
        done = max(done, ready)
    times, values = (np.concatenate(x) for x in zip(*found, strict=True))
    return times, values


def _named(title: str) -> str:
    return title.replace("M_hat = M", r"$\hat{M} = M$")
