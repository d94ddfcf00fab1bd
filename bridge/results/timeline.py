"""The nodes of a rehearsal over time: what happened first, and a drawing of states, missed slots
and faults.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bridge.deployment.system import System
from bridge.native.safety import LifeState, Why
from bridge.records.node_lives import Life
from bridge.records.records import Done, Lagged, Remark, reason_names, reason_text
from bridge.results import overload
from bridge.results.findings import Evidence
from bridge.results.rehearsal_outcome import RehearsalOutcome
from bridge.results.report import NodeReport
from bridge.safety.limits import explain_guard
from bridge.wiring.wiring import Rows
from cosim.base.names import listed

#: Sizes of the drawing: names of lanes, lanes, and the whole width; columns in which slots count.
_LEFT, _LANE, _WIDTH, _COLUMNS = 150, 26, 1100, 400
#: Frames: the height of a lane, the most lanes, and how many shades there are.
_THIN, _MESSAGES, _SHADES = 18, 40, 4
#: What happened to a node that stops because another did; happenings that are listed at most.
_PEER, FIRST = "stopped because of a peer", 8
_COLOURS = {
    LifeState.ACTIVE: "var(--s2)",
    LifeState.STOPPING: "var(--s4)",
    LifeState.FAULT: "var(--failed)",
}


@dataclass(frozen=True, slots=True)
class FirstCause:
    """Something that happened at `t` (s) to a node, a bus or several of them, `who`."""

    t: float
    who: str
    what: str

    def __str__(self) -> str:
        """``2.310 s slave_arm: drive 3 on bus right went off (undervoltage)``."""
        return f"{self.t:.3f} s {self.who}: {self.what}"


def happenings(system: System, outcome: RehearsalOutcome) -> list[FirstCause]:
    """The first causes of what a rehearsal came to, and what followed, in the order of time.

    Injected faults, buses and nodes that were late, drives that went off, guards that acted, and
    stops: the first of each kind of a node. Nodes that stopped one after the other because of a
    peer are one.
    """
    found = [FirstCause(f.t0, listed(f.targets), f"{f.kind} injected") for f in outcome.faults]
    found += _noted(outcome)
    for lag in overload.bus_lags(system, outcome, overload.limit(system) / 2):
        late = f"up to {lag.late:.2f} s behind the wall clock, until {lag.end:.3f} s"
        found.append(FirstCause(lag.t, f"bus {lag.bus}", late))
    for report in outcome.reports:
        found += _of_node(system, outcome, report)
    together: list[FirstCause] = []
    for one in sorted(found, key=lambda x: x.t):
        last = together[-1] if together else None
        if last is not None and last.what == one.what == _PEER:
            together[-1] = FirstCause(last.t, f"{last.who}, {one.who}", _PEER)
        else:
            together.append(one)
    return together


def causes_text(found: Sequence[FirstCause]) -> str:
    """The first happenings in one line: ``2.310 s slave: stopped (...) → 2.400 s master: ...``."""
    said = [str(x) for x in found[:FIRST]]
    return " → ".join([*said, *([f"{len(found) - FIRST} more"] if len(found) > FIRST else [])])


def _noted(outcome: RehearsalOutcome) -> Iterator[FirstCause]:
    """The notes of the supervisor about nodes."""
    for note in outcome.notes:
        if not isinstance(note, Done | Remark | Lagged):
            who = f"node {note.life}"
            yield FirstCause(note.t, str(note.life), note.describe().removeprefix(f"{who} "))


def _of_node(system: System, outcome: RehearsalOutcome, report: NodeReport) -> Iterator[FirstCause]:
    """The first happening of each kind at a node."""
    rows, who = outcome.rows[report.life], str(report.life)
    if not len(rows):
        return
    t, late = rows["deadline_ns"] * 1e-9, overload.lateness(outcome, report)
    if len(at := np.flatnonzero(late >= overload.limit(system) / 2 * 1e9)):
        yield FirstCause(float(t[at[0]]), who, f"woke up {late[at[0]] * 1e-6:.0f} ms late")
    if len(at := np.flatnonzero(rows["guard"])):
        acted = explain_guard(int(rows["guard"][at[0]]))
        yield FirstCause(float(t[at[0]]), who, f"the guard acted ({acted})")
    drives = report.statement.drives if report.statement else ()
    for event in drives:
        if event["phase"] == "failed":
            why = event["told"] or event["failure"]
            yield FirstCause(event["t"], who, f"{event['drive']} went off ({why})")
    stopped = np.isin(rows["state"], (LifeState.STOPPING, LifeState.FAULT))
    bits = rows["reasons"] & np.uint32(~Why.COMMAND & 0xFFFFFFFF)
    if len(at := np.flatnonzero(stopped & (bits != 0))):
        names = reason_names(int(bits[at[0]]))
        what = _PEER if names == ("peer",) else f"stopped ({reason_text(names)})"
        yield FirstCause(float(t[at[0]]), who, what)


def lanes(outcome: RehearsalOutcome, end: float) -> str:
    """A lane for each life of a node, until `end` (s), and one for the faults."""
    reports = [r for r in outcome.reports if len(outcome.rows[r.life])]
    if not reports or end <= 0:
        return ""
    drawn: list[str] = []
    y = 0
    for report in reports:
        rows, period = outcome.rows[report.life], report.lateness.period_ns
        drawn += _lane(report.life, rows, period, y, end)
        y += _LANE
        if report.statement and report.statement.drives:
            drawn += _drive_lane(report, rows, y, end)
            y += _LANE
    if outcome.faults:
        drawn += _faults(outcome.faults, y, end)
        y += _LANE
    height = y
    legend = (
        "green: active, or all drives enabled; yellow: ramping down; red: fault, or a drive "
        "that is off; grey: not started; black: missed slots"
    )
    inside = "".join(drawn) + _axis(height, end)
    return (
        f"<figure class='wide'><figcaption>States, missed slots and faults ({legend})</figcaption>"
        f'<svg viewBox="0 0 {_WIDTH} {height + 22}" role="img" aria-label="States of the nodes '
        f'over time; the table below says how each ended">{inside}</svg></figure>'
    )


def frame_lanes(outcome: RehearsalOutcome, end: float) -> str:
    """A lane for each message on each CAN bus, until `end` (s): darker where there are more frames.

    Nothing is drawn where no frame of the message was on the bus.
    """
    messages = [
        (f"{bus} {name}" if len(outcome.buses) > 1 else name, t)
        for bus, found in outcome.buses.items()
        for name, t in found.frames.items()
    ][:_MESSAGES]
    if not messages or end <= 0:
        return ""
    drawn = [x for k, (name, t) in enumerate(messages) for x in _frame_lane(name, t, k, end)]
    height = len(messages) * _THIN
    return (
        "<figure class='wide'><figcaption>Frames on the buses (darker: more in that time)"
        f'</figcaption><svg viewBox="0 0 {_WIDTH} {height + 22}" role="img" aria-label="Frames of '
        f'each message over time">{"".join(drawn)}{_axis(height, end)}</svg></figure>'
    )


def _frame_lane(name: str, t: NDArray[np.float64], lane: int, end: float) -> Iterator[str]:
    y = lane * _THIN
    yield f'<text x="0" y="{y + 12}">{escape(name[:22])}</text>'
    counts, at = np.histogram(t, bins=_COLUMNS, range=(0.0, end))
    shades = np.ceil(_SHADES * counts / max(1, counts.max())).astype(int)
    edges = np.flatnonzero(np.diff(shades)) + 1
    for first, last in zip([0, *edges], [*edges, len(shades)], strict=True):
        if shades[first]:
            x, total = _x(at[first], end), int(counts[first:last].sum())
            said = f"{name}: {total} frames from {at[first]:.2f} s to {at[last]:.2f} s"
            yield (
                f'<rect x="{x:.1f}" y="{y + 3}" width="{_x(at[last], end) - x:.1f}" height="12" '
                f'fill="var(--s0)" fill-opacity="{shades[first] / _SHADES:.2f}"><title>'
                f"{escape(said)}</title></rect>"
            )


def marks(outcome: RehearsalOutcome) -> list[dict[str, Any]]:
    """Injected faults and fault states of nodes, as ``marks`` of ``run.json``: t, label, to (s)."""
    found = [
        {"t": f.t0, "label": f.text(), "to": f.t1 if f.t1 > f.t0 else None} for f in outcome.faults
    ]
    for report in outcome.reports:
        for kind, t0, t1 in _states(outcome.rows[report.life], report.lateness.period_ns):
            if kind is LifeState.FAULT:
                found.append({"t": t0, "label": f"{report.life}: FAULT", "to": t1})
        for event in report.statement.drives if report.statement else ():
            if event["phase"] == "failed":
                label = f"{event['drive']}: {event['told'] or event['failure']}"
                found.append({"t": event["t"], "label": label, "to": None})
    return found


def _states(rows: Rows, period_ns: int) -> Iterator[tuple[LifeState, float, float]]:
    """The states of a life one after the other: from when to when, s."""
    if not len(rows):
        return
    state, h = np.asarray(rows["state"]), period_ns * 1e-9
    edges = np.flatnonzero(np.diff(state)) + 1
    for first, last in zip([0, *edges], [*edges, len(state)], strict=True):
        start, end = int(rows["slot"][first]), int(rows["slot"][last - 1]) + 1
        yield LifeState(int(state[first])), start * h, end * h


def _x(t: float, end: float) -> float:
    return _LEFT + (_WIDTH - _LEFT - 10) * min(max(t / end, 0.0), 1.0)


def _lane(life: Life, rows: Rows, period_ns: int, y: int, end: float) -> Iterator[str]:
    yield f'<text x="0" y="{y + 17}">{escape(str(life))}</text>'
    h = period_ns * 1e-9
    for kind, t0, t1 in _states(rows, period_ns):
        yield _bar(
            t0, t1, y, end, _COLOURS.get(kind, "var(--line)"), f"{life}: {kind.name.lower()}"
        )
    missed = rows["slot"][rows["woke_ns"] - rows["deadline_ns"] >= period_ns] * h
    counts, at = np.histogram(missed, bins=_COLUMNS, range=(0.0, end))
    for k in np.flatnonzero(counts):
        said = f"{life}: {counts[k]} slots missed from {at[k]:.2f} s to {at[k + 1]:.2f} s"
        yield (
            f'<rect x="{_x(at[k], end):.1f}" y="{y + 2}" width="3" height="22" fill="var(--text)">'
            f"<title>{escape(said)}</title></rect>"
        )


def _drive_lane(report: NodeReport, rows: Rows, y: int, end: float) -> Iterator[str]:
    """The drives that a life commands: when all of them got torque, and when some did not."""
    yield f'<text class="faint" x="12" y="{y + 17}">its drives</text>'
    serving, h = np.asarray(rows["serving"]), report.lateness.period_ns * 1e-9
    everyone = int(np.bitwise_or.reduce(serving)) if len(serving) else 0
    edges = np.flatnonzero(np.diff(serving)) + 1
    for first, last in zip([0, *edges], [*edges, len(serving)], strict=True):
        off = bin(everyone & ~int(serving[first])).count("1")
        t0, t1 = int(rows["slot"][first]) * h, (int(rows["slot"][last - 1]) + 1) * h
        said = f"{off} of {bin(everyone).count('1')} drives off" if off else "all drives enabled"
        yield _bar(t0, t1, y, end, "var(--failed)" if off else "var(--s2)", said)


def _bar(t0: float, t1: float, y: int, end: float, colour: str, title: str) -> str:
    x = _x(t0, end)
    said = escape(f"{title} from {t0:.2f} s to {t1:.2f} s")
    return (
        f'<rect x="{x:.1f}" y="{y + 6}" width="{max(_x(t1, end) - x, 2):.1f}" height="14" '
        f'fill="{colour}"><title>{said}</title></rect>'
    )


def _faults(faults: Sequence[Evidence], y: int, end: float) -> Iterator[str]:
    yield f'<text x="0" y="{y + 17}">faults</text>'
    for fault in faults:
        unseen = fault.verdict == "unseen"
        colour = "var(--failed)" if unseen else "var(--s1)"
        yield _bar(fault.t0, max(fault.t0, fault.t1), y, end, colour, fault.text())
        yield (
            f'<text class="faint" x="{_x(fault.t0, end):.1f}" y="{y + 5}">{fault.index}'
            f"{' unseen' if unseen else ''}</text>"
        )


def _axis(height: int, end: float) -> str:
    ticks = [f"{end * k / 8:.3g}" for k in range(9)]
    return "".join(
        f'<text class="faint" x="{_x(float(t), end):.1f}" y="{height + 16}" text-anchor="'
        f'{"end" if k == 8 else "middle"}">{t}{" s" if k == 8 else ""}</text>'
        for k, t in enumerate(ticks)
    )
