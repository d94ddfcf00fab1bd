"""Every fault of a script, held against what the report of the run shows of it.

A fault is *seen* where the report has a sign of it (:data:`SIGNS`), *unseen* where it has none,
and *idle* where there was nothing to act on: no frame came while it held, or none that another
fault had left, or nobody was there to receive.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from typing import Any, Literal

from bridge.evidence_links import Network, of_links
from bridge.fault_script import EXTENDED, KINDS, OF_LINKS, Event, FaultScript, FrameFault
from bridge.rehearse import MISSED, REFUSES
from bridge.signs import COUNTERS, SIGNS, Place, Shown
from bridge.system import System
from bridge.wiring import Rows


@dataclass(frozen=True, slots=True)
class Evidence:
    """One table of a script: how often it did something (`done`), and what the report shows."""

    index: int
    kind: str
    where: str
    t0: float
    t1: float
    done: int
    shown: tuple[str, ...]
    missing: tuple[str, ...]

    @property
    def verdict(self) -> Literal["seen", "unseen", "idle"]:
        """See the module."""
        if self.missing:
            return "unseen"
        return "seen" if self.shown else "idle"

    def text(self) -> str:
        """One line of a report."""
        when = f"{self.t0:.2f} s" + (f" to {self.t1:.2f} s" if self.t1 > self.t0 else "")
        said = "; ".join(dict.fromkeys((*self.shown, *self.missing))) or "nothing to act on"
        return f"{self.kind} {self.where}, {when}, {self.done} x: {said}"

    def facts(self) -> dict[str, Any]:
        """For ``run.json``."""
        return {**asdict(self), "verdict": self.verdict}


def find(script: FaultScript, shown: Shown, network: Network | None = None) -> list[Evidence]:
    """What the report shows of each table of a script, in their order."""
    system = shown.system
    end = system.plan.ticks * system.plan.h
    found = []
    for fault in script.frames:
        places = list(_of_frames(fault, shown))
        where = f"of {_list(fault.messages)} at {_list(fault.nodes)}"
        found.append(_judged(fault.index, fault.kind, where, fault.t0, min(fault.t1, end), places))
    tables: dict[int, list[Event]] = {}
    d = system.deployment
    for event in script.process_events(list(d.nodes), list(d.buses)):
        tables.setdefault(event.index, []).append(event)
    for index, events in tables.items():
        kind, places = _kind(events), list(_of_events(events, shown, network))
        where = "on " + ", ".join(sorted({e.target for e in events}))
        t0, t1 = events[0].t, min(events[-1].t, end)
        found.append(_judged(index, kind, where, t0, t1, places))
    return sorted(found, key=lambda e: e.index)


def _list(names: Sequence[str | int]) -> str:
    return ", ".join(n if isinstance(n, str) else f"{n:#x}" for n in names)


def _judged(
    index: int, kind: str, where: str, t0: float, t1: float, places: Sequence[Place]
) -> Evidence:
    told = [p for p in places if p.done]
    return Evidence(
        index, kind, where, t0, t1, sum(p.done for p in told),
        tuple(f"{p.name}: {p.sign}" for p in told if p.sign),
        tuple(f"{p.name}: NOT SEEN" for p in told if not p.sign),
    )  # fmt: skip


# ---- faults of frames -----------------------------------------------------------------------


def _of_frames(fault: FrameFault, shown: Shown) -> Iterator[Place]:
    """A place each life and message. A life that did not live to tell cannot show anything."""
    for node in shown.system.nodes:
        if "*" not in fault.nodes and node not in fault.nodes:
            continue
        for life in shown.lives(node):
            record = shown.record(life)
            if record is None or not shown.said(life):
                continue
            for name, number in _heard(fault, shown.system, node):
                rows = _effective(record, fault, number)
                yield Place(
                    f"{life} {name}", len(rows), _frame_sign(fault, shown, life, name, rows)
                )


def _heard(fault: FrameFault, system: System, node: str) -> Iterator[tuple[str, int]]:
    """Messages a fault is about, as far as a receiver counts them."""
    counted = ("SYNC",) if fault.kind == "sync-loss" else system.heard_by(node)
    for name, number in system.identifiers(node).items():
        named = (
            fnmatchcase(name, m) if isinstance(m, str) else m == number for m in fault.messages
        )
        if name in counted and any(named):
            yield name, number & ~EXTENDED


def _effective(record: Rows, fault: FrameFault, number: int) -> Rows:
    """Frames a fault did something to that no other fault has hidden."""
    kind = KINDS[fault.kind]
    t = record["t_ns"] * 1e-9
    rows = record[(record["id"] == number) & (t >= fault.t0) & (t < fault.t1)]
    rows = rows[rows["kinds"] >> kind & 1 == 1]
    gone, changed = rows["copies"] == 0, rows["crc"] != rows["crc_after"]
    wanted = gone
    if fault.kind not in ("drop", "burst", "sync-loss"):
        wanted = ~gone & (changed if fault.kind == "corrupt" else ~changed)
    found: Rows = rows[wanted]
    return found


def _frame_sign(fault: FrameFault, shown: Shown, life: str, message: str, rows: Rows) -> str:
    if not len(rows):
        return ""
    signs = SIGNS[fault.kind]
    if "syncs" in signs:
        lost = shown.said(life).get("syncs", {}).get("lost", 0)
        return f"{lost} SYNC lost" if lost else ""
    counters = [name for name in signs if name in COUNTERS]
    said = [shown.counted(life, message, counters, len(rows))] if counters else []
    if "age" in signs:
        least = float((rows["through_ns"] - rows["t_ns"]).min()) * 1e-9
        said.append(shown.age(life, message, fault.t0, fault.t1 + fault.b, least))
    return ", ".join(s for s in said if s)


# ---- faults of processes, buses and networks ------------------------------------------------


def _kind(events: Sequence[Event]) -> str:
    """The kind of the table that these events are of."""
    if any(e.action == "start" for e in events):
        return "restart"
    return events[0].action


def _of_events(events: Sequence[Event], shown: Shown, network: Network | None) -> Iterator[Place]:
    """A place each target whose beginning the run has noted."""
    first, last = events[0], events[-1]
    for target in sorted({e.target for e in events}):
        if not any(note.endswith(f": {first.action} {target}") for note in shown.notes):
            continue
        if first.action in OF_LINKS and network is not None:
            yield from of_links(first, last.t, shown, network)
            continue
        sign = _EVENT_SIGNS.get(_kind(events))
        yield Place(target, 1, sign(shown, target, first.t, last.t) if sign else "")


def _restarted(shown: Shown, node: str, t0: float, t1: float) -> str:
    h = shown.system.nodes[node].h
    rows = {life: shown.rows[life] for life in shown.lives(node)}
    later = [life for life, r in rows.items() if len(r) and r["slot"][0] * h > t0]
    if later:
        return f"{later[0]} began"
    told = (n for n in shown.notes if f": node {node}." in n and (REFUSES in n or MISSED in n))
    return next(told, "").partition(": node ")[2]


def _stopped(shown: Shown, node: str, t0: float, t1: float) -> str:
    return shown.late(node, t0, t1) or shown.ended(node, t0, t1)


def _jumped(shown: Shown, node: str, t0: float, t1: float) -> str:
    return next((r.reasons or r.text() for r in shown.reports if r.life == node), "")


def _health(shown: Shown, bus: str, t0: float, t1: float) -> str:
    for report in shown.reports:
        health = report.said.get("buses", {}).get(bus, {})
        if health.get("restarts") or health.get("error_frames") or health.get("send_failed"):
            return f"{report.life}: the bus was not well"
    return ""


def _frames(shown: Shown, bus: str, t0: float, t1: float) -> str:
    unknown = sum(r.said.get("unknown_frames", 0) for r in shown.reports)
    return f"{unknown} frames of nobody's" if unknown else ""


_EVENT_SIGNS: Mapping[str, Callable[[Shown, str, float, float], str]] = {
    "kill": lambda shown, node, t0, t1: shown.ended(node, t0, t1),
    "restart": _restarted,
    "freeze": _stopped,
    "clock-jump": _jumped,
    "bus-down": _health,
    "babble": _frames,
}
