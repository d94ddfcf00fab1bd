"""The page of a ping: delays over time and by frequency, and all its lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np

from bridge.ping.clocks import Floats
from bridge.ping.figures import PathResult, WayFigures
from bridge.ping.losses import outages
from bridge.ping.report import COLUMNS, cells, text
from cosim.reporting.html import (
    Badge,
    PageData,
    PlottedPanel,
    TimedEvent,
    cards,
    command,
    folded,
    histogram,
    table,
    write_page,
)
from cosim.reporting.thinning import thin

#: Points of a curve, and bars of losses over time.
POINTS, BARS = 4000, 400
#: Longest list of outages that are marked.
MARKED = 200


@dataclass(frozen=True, slots=True)
class PingNotes:
    """The notes below the figures: `links` by direction, each its lines by kind; `prediction` of
    a scenario and `controllers` that come to rest, in lines; `command`: to measure again.
    """

    links: Mapping[str, Mapping[str, str]]
    command: str
    below: Sequence[str] = ()
    prediction: Sequence[str] = ()
    controllers: Sequence[str] = ()


def write_ping_page(path: Path, result: PathResult, notes: PingNotes) -> Path:
    """Write the report of a measured path.

    Raises RunError if it cannot be written, CosimError where uPlot is not installed.
    """
    figures = result.figures()
    return write_page(
        path, f"Network: {result.record.what}", "cosim ping", Badge("finished", _summary(result)),
        cards(_numbers(result, figures)), _data(result), _rest(result, figures, notes),
    )  # fmt: skip


def _summary(result: PathResult) -> str:
    record = result.record
    return (
        f"{record.received} of {record.sent} questions of {record.size} bytes were answered in "
        f"{result.sent[-1] - result.sent[0]:.4g} s."
    )


def _numbers(result: PathResult, figures: Mapping[str, WayFigures]) -> list[tuple[str, str]]:
    found = []
    for name, f in figures.items():
        found.append((f"{name}, 50 / 99 %", f"{_ms(f.quantiles[0])} / {_ms(f.quantiles[2])} ms"))
    found.append(("lost", f"{result.loss.share:.3%}"))
    longest = f", longest {result.loss.longest_outage:.3g} s" if result.loss.outages else ""
    found.append(("outages", f"{result.loss.outages}{longest}"))
    if result.below is not None and not result.same_host:
        found.append(("each way is known to", f"{_ms(result.uncertainty)} ms"))
    return found


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3f}"


def _data(result: PathResult) -> PageData:
    data = PageData(max(float(result.sent[-1]), 1e-3))
    names = []
    for name, delay in result.ways.items():
        rows = thin(delay, POINTS)
        data.add_curve(name, name, "ms", result.sent[rows], 1e3 * delay[rows])
        names.append((name, name))
    data.panels.append(PlottedPanel("Delay of each question", "ms", tuple(names)))
    if result.loss.share:
        t, share = _lost_over_time(result)
        data.add_curve("lost", "lost", "%", t, 100 * share)
        data.panels.append(PlottedPanel("Lost questions", "%", (("lost", "lost"),)))
    silent = outages(result.sent, ~np.isnan(result.rtt), result.record.period_ns)
    silent = np.clip(silent[:MARKED], 0, result.sent[-1])
    data.events += [TimedEvent(start, "outage", end) for start, end in silent.tolist()]
    if result.clock is not None:
        data.events += [TimedEvent(at, "the other clock jumped") for at in result.clock.steps]
    return data


def _lost_over_time(result: PathResult) -> tuple[Floats, Floats]:
    """Middles (m,), s, and shares (m,) of lost questions in equal parts of the time."""
    parts = min(BARS, max(1, result.sent.size // 20))
    lost = np.array_split(np.isnan(result.rtt), parts)
    sent = np.array_split(result.sent, parts)
    return np.array([t.mean() for t in sent]), np.array([x.mean() for x in lost])


def _rest(result: PathResult, figures: Mapping[str, WayFigures], notes: PingNotes) -> str:
    rows = [[name, *(_ms(x) for x in cells(f))] for name, f in figures.items()]
    pictures = "".join(
        histogram(
            f"How often: {name}, without the slowest 1 %",
            "ms",
            1e3 * delay[delay <= f.quantiles[2]],
            {"50 %": 1e3 * f.quantiles[0], "95 %": 1e3 * f.quantiles[1]},
        )
        for (name, delay), f in zip(result.ways.items(), figures.values(), strict=True)
    )
    parts = [[name, f"{1e6 * t:.1f}"] for name, t in result.parts.items()]
    return "".join(
        [
            f"<h2>Delays, ms</h2>{table(['', *COLUMNS], rows, len(COLUMNS))}{pictures}",
            f"<h2>Where a round trip goes</h2>{table(['part', 'median, us'], parts, 1)}",
            folded("All that was found, in words", _lines([*text(result), *notes.below])),
            _predicted(notes),
            "<h2>As a link of a scenario</h2>",
            *(_link(name, lines) for name, lines in notes.links.items()),
            f"<h2>Measure again</h2>{command('again', notes.command)}",
        ]
    )


def _lines(lines: Sequence[str]) -> str:
    return f'<div class="scroll"><pre>{escape(chr(10).join(lines))}</pre></div>'


def _predicted(notes: PingNotes) -> str:
    found = ""
    if notes.prediction:
        found += f"<h2>The scenario on this path</h2>{_lines(notes.prediction)}"
    if notes.controllers:
        found += f"<h2>Controllers, with every operator</h2>{_lines(notes.controllers)}"
    return found


def _link(name: str, lines: Mapping[str, str]) -> str:
    return folded(name, _lines(list(lines.values())), opened=True)
