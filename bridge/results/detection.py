"""Comparison of every fault of a script with the evidence in the report of the run.

A fault is *seen* if the report has a symptom of it (:data:`SIGNS`), *unseen* if it has none, and
*idle* if there was nothing to act on: no frame arrived while the fault was active, other faults had
removed all frames, or there was no receiver.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from bridge.can.codec import Codec
from bridge.deployment.carried import Subscription
from bridge.deployment.system import System
from bridge.faults.script import (
    HOSTILE,
    KINDS,
    OF_BUSES,
    OF_LINKS,
    FaultEvent,
    FaultScript,
    FrameFault,
)
from bridge.native.message import COUNTERS
from bridge.records.node_lives import Life
from bridge.records.records import Done, Missed, Refused
from bridge.rehearsal.babbler import accept
from bridge.results.detection_drives import drive_evidence
from bridge.results.detection_links import RecordedNetwork, link_evidence
from bridge.results.findings import Evidence, Place, Sign, Signs
from bridge.results.symptoms import SIGNS, FinishedRun
from bridge.results.undetected import frames_of_run
from bridge.wiring.wiring import Rows
from cosim.base.copies import replace


def find(
    script: FaultScript, shown: FinishedRun, network: RecordedNetwork | None = None
) -> list[Evidence]:
    """The evidence in the report for each table of a script, in their order."""
    system = shown.system
    end = system.plan.ticks * system.plan.h
    found = []
    records = [
        received(life, record, system)
        for node in system.nodes
        for life in shown.lives(node)
        if (record := shown.record(life)) is not None and shown.statement(life) is not None
    ]
    for fault in script.frames:
        places = list(_of_frames(fault, script.frames, shown, records))
        found.append(
            Evidence(
                index=fault.index,
                kind=fault.kind,
                targets=fault.nodes,
                messages=fault.messages,
                t0=fault.t0,
                t1=min(fault.t1, end),
                places=places,
            )
        )
    tables: dict[int, list[FaultEvent]] = {}
    d = system.deployment
    for event in script.process_events(list(d.nodes), list(d.buses)):
        tables.setdefault(event.index, []).append(event)
    for index, events in tables.items():
        found.append(
            Evidence(
                index=index,
                kind=_kind(events),
                targets=sorted({e.target for e in events}),
                t0=events[0].t,
                t1=min(events[-1].t, end),
                places=list(_of_events(events, shown, network)),
            )
        )
    found += drive_evidence(script, shown)
    return sorted(found, key=lambda e: e.index)


# ---- faults of frames -----------------------------------------------------------------------


@final
@dataclass(frozen=True, slots=True)
class Received:
    """Faults of frames as a life received them: `record` (INJECTED), and by bus and name of
    what it listens to and counts, which rows, (rows,), are frames of it.
    """

    life: Life
    subscriptions: Sequence[Subscription]
    record: Rows
    frames: Mapping[tuple[str, str], NDArray[np.bool_]]

    def hit(self, fault: FrameFault) -> dict[str, NDArray[np.bool_]]:
        """Rows of each message that a fault is about, by name."""
        found: dict[str, NDArray[np.bool_]] = {}
        for one in fault.about(self.subscriptions):
            rows = self.frames.get((one.bus, one.name))
            if rows is not None and (one.name == "SYNC") == (fault.kind == "sync-loss"):
                found[one.name] = rows | found.get(one.name, False)
        return found


def received(life: Life, record: Rows, system: System) -> Received:
    """Return the record (n,) of one life (INJECTED), by its subscriptions and counters."""
    listened, buses = system.subscriptions(life.node), system.buses_of(life.node)
    counted = {"SYNC", *system.received_by(life.node)}
    frames = {}
    for one in listened:
        if one.name not in counted:
            continue
        rows = (record["bus"] == buses.index(one.bus)) & one.accept.among(record)
        if one.name in system.messages:
            encoding = system.messages[one.name].encoding
            assert isinstance(encoding, Codec)
            rows[rows] = frames_of_run(record[rows], encoding)
        frames[one.bus, one.name] = rows
    return Received(life, listened, record, frames)


def _of_frames(
    fault: FrameFault, every: Sequence[FrameFault], shown: FinishedRun, records: Sequence[Received]
) -> Iterator[Place]:
    """A place each life and message. A life that did not live to tell cannot show anything.

    Faults of one message that show in the same counters have to show all together.
    """
    for received in records:
        life, record = received.life, received.record
        if "*" not in fault.nodes and life.node not in fault.nodes:
            continue
        span = shown.span(life, fault.t0, fault.t1 + fault.b)
        for name, there in received.hit(fault).items():
            rows = _effective(record[there], fault)
            if fault.kind == "delay" and not shown.arrives(life, name, *span):
                rows = rows[:0]  # a gateway, and no node behind it ran that would show the age
            alike = [f for f in every if _counted_as(fault, f, life.node)]
            alike = [
                f for f in alike if name in {one.name for one in f.about(received.subscriptions)}
            ]
            total = max(sum(len(_effective(record[there], f)) for f in alike), len(rows))
            signs = _frame_signs(fault, shown, life, name, rows, total, span)
            yield Place(target=str(life), message=name, done=len(rows), signs=signs)


def _counted_as(fault: FrameFault, other: FrameFault, node: str) -> bool:
    """True if another fault at this node has its symptoms in the same counters only."""
    signs = set(SIGNS[other.kind])
    there = "*" in other.nodes or node in other.nodes
    return there and signs <= set(COUNTERS) and signs == set(SIGNS[fault.kind])


def _effective(record: Rows, fault: FrameFault) -> Rows:
    """Frames a fault did something to that no other fault has hidden."""
    kind = KINDS[fault.kind]
    t = record["t_ns"] * 1e-9
    rows = record[(t >= fault.t0) & (t < fault.t1)]
    rows = rows[rows["kinds"] >> kind & 1 == 1]
    gone, changed = rows["copies"] == 0, rows["crc"] != rows["crc_after"]
    wanted = gone
    if fault.kind not in ("drop", "burst", "sync-loss"):
        wanted = ~gone & (changed if fault.kind in ("corrupt", "absurd") else ~changed)
    found: Rows = rows[wanted]
    return found


def _frame_signs(
    fault: FrameFault,
    shown: FinishedRun,
    life: Life,
    message: str,
    rows: Rows,
    total: int,
    span: tuple[float, float],
) -> Signs:
    """Signs of a fault in one message: `rows` of the record it did something to, of `total` that
    have to show; `span`: when it held, on the clock of the run, s.
    """
    if not len(rows):
        return ()
    signs = SIGNS[fault.kind]
    if "syncs" in signs:
        said = shown.statement(life)
        lost = said.syncs.get("lost", 0) if said else 0
        return (Sign(what="syncs", number=lost),) if lost else ()
    if fault.kind in HOSTILE:
        return _hostile_signs(signs, shown, life, message)
    counters = [name for name in signs if name in COUNTERS]
    found = shown.counter_signs(life, message, counters, total) if counters else ()
    if "age" in signs:
        least = float((rows["through_ns"] - rows["t_ns"]).min()) * 1e-9
        found = (*found, *shown.age(life, message, *span, least))
    if "silence" in signs:  # what was sent behind it came with it: it was never the newest
        held = shown.span(life, rows["t_ns"][-1] * 1e-9, rows["through_ns"][-1] * 1e-9)
        found = (*found, *shown.silence(life, message, *held))
    return found


def _hostile_signs(signs: Sequence[str], shown: FinishedRun, life: Life, message: str) -> Signs:
    """One sign is enough: a frame that is refused may be refused for another's sake."""
    counters = [name for name in signs if name in COUNTERS]
    found = shown.counter_signs(life, message, counters, 1) if counters else ()
    if "surplus" in signs:
        found = (*found, *shown.extra_frames(life, message))
    return (*found, *shown.altered_samples(life, message)) if "altered" in signs else found


