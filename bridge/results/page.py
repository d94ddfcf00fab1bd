"""``report.html`` of a rehearsal: that of a run, and its verdict, nodes, lateness and faults."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from bridge.deployment.system import System
from bridge.results import overload
from bridge.results.outcome import lines, metric_lines, twin_text
from bridge.results.rehearsal_outcome import RehearsalOutcome
from bridge.results.report import NodeReport, signal_ages
from bridge.results.timeline import FIRST, frame_lanes, happenings, lanes
from bridge.results.verdict import Verdict, Word, judge
from bridge.wiring.wiring import Rows
from cosim.record import Run
from cosim.reporting.html import (
    Badge,
    PageData,
    PlottedPanel,
    cards,
    folded,
    histogram,
    table,
)
from cosim.reporting.run_report import CHOSEN, write_report


def describe(system: System, outcome: RehearsalOutcome) -> Path:
    """Write the report of a rehearsal with its verdict and all lines of its summary.

    Raises CosimError if it cannot be written.
    """
    run = Run.open(outcome.folder)
    said = [*metric_lines(system, outcome, run), *lines(system, outcome)]
    return write_page(system, run, outcome, judge(system, outcome), said)


def write_page(
    system: System, run: Run, outcome: RehearsalOutcome, found: Verdict, said: Sequence[str]
) -> Path:
    """Write the report of a rehearsal into its folder. `said`: what the command printed of it.

    Raises CosimError if it cannot be written.
    """

    def extend(data: PageData) -> str:
        nodes = table(
            ["node", "lateness and end"], [(str(r.life), r.text()) for r in outcome.reports]
        )
        faults = table(["fault", ""], [(f"{f.index}", f.text()) for f in outcome.faults])
        _loads(outcome, data)
        return (
            f"<h2>Nodes</h2>{lanes(outcome, data.end)}{nodes}{_firmware(outcome)}"
            f"{_configured(system, outcome)}"
            + (f"<h2>Buses</h2>{frame_lanes(outcome, data.end)}" if outcome.buses else "")
            + f'<section id="load"></section><section id="late"></section>'
            f'<div class="charts">{"".join(_lateness(outcome, data))}</div>'
            + (f"<h2>Faults</h2>{faults}" if outcome.faults else "")
            + folded("Summary", table(["", ""], [_pair(line) for line in said]))
        )

    reason = "; ".join(found.reasons) or "every check of the run and of its replay"
    first = f"{_causes(system, outcome, found)}{cards(_facts(system, outcome))}"
    return write_report(run, Badge(found.word.value, reason), extend, first)


def _causes(system: System, outcome: RehearsalOutcome, found: Verdict) -> str:
    """The first causes in the order of time, unless the run passed."""
    every = happenings(system, outcome) if found.word is not Word.PASSED else []
    if not every:
        return ""
    rows = [(f"{x.t:.3f} s", x.who, x.what) for x in every[:FIRST]]
    rest = f"<p>{len(every) - FIRST} more below.</p>" if len(every) > FIRST else ""
    return f"<h2>What happened first</h2>{table(['time', 'where', 'what'], rows)}{rest}"


def _firmware(outcome: RehearsalOutcome) -> str:
    """The images that computed the slots of nodes, if there are any."""
    rows = [
        (str(r.life), facts["image"], facts["machine"], facts["sha256"])
        for r in outcome.reports
        if r.statement and (facts := r.statement.firmware)
    ]
    return table(["firmware", "image", "machine", "SHA-256"], rows) if rows else ""


def _facts(system: System, outcome: RehearsalOutcome) -> Iterator[tuple[str, str]]:
    """The numbers of a rehearsal: how far it is from its twin, what was late, its replay."""
    if outcome.twin_rms:
        yield "apart from the twin", twin_text(outcome.twin_rms)
    slots = sum(r.slots for r in outcome.reports)
    yield "slots missed", f"{sum(r.lateness.missed for r in outcome.reports)} of {slots}"
    for lag in overload.bus_lags(system, outcome, overload.limit(system) / 2)[:2]:
        yield f"bus {lag.bus} behind the clock", f"up to {lag.late:.2f} s"
    exact = outcome.replayed is not None and outcome.replayed.first is None
    yield "replay", "exact" if exact else "differs"
    if outcome.faults:
        seen = sum(f.verdict == "seen" for f in outcome.faults)
        yield "faults in the report", f"{seen} of {sum(f.done > 0 for f in outcome.faults)}"


def _configured(system: System, outcome: RehearsalOutcome) -> str:
    """Periods of nodes and ages of signals: what was configured, and what was measured."""
    periods = [
        (str(r.life), f"{r.lateness.period_ns / 1e6:g} ms", *_period_parts(r))
        for r in outcome.reports
    ]
    head = ["node", "period configured", "measured", "standard deviation"]
    ages = [
        (a.signal, *(_ms(x) for x in (a.configured, a.p50, a.p99, a.greatest, a.total)))
        for a in signal_ages(system, outcome.rows)
    ]
    names = ["signal", "delay configured", "network p50", "p99", "greatest", "total mean"]
    return (
        f"<h2>Configured and measured</h2>{table(head, periods, 3)}"
        f"{table(names, ages, 5) if ages else ''}"
    )


def _period_parts(report: NodeReport) -> tuple[str, str]:
    period = report.lateness.period
    if period is None:
        return "–", "–"
    return f"{period.mean / 1e6:.4f} ms", f"{period.std / 1e3:.0f} µs"


def _ms(value: float) -> str:
    return "–" if value != value else f"{value:.4g} ms"


def _lateness(outcome: RehearsalOutcome, data: PageData) -> Iterator[str]:
    """Histograms of the lateness of nodes, and their diagram; none in simulated time."""
    series = []
    for report in outcome.reports:
        rows = outcome.rows[report.life]
        if len(rows) < 2:
            continue
        name = f"lateness of {report.life}"
        late = (rows["woke_ns"] - rows["deadline_ns"]) * 1e-3
        if not late.any():
            continue
        data.add(name, "us", late, _period(rows), CHOSEN)
        series.append((name, str(report.life)))
        yield histogram(name, "us", late, _marks(report))
    if series:
        data.panels.append(PlottedPanel("Lateness of each slot", "us", tuple(series), (), "late"))


def _loads(outcome: RehearsalOutcome, data: PageData) -> None:
    """Add the load of each CAN bus over time, a point for each tenth of a second."""
    series = []
    for name, bus in outcome.buses.items():
        t = bus.start + 0.1 * np.arange(len(bus.load))
        during = (t >= 0) & (t <= data.end)
        data.add_curve(f"load of {name}", name, "%", t[during], 100 * bus.load[during])
        series.append((f"load of {name}", name))
    if series:
        data.panels.append(PlottedPanel("Load of each bus", "%", tuple(series), (), "load"))


def _period(rows: Rows) -> float:
    """Time between two slots, s."""
    return float(np.median(np.diff(rows["deadline_ns"]))) * 1e-9


def _marks(report: NodeReport) -> dict[str, float]:
    late = report.lateness.late
    return {"p50": late.p50 * 1e-3, "p99": late.p99 * 1e-3}


def _pair(line: str) -> tuple[str, str]:
    """A line of the summary as its name and its text."""
    return line[:16].strip(), line[16:].strip()
