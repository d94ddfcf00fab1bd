"""Lateness that no fault was meant to cause: of this machine, or of a bus between nodes on time.

A verdict on problems of time is inconclusive while such a cause is there.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bridge.deployment.system import System
from bridge.native.frame import Flags
from bridge.native.journal import Journal
from bridge.node.buses import SIMULATED
from bridge.records.node_lives import frame_files
from bridge.records.records import Lagged
from bridge.results.rehearsal_outcome import RehearsalOutcome
from bridge.results.report import NodeReport
from cosim.record.folder import NODES

#: Faults that make a node late on purpose, and s for which that may last beyond them.
LATE_FAULTS, AFTER = ("freeze", "clock-jump", "restart", "kill"), 1.0
#: s; where a deployment has no time limit of its own.
LIMIT = 0.1
#: Share of the slots of a node, and slots, that the machine has missed where it is overloaded.
BUSY, FEW = 0.02, 10
Times = NDArray[np.int64]
Seconds = NDArray[np.float64]


def limit(system: System) -> float:
    """The shortest lateness that stops a node of the deployment, s."""
    d = system.deployment
    found = [
        d.seconds(spec.overrun, "nodes", name, "overrun")
        for name, spec in d.nodes.items()
        if spec.components
    ]
    return min((x for x in found if x > 0), default=LIMIT)


def cause(system: System, outcome: RehearsalOutcome) -> str:
    """A sentence on what was late without a fault that is meant to cause it; "": nothing was."""
    late = unplanned_lateness(outcome)
    if late >= limit(system) / 2:
        return f"this machine let a node wait for {late * 1e3:.0f} ms"
    if lags := bus_lags(system, outcome, limit(system) / 2):
        return lags[0].describe()
    for report in outcome.reports:
        missed = missed_slots(system, outcome, report)
        if missed.sum() >= max(FEW, BUSY * len(missed)):
            return (
                f"this machine is overloaded: {report.life} missed {missed.sum()} of its "
                f"{len(missed)} slots"
            )
    return next(_late_buses(system, outcome), "")


def lagging(system: System, outcome: RehearsalOutcome) -> str:
    """A sentence on the simulated bus that was as late as stops a node; "": none was.

    Then the run was not that of the deployment, whatever came of it.
    """
    return next((lag.describe() for lag in bus_lags(system, outcome, limit(system))), "")


def bus_lags(system: System, outcome: RehearsalOutcome, least: float) -> list[Lagged]:
    """Times in which a simulated bus was `least` s or more behind the wall clock, longest first.

    They are those that were noted, and, of a bus without, the time from the first to the last slot
    of a node that held a sample which took so long on the bus.
    """
    found = [n for n in outcome.notes if isinstance(n, Lagged) and n.late >= least]
    d = system.deployment
    noted = {lag.bus for lag in found}
    for bus, spec in d.buses.items() if d.clock == "wall" else ():
        if spec.kind == "can" and spec.interface == SIMULATED and bus not in noted:
            t, took = _held(system, outcome, bus)
            if len(at := np.flatnonzero(took >= least)):
                first, last = float(t[at].min()), float(t[at].max())
                found.append(Lagged(t=first, bus=bus, end=last, late=float(took[at].max())))
    return sorted(found, key=lambda lag: -lag.late)


def _held(system: System, outcome: RehearsalOutcome, bus: str) -> tuple[Seconds, Seconds]:
    """The slots (n,) in which nodes held samples from a bus, and the time that these took, (n,), s.

    Without those during and after faults, which may delay what others send.
    """
    slots, times = [np.zeros(0)], [np.zeros(0)]
    for report in outcome.reports:
        rows, plan = outcome.rows[report.life], system.nodes[report.life.node]
        t = rows["deadline_ns"] * 1e-9
        for k, inlet in enumerate(plan.inlets):
            if system.messages[inlet.message].bus == bus:
                held = rows["inlets"][:, k]
                meant = held["held"] < 0
                for fault in outcome.faults:
                    meant |= (t >= fault.t0) & (t <= fault.t1 + AFTER)
                slots.append(t)
                times.append(np.where(meant, 0, held["transit_ns"]) * 1e-9)
    return np.concatenate(slots), np.concatenate(times)


def missed_slots(
    system: System, outcome: RehearsalOutcome, report: NodeReport
) -> NDArray[np.bool_]:
    """True if each slot (slots,) of a life was missed without a fault that makes it late."""
    found: NDArray[np.bool_] = (
        lateness(outcome, report) >= system.nodes[report.life.node].plan.h * 1e9
    )
    return found


def unplanned_lateness(outcome: RehearsalOutcome) -> float:
    """The greatest lateness of a slot without a fault that is meant to cause it, s."""
    late = (lateness(outcome, report).max(initial=0) for report in outcome.reports)
    return max(map(float, late), default=0.0) * 1e-9


def lateness(outcome: RehearsalOutcome, report: NodeReport) -> Times:
    """Lateness (slots,) of a life, ns; 0 where a fault is meant to cause it."""
    rows = outcome.rows[report.life]
    t = rows["deadline_ns"] * 1e-9
    meant = np.zeros(len(rows), bool)
    for fault in outcome.faults:
        if fault.kind in LATE_FAULTS and report.life.node in fault.targets:
            meant |= (t >= fault.t0 - AFTER) & (t <= fault.t1 + AFTER)
    return np.where(meant, 0, rows["woke_ns"] - rows["deadline_ns"])


# ---- buses ----------------------------------------------------------------------------------


def _late_buses(system: System, outcome: RehearsalOutcome) -> Iterator[str]:
    """A sentence for each CAN bus that took half of the time limit, or longer, for a frame."""
    if system.deployment.clock != "wall":
        return  # there a bus takes what it takes, on any machine
    allowed = _allowed(system)
    start_ns = max((r.statement.start_ns for r in outcome.reports if r.statement), default=0)
    for bus, spec in system.deployment.buses.items():
        if spec.kind != "can":
            continue
        arrived, took = transits(outcome.folder / NODES, bus)
        t = (arrived - start_ns) * 1e-9
        for fault in outcome.faults:  # whatever its kind: it may delay what others send
            took = np.where((t >= fault.t0) & (t <= fault.t1 + AFTER), 0, took)
        longest = took.max(initial=0) * 1e-9
        if longest >= allowed / 2:
            share = float(np.mean(took >= allowed / 2 * 1e9))
            yield (
                f"bus {bus} delivered frames up to {longest * 1e3:.0f} ms late ({share:.1%} more "
                f"than {allowed / 2 * 1e3:.0f} ms) while its nodes were on time"
            )


def _allowed(system: System) -> float:
    """The shortest time without an input that stops a node, s; at most the limit of lateness."""
    d = system.deployment
    stops = [
        d.seconds(stale.stop, "nodes", name, "stale", signal)
        for name, spec in d.nodes.items()
        for signal, stale in spec.stale.items()
        if stale.stop is not None
    ]
    return min([limit(system), *(x for x in stops if x > 0)])


def transits(nodes: Path, bus: str) -> tuple[Times, Times]:
    """Arrival (n,) of each frame between two nodes of a bus, and the time that it took (n,), ns.

    A received frame is the last one that was sent before with the same bytes, so of equal frames
    the shortest time is taken.
    """
    logs = [Journal.open(path) for path in frame_files(nodes, bus).values()]
    sent = [log[log["flags"] & Flags.SENT != 0] for log in logs]
    found: list[tuple[Times, Times]] = []
    for log in logs:
        heard = log[log["flags"] & Flags.SENT == 0]
        found.append(_transits(np.concatenate(sent), heard))
    if not found:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    arrived, took = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return arrived, took


def _transits(sent: NDArray[np.void], heard: NDArray[np.void]) -> tuple[Times, Times]:
    """The transit times of the frames of one listener."""
    both = np.concatenate([sent, heard])
    if not len(sent) or not len(heard):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    size = both["data"].shape[1]
    content = np.zeros(len(both), [("id", "<u4"), ("length", "<u2"), ("data", "u1", (size,))])
    for name in ("id", "length", "data"):
        content[name] = both[name]
    raw = content.view(f"V{content.dtype.itemsize}").ravel()
    _, kind = np.unique(raw, return_inverse=True)
    arrives = np.arange(len(both)) >= len(sent)
    order = np.lexsort((arrives, both["t_ns"], kind))
    t, kind, arrives = both["t_ns"][order].astype(np.int64), kind[order], arrives[order]
    last = np.maximum.accumulate(np.where(arrives, -1, np.arange(len(t))))
    good = arrives & (last >= 0)
    good[good] &= kind[last[good]] == kind[good]
    return t[good], t[good] - t[last[good]]