# ---- faults of processes, buses and networks ------------------------------------------------


def _kind(events: Sequence[FaultEvent]) -> str:
    """The kind of the table that these events are of."""
    if any(e.action == "start" for e in events):
        return "restart"
    return events[0].action


def _of_events(
    events: Sequence[FaultEvent], shown: FinishedRun, network: RecordedNetwork | None
) -> Iterator[Place]:
    """A place each target whose beginning the run has noted, unless its node, or for a bus the run,
    was over by then.
    """
    first, last = events[0], events[-1]
    end = shown.system.plan.ticks * shown.system.plan.h
    done = {
        (n.action, n.target): n.t
        for n in shown.notes
        if isinstance(n, Done) and n.index in (first.index, -1)
    }
    for target in sorted({e.target for e in events}):
        begun = done.get((first.action, target))
        if begun is None or (target in shown.system.nodes and shown.over(target, begun)):
            continue
        if first.action in OF_BUSES and begun >= end:
            continue
        actual = replace(first, t=begun)  # when it was done, which a busy machine does later
        over = done.get((last.action, target), last.t)
        if first.action in OF_LINKS and network is not None:
            yield from link_evidence(actual, over, shown, network)
            continue
        look = _EVENT_SIGNS.get(_kind(events))
        signs = look(shown, target, actual, over) if look else ()
        yield Place(target=target, done=1, signs=signs)


