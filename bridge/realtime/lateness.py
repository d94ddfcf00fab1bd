"""Lateness of a node and duration of its slots: a report like cyclictest's, from its journal.

Lateness is the wake-up time minus the deadline. Quantiles are those of the values (nearest rank:
the ⌈q·n⌉-th smallest), so p99.9 of less than 1000 slots is their maximum. A late node executes the
missed slots immediately: one stall of 5 ms at 1 kHz appears as five late slots. The row "each stall
once" counts only the first of them, as cyclictest does, and is comparable with it.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bridge.native.pace import edges
from cosim.base.copies import asdict
from cosim.base.errors import CosimError, RunError
from cosim.base.extras import require

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.int64]

#: What a slot consists of, after it woke: name, first and last of the journal's times.
PARTS = (
    ("receive", "woke", "received"),
    ("step", "received", "stepped"),
    ("send", "stepped", "sent"),
)
_WIDTH = 50
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")


@dataclass(frozen=True, slots=True)
class Spread:
    """Statistics of n durations, ns; `std` is that of the values, not of their mean."""

    count: int
    minimum: int
    mean: float
    std: float
    p50: int
    p99: int
    p999: int
    maximum: int

    @classmethod
    def of(cls, values: ArrayLike, what: str = "durations") -> Spread:
        """The spread of `values` (n,), ns. Raises CosimError for none."""
        x = np.sort(np.asarray(values, np.int64).ravel())
        if not len(x):
            raise CosimError(f"{what}: found no values, expected one or more")
        p50, p99, p999 = (int(x[max(0, -(-len(x) * q // 1000) - 1)]) for q in (500, 990, 999))
        return cls(len(x), int(x[0]), float(x.mean()), float(x.std()), p50, p99, p999, int(x[-1]))

    def row(self) -> list[str]:
        """min, avg, p50, p99, p99.9, max, std as texts, us."""
        shown = (self.minimum, self.mean, self.p50, self.p99, self.p999, self.maximum, self.std)
        return [f"{ns * 1e-3:.1f}" for ns in shown]


@dataclass(frozen=True, slots=True)
class Lateness:
    """The report: `late`, `period` between two wake-ups, `parts` of a slot; all in ns.

    `once`: `late` without the slots whose deadline had passed when the previous slot began.
    `missed`: slots a period late or more, counted as in ``bridge/c/wall_clock.c``. `bins`:
    (lower edge, ns, count) of the nonempty bins of ``pace.h``, ascending.
    """

    period_ns: int
    missed: int
    late: Spread
    once: Spread
    period: Spread | None
    parts: Mapping[str, Spread]
    bins: tuple[tuple[int, int], ...]

    @property
    def ratio(self) -> float:
        """p99.9 of the lateness over the nominal period, 1."""
        return self.late.p999 / self.period_ns

    def rows(self) -> list[list[str]]:
        """A header and a row each for lateness, period and parts, texts in us."""
        table = [["us", "min", "avg", "p50", "p99", "p99.9", "max", "std"]]
        table.append(["lateness", *self.late.row()])
        table.append(["  each stall once", *self.once.row()])
        if self.period is not None:
            table.append([f"period ({self.period_ns * 1e-3:g} nominal)", *self.period.row()])
        return table + [[name, *spread.row()] for name, spread in self.parts.items()]

    def text(self) -> str:
        """The rows, aligned, and what was missed; no line ends in a newline."""
        table = self.rows()
        widths = [max(len(row[i]) for row in table) for i in range(len(table[0]))]
        lines = [
            "  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])])
            for row in table
        ]
        share = 100 * self.missed / self.late.count
        lines.append(f"{self.late.count} slots, {self.missed} missed ({share:.3g} %)")
        return "\n".join(lines)

    def histogram(self) -> str:
        """The histogram as text: bins joined to a 1-2-5 series, bars of the logarithm."""
        counts = _joined(self.bins)
        most = np.log10(1 + max(n for *_, n in counts))
        return "\n".join(
            f"{low * 1e-3:>9g} us {n:>9} {'#' * round(_WIDTH * np.log10(1 + n) / most)}".rstrip()
            for low, n in counts
        )

    def facts(self) -> dict[str, Any]:
        """Everything as JSON takes it."""
        return asdict(self)


def lateness(
    deadline: ArrayLike,
    woke: ArrayLike,
    period_ns: int,
    *,
    received: ArrayLike | None = None,
    stepped: ArrayLike | None = None,
    sent: ArrayLike | None = None,
) -> Lateness:
    """The report of n slots: columns of a journal, (n,) each, ns of one clock.

    A part of the slot is reported when both its ends are there. `period_ns`: nominal.
    Raises CosimError for no slots, columns of different lengths, or a period that is not positive.
    """
    given = {"deadline": deadline, "woke": woke, "received": received, "stepped": stepped,
             "sent": sent}  # fmt: skip
    columns = {k: np.asarray(v, np.int64) for k, v in given.items() if v is not None}
    lengths = {k: v.shape for k, v in columns.items()}
    if period_ns <= 0 or len(set(lengths.values())) != 1 or columns["woke"].ndim != 1:
        raise CosimError(
            f"lateness: found a period of {period_ns} ns and columns of shapes {lengths}; "
            "expected a positive period and one length"
        )
    late = columns["woke"] - columns["deadline"]
    between = np.diff(columns["woke"])
    behind = np.r_[False, columns["woke"][:-1] >= columns["deadline"][1:]][: len(late)]
    return Lateness(
        period_ns=period_ns,
        missed=int(np.count_nonzero(late >= period_ns)),
        late=Spread.of(late, "lateness"),
        once=Spread.of(late[~behind], "lateness"),
        period=Spread.of(between, "period") if len(between) else None,
        parts={
            name: Spread.of(columns[end] - columns[start], name)
            for name, start, end in PARTS
            if start in columns and end in columns
        },
        bins=_bins(late),
    )


def journal_lateness(rows: NDArray[np.void], period_ns: int) -> Lateness:
    """The report of one life of a node, from its journal (n,): ``row_t`` of ``bridge/c/rows.h``.

    There a slot has `done_ns`, when all was sent, and `send_ns`, what sending took.
    """
    done = rows["done_ns"]
    return lateness(
        rows["deadline_ns"], rows["woke_ns"], period_ns,
        received=rows["received_ns"], stepped=done - rows["send_ns"], sent=done,
    )  # fmt: skip


def _bins(late: Array) -> tuple[tuple[int, int], ...]:
    limits = edges()
    counts, _ = np.histogram(np.clip(late, 0, limits[-1] - 1), limits)
    return tuple((int(limits[b]), int(counts[b])) for b in np.flatnonzero(counts))


def _joined(bins: tuple[tuple[int, int], ...]) -> list[tuple[int, int]]:
    """Counts from each of 0, 1, 2, 5, 10, 20 … us to the next, from the first to the last used."""
    steps = [0, *(m * 10**e for e in range(3, 11) for m in (1, 2, 5))]
    found = dict.fromkeys(steps, 0)
    for low, n in bins:
        found[max(s for s in steps if s <= low)] += n
    used = [s for s in steps if found[s]]
    return [(s, found[s]) for s in steps if used[0] <= s <= used[-1]]


def draw(reports: Mapping[str, Lateness], path: str | Path) -> Path:
    """Draw the numbers of slots (log) that were at least so late (us) into the PNG `path`.

    Unlike a histogram, such a line has no gaps where slots are rare, which is what matters here.

    One line a report, by its label. Above 1 ms the axis of the lateness is logarithmic too.
    Raises CosimError for no reports, RunError with the path if it cannot be written.
    """
    if not reports:
        raise CosimError(f"figure {path}: found no reports, expected one or more")
    require("matplotlib")
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    image = io.BytesIO()
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams["font.size"] = 8.5
        figure = Figure(figsize=(7.2, 3.6), dpi=150)
        canvas: Any = FigureCanvasAgg(figure)  # partly untyped
        _plot(figure.add_axes((0.08, 0.13, 0.9, 0.84)), reports)
        canvas.print_png(image, metadata={"Software": None})
    try:
        Path(path).write_bytes(image.getvalue())
    except OSError as error:
        raise RunError(f"cannot write {path}: {error.strerror}") from error
    return Path(path)


def _plot(ax: Axes, reports: Mapping[str, Lateness]) -> None:
    limits = edges() * 1e-3
    most = max(report.late.maximum for report in reports.values()) * 1e-3
    for i, (name, report) in enumerate(reports.items()):
        counts = np.zeros(len(limits) - 1)
        counts[np.searchsorted(edges(), [low for low, _ in report.bins])] = [
            n for _, n in report.bins
        ]
        late = report.late
        p50, p99, worst = (f"{ns * 1e-3:.0f}" for ns in (late.p50, late.p99, late.maximum))
        label = f"{name}: p50 {p50}, p99 {p99}, max {worst} us"
        last = int(np.searchsorted(limits, most, side="right"))
        later = counts[::-1].cumsum()[::-1]
        ax.stairs(later[:last], limits[: last + 1], label=label, lw=0.9,
                  color=_COLOURS[i % len(_COLOURS)], baseline=None)  # fmt: skip
    ax.set_yscale("log")
    ax.set_ylim(bottom=0.5)
    if most > 1000:
        ax.set_xscale("log")
        ax.set_xlim(left=1)
    else:
        ax.set_xlim(left=0)
    ax.set_xlabel("lateness [us]")
    ax.set_ylabel("slots at least so late")
    ax.grid(color="0.9", linewidth=0.5)
    ax.legend(loc="upper right", frameon=False)
