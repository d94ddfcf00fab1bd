"""The report of a rehearsal: lines of text, and the same data for ``run.json``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bridge.can.health import WRONG
from bridge.can.load import durations, measured_load
from bridge.can.log import FrameLog
from bridge.deployment.cut import Inlet
from bridge.deployment.system import System
from bridge.native.bus import BusState
from bridge.native.safety import LifeState
from bridge.realtime.lateness import Lateness, journal_lateness
from bridge.records.node_lives import Life, lives_of
from bridge.records.records import LifeEnd, Statement, reason_names, reason_text
from bridge.wiring.wiring import Rows
from cosim.base.units import time_text
from cosim.bus.timing import BusTiming
from cosim.measure.metric_result import summary_line


@dataclass(frozen=True, slots=True)
class NodeReport:
    """One life of a node: its lateness, its end, and its statement, if it wrote one."""

    life: Life
    slots: int
    lateness: Lateness
    state: str
    reasons: Sequence[str]  # names of bits of Why
    statement: Statement | None

    @property
    def end(self) -> LifeEnd:
        """The end of a life; without a statement it was killed."""
        return self.statement.end if self.statement else LifeEnd.KILLED

    @property
    def why(self) -> str:
        """The reasons for its stop in words, with the drives that stopped it; "": it did not."""
        return reason_text(self.reasons, self.statement.lost_drives if self.statement else ())

    def text(self) -> str:
        """Lateness and end."""
        late = self.lateness.late
        values = (late.p50, late.p99, late.p999, late.maximum)
        p50, p99, p999, most = (_ns(v) for v in values)
        end = "" if self.state in ("active", "finished") else f"; {self.state}: {self.why}"
        missed = f", {self.lateness.missed} missed" if self.lateness.missed else ""
        return (
            f"late by {p50} (median), {p99} (p99), {p999} (p99.9), {most} at most, "
            f"in {self.slots} slots{missed}{end}"
        )

    def parts(self) -> str:
        """The time of its slots, median and p99, and the period that was measured."""
        said = [
            f"{name} {_ns(part.p50)} (p99 {_ns(part.p99)})"
            for name, part in self.lateness.parts.items()
        ]
        period = self.lateness.period
        if period is not None:
            nominal = _ns(self.lateness.period_ns)
            said.append(
                f"period {_ns(period.mean, 5)} ({nominal} nominal, standard deviation "
                f"{_ns(period.std)})"
            )
        return ", ".join(said)


def _ns(value: float, digits: int = 3) -> str:
    return time_text(value * 1e-9, digits)


def node_reports(system: System, rows: Mapping[Life, Rows], nodes: Path) -> list[NodeReport]:
    """Return one report per life, in the order of the deployment. `rows`: (slots,) of each life."""
    found = []
    for name, plan in system.nodes.items():
        for life in lives_of(rows, name):
            r = rows[life]
            late = journal_lateness(r, round(plan.h * 1e9))
            found.append(
                NodeReport(
                    life,
                    len(r),
                    late,
                    LifeState(int(r["state"][-1])).name.lower(),
                    reason_names(int(r["reasons"][-1])),
                    Statement.read(nodes, life),
                )
            )
    return found


def firmware_lines(reports: Sequence[NodeReport]) -> list[str]:
    """Return a line for each life whose slots an image computed."""
    return [
        summary_line(
            "firmware", "{}: {image} on {machine}, SHA-256 {sha256}".format(r.life, **facts)
        )
        for r in reports
        if r.statement and (facts := r.statement.firmware)
    ]


# ---- ages -----------------------------------------------------------------------------------


def age_lines(system: System, rows: Mapping[Life, Rows]) -> list[str]:
    """Return lines with configured, real and total age of every signal that crosses a cut.

    `rows`: the rows (slots,) of each life.
    """
    return [
        summary_line("age", f"{age.text if age.received else 'nothing arrived'}  {age.signal}")
        for age in signal_ages(system, rows)
    ]


@dataclass(frozen=True, slots=True)
class SignalAge:
    """Ages of a signal that crosses a cut, ms; without a sample `received`, all are NaN.

    `configured`: mean delay that a node added, NaN: the signal has no link; `p50`, `p99`,
    `greatest`: of what the network took; `total`: mean of both and of the wait for the next step.
    """

    signal: str
    received: bool
    configured: float = nan
    p50: float = nan
    p99: float = nan
    greatest: float = nan
    total: float = nan

    @property
    def text(self) -> str:
        """In one line, without the signal."""
        link = self.configured == self.configured
        added = f"link {time_text(self.configured * 1e-3, 3)}, " if link else ""
        network = (time_text(x * 1e-3, 3) for x in (self.p50, self.p99, self.greatest))
        return (
            f"{time_text(self.total * 1e-3, 3)} on average when used: {added}network "
            "{} (median), {} (p99), {} at most".format(*network)
        )


def signal_ages(system: System, rows: Mapping[Life, Rows]) -> Iterator[SignalAge]:
    """Ages of every signal that crosses a cut; `rows`: the rows (slots,) of each life."""
    for name, plan in system.nodes.items():
        lives = lives_of(rows, name)
        for (source, target), at in _by_ports(plan.inlets).items() if lives else ():
            heard = np.concatenate([rows[life]["inlets"][:, at].ravel() for life in lives])
            heard = heard[heard["held"] >= 0]
            link = system.deployment.latency and plan.inlets[at[0]].link is not None
            messages = f" ({len(at)} messages)" if len(at) > 1 else ""
            yield _age(f"{source} -> {target}{messages}", heard, link)


def _by_ports(inlets: Sequence[Inlet]) -> dict[tuple[str, str], list[int]]:
    """Positions of inlets by the ports they come from and go to; a port may come in pieces."""
    found: dict[tuple[str, str], list[int]] = {}
    for i, inlet in enumerate(inlets):
        ports = [f"{slot.component}.{slot.port}" for slot in (inlet.source, inlet.target)]
        found.setdefault((ports[0], ports[1]), []).append(i)
    return {
        key if len(at) > 1 else (inlets[at[0]].source.name, inlets[at[0]].target.name): at
        for key, at in found.items()
    }


def _age(signal: str, heard: Rows, link: bool) -> SignalAge:
    """The ages of received samples (n,); `link`: with a configured delay."""
    if not len(heard):
        return SignalAge(signal, received=False)
    real, total = heard["transit_ns"] / 1e6, heard["age_ns"] / 1e6
    return SignalAge(
        signal, True, float((total - real).mean()) if link else nan, float(np.median(real)),
        float(np.percentile(real, 99)), float(real.max()), float(total.mean()),
    )  # fmt: skip


# ---- buses ----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class BusReport:
    """A CAN bus: its line of a summary, and its load over time.

    `load`: of windows of 0.1 s, (n,), 1 = always busy, from `start` on (s of the run). `frames`:
    when the frames of each message ended, (n,), s of the run, by the message's name.
    """

    text: str
    start: float
    load: NDArray[np.float64]
    frames: Mapping[str, NDArray[np.float64]]


def bus_reports(
    system: System, logs: Mapping[str, FrameLog], start_ns: int
) -> dict[str, BusReport]:
    """Frames and load of each CAN bus, from the bits of every frame that was logged.

    `start_ns`: time 0 of the run on the clock of the logs.
    """
    found = {}
    for name, log in logs.items():
        if not len(log.rows):
            continue
        bus = system.deployment.buses[name]
        timing = BusTiming(bus.bitrate, bus.data_bitrate if bus.fd else None)
        taken = durations(log.rows, timing)
        load = measured_load(log.rows["t_ns"], taken, window_ns=10**9)
        data_rate = timing.data_bitrate or timing.bitrate
        rate = f"{timing.bitrate / 1e6:g}" + (f"/{data_rate / 1e6:g}" if bus.fd else "")
        text = f"{len(log.rows)} frames, load {load.mean:.1%} (busiest second {load.peak:.1%}) of "
        begun = (int((log.rows["t_ns"] - taken).min()) - start_ns) * 1e-9
        parts = measured_load(log.rows["t_ns"], taken).windows
        frames = _frames(system, name, log.rows, start_ns)
        found[name] = BusReport(
            summary_line(f"bus {name}", f"{text}{rate} Mbit/s"), begun, parts, frames
        )
    return found


def _frames(
    system: System, bus: str, rows: NDArray[np.void], start_ns: int
) -> dict[str, NDArray[np.float64]]:
    """The times (s of the run) at which the frames of each message ended, by name or identifier."""
    named = {int(e.message.id): name for name, e in system.services[bus].named().items()}
    named |= {int(m.encoding.message.id): m.name for m in system.messages.values() if m.bus == bus}
    found: dict[str, NDArray[np.float64]] = {}
    for number in np.unique(rows["id"]).tolist():
        t = (rows["t_ns"][rows["id"] == number] - start_ns) * 1e-9
        name = named.get(number, f"0x{number:X}")
        found[name] = np.concatenate([found.get(name, np.empty(0)), t])
    return found


# ---- gateways -------------------------------------------------------------------------------


def forward_lines(reports: Sequence[NodeReport]) -> list[str]:
    """Lines on what each gateway passed on, and how long after it came."""
    return [
        summary_line("forwarded", f"{report.life}: {message}: {_forwarded(facts)}")
        for report in reports
        if report.statement
        for message, facts in report.statement.forwards.items()
    ]


def _forwarded(facts: Mapping[str, Any]) -> str:
    us = ", ".join(f"{name} {value:.0f}" for name, value in facts["transit_us"].items())
    said = [f"{facts['sent']} frames", *([f"{us} us after they came"] if us else [])]
    return ", ".join([*said, *([f"{facts['failed']} not sent"] if facts["failed"] else [])])


# ---- faults ---------------------------------------------------------------------------------


def fault_lines(reports: Sequence[NodeReport]) -> list[str]:
    """Lines on refusals of receivers and acts of guards, where there were any."""
    lines = []
    for report in reports:
        said = report.statement
        if said is None:
            continue
        for message, counts in said.messages.items():
            wrong = {k: v for k, v in counts.items() if v and k != "ok"}
            if wrong:
                text = ", ".join(f"{v} {k.replace('_', ' ')}" for k, v in wrong.items())
                lines.append(summary_line("received", f"{report.life}: {message}: {text}"))
        for message, counts in said.sent.items():
            if counts["saturated"]:
                text = f"{counts['saturated']} of {counts['frames']} with values that did not fit"
                lines.append(summary_line("sent", f"{report.life}: {message}: {text}"))
        for message, trips in said.guards.items():
            acted = {k: v for k, v in trips.items() if v}
            if acted:
                text = ", ".join(f"{k} in {v} ticks" for k, v in acted.items())
                lines.append(summary_line("guard", f"{report.life}: {message}: {text}"))
        for bus, health in said.buses.items():
            if text := _health(health):
                lines.append(summary_line("bus health", f"{report.life}: {bus}: {text}"))
        for count, what in ((said.journal_dropped, "slots"), (said.heard_dropped, "samples heard")):
            if count:
                lines.append(
                    summary_line("journal full", f"{report.life}: {count} {what} not recorded")
                )
        if said.drive_faults:
            lines.append(summary_line("drive", f"{report.life}: {said.drive_faults} faults"))
    return lines


def _health(health: Mapping[str, Any]) -> str:
    """The troubles of a bus in words; none: ""."""
    said = [f"{health[key]} {text}" for key, text in WRONG.items() if health.get(key)]
    state = int(health.get("state", 0))
    if state:
        said.insert(0, f"at the end {BusState(state).name.lower()}")
    return ", ".join(said)