def _restarted(shown: FinishedRun, node: str, first: FaultEvent, t1: float) -> Signs:
    h = shown.system.nodes[node].h
    later = [life for life in shown.lives(node) if shown.rows[life]["slot"][0] * h > first.t]
    if later:
        return (Sign(what="life", life=later[0]),)
    if shown.by_image(node):
        return shown.ended(node, first.t, t1)
    stayed = (n for n in shown.notes if isinstance(n, Missed | Refused) and n.life.node == node)
    return tuple(Sign(what="refusal", life=n.life, note=n) for n in stayed)[:1]


def _killed(shown: FinishedRun, node: str, first: FaultEvent, t1: float) -> Signs:
    return shown.ended(node, first.t, t1)


def _stopped(shown: FinishedRun, node: str, first: FaultEvent, t1: float) -> Signs:
    return shown.late(node, first.t, t1) or shown.ended(node, first.t, t1)


def _jumped(shown: FinishedRun, node: str, first: FaultEvent, t1: float) -> Signs:
    """A clock set forward makes its node late; one set back silences it for the others."""
    by = abs(first.by)
    found = shown.late(node, first.t, first.t + by) or shown.stopped(node, first.t)
    silent = (
        sign
        for message, carried in shown.system.messages.items()
        if carried.node == node
        for other in shown.system.nodes
        if message in shown.system.received_by(other)
        for life in shown.alive(other, first.t, first.t + by)
        for sign in shown.silence(life, message, first.t, first.t + by)
    )
    return found or tuple(silent)[:1]


def _health(shown: FinishedRun, bus: str, first: FaultEvent, t1: float) -> Signs:
    """Errors of the bus; where it was down several times, a life that had it back as often."""
    downs = sum(
        isinstance(n, Done) and (n.action, n.target) == (first.action, bus) for n in shown.notes
    )
    for report in shown.reports:
        health = report.statement.buses.get(bus, {}) if report.statement else {}
        failed = any(health.get(k) for k in ("peers_left", "error_frames", "send_failed"))
        if health.get("restarts", 0) >= downs or (failed and downs == 1):
            return (Sign(what="health", life=report.life),)
    return ()


def _frames(shown: FinishedRun, bus: str, first: FaultEvent, t1: float) -> Signs:
    """Frames in the logs of the bus that have the peer's identifier and that no node has sent."""
    found = shown.foreign_frames(bus, accept(first))
    return (Sign(what="frames", number=found),) if found else ()


_EVENT_SIGNS: Mapping[str, Callable[[FinishedRun, str, FaultEvent, float], Signs]] = {
    "kill": _killed,
    "restart": _restarted,
    "freeze": _stopped,
    "noise": _killed,
    "clock-jump": _jumped,
    "bus-down": _health,
    "babble": _frames,
}
