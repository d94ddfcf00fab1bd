"""Present state of a rehearsal: nodes, ages, buses, metrics and signals of the last second.

A snapshot is computed from files (:mod:`bridge.recording.live_run`). It changes nothing and does
not depend on earlier snapshots.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bridge.can.load import log_bits, log_times
from bridge.can.log import merge_node_logs
from bridge.deployment.carried import Carried
from bridge.deployment.cut import NodePlan
from bridge.deployment.system import System
from bridge.monitor.journal_signals import JournalSignals
from bridge.native.bus import Accept
from bridge.native.frame import Flags
from bridge.native.safety import LifeState
from bridge.realtime.lateness import Spread
from bridge.recording.live_run import LiveRun
from bridge.records.node_lives import Life
from bridge.safety.limits import explain, explain_guard
from cosim.bus.timing import BusTiming
from cosim.measure import declared_metrics
from cosim.measure.metrics import MetricResult, evaluate

Rows = NDArray[np.void]
#: s looked at, and s that the newest frames are left to arrive before they count as lost.
SPAN, SLACK = 1.0, 0.05
#: State of a life that has done no slot.
WAITING = "no slot yet"


@dataclass(frozen=True, slots=True)
class NodeView:
    """The newest life of a node; `late` (ns), `missed` and `guarded` refer to the span.

    `reasons`: why it has stopped; `now`: conditions that would stop it now. `quiet`: time since its
    last slot ended, s, NaN if the run is not active. `injected`: injected faults.
    """

    life: Life
    state: str
    reasons: str
    now: str
    slot: int
    t: float
    quiet: float
    late: Spread | None
    missed: int
    guarded: str
    injected: int


@dataclass(frozen=True, slots=True)
class InletView:
    """The samples of an input; `network`, `age`: (median, greatest), ms, NaN before the first
    sample.

    `lost`: frames sent but not received, of `sent` in the span.
    """

    source: str
    target: str
    network: tuple[float, float]
    age: tuple[float, float]
    lost: int
    sent: int


@dataclass(frozen=True, slots=True)
class BusView:
    """A bus: frames in the span, and the part of the time it was taken (NaN: no CAN bus)."""

    name: str
    frames: int
    load: float


@dataclass(frozen=True, slots=True)
class SignalView:
    """The newest values of an output."""

    name: str
    unit: str
    values: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Everything at `t`, s of the run `run`; `length`: of all of it. `metrics`: of the span."""

    run: str
    t: float
    length: float
    running: bool
    nodes: Sequence[NodeView]
    inlets: Sequence[InletView]
    buses: Sequence[BusView]
    metrics: Sequence[MetricResult]
    signals: Sequence[SignalView]
    unreadable: Mapping[str, str]


def snapshot(watched: LiveRun, now_ns: int) -> Snapshot:
    """The last second of a run. `now_ns`: monotonic."""
    watched.look()
    system = watched.system
    rows = watched.recent(SPAN)
    frames = {key: tail.since("t_ns", round(SPAN * 1.2e9)) for key, tail in watched.frames.items()}
    held = JournalSignals(system, rows, SPAN)
    losses = _losses(watched, frames)
    nodes = [_node(watched, n, rows.get(n), now_ns) for n in system.nodes]
    return Snapshot(
        run=watched.folder.resolve().name,
        t=max((n.t for n in nodes), default=0.0),
        length=system.plan.ticks * system.plan.h,
        running=watched.running,
        nodes=nodes,
        inlets=[
            _inlet(plan, i, rows.get(node), losses[plan.inlets[i].message, node])
            for node, plan in system.nodes.items()
            for i in range(len(plan.inlets))
        ],
        buses=[_bus(system, name, frames) for name in system.deployment.buses],
        metrics=evaluate(declared_metrics.metrics(system.scenario), held),
        signals=_signals(system, rows),
        unreadable=dict(watched.unreadable),
    )


# ---- nodes and their inputs -----------------------------------------------------------------


def _node(watched: LiveRun, node: str, rows: Rows | None, now_ns: int) -> NodeView:
    life = (watched.lives_of(node) or [Life(node)])[-1]
    if rows is None or life not in watched.lives or not len(watched.lives[life]):
        nan = float("nan")
        return NodeView(life, WAITING, "", "", -1, 0.0, nan, None, 0, "", 0)
    plan, last = watched.system.nodes[node], rows[-1]
    late = rows["woke_ns"] - rows["deadline_ns"]
    done = watched.facts.start_ns + int(last["done_ns"])
    guard = int(np.bitwise_or.reduce(rows["guard"]))
    faults = watched.injected.get(life)
    return NodeView(
        life=life,
        state=_state(int(last["state"])),
        reasons=explain(int(last["reasons"])) if last["reasons"] else "",
        now=explain(new) if (new := int(last["now"]) & ~int(last["reasons"])) else "",
        slot=int(last["slot"]),
        t=(int(last["slot"]) + 1) * plan.h,
        quiet=max(0, now_ns - done) * 1e-9 if watched.running else float("nan"),
        late=Spread.of(late, f"lateness of {life}"),
        missed=int(np.count_nonzero(late >= round(plan.h * 1e9))),
        guarded=explain_guard(guard) if guard else "",
        injected=len(faults) if faults is not None else 0,
    )


def _state(number: int) -> str:
    return (
        LifeState(number).name.lower() if number in LifeState.__members__.values() else f"{number}?"
    )


def _inlet(plan: NodePlan, index: int, rows: Rows | None, lost: tuple[int, int]) -> InletView:
    inlet = plan.inlets[index]
    network = age = (float("nan"), float("nan"))
    if rows is not None:
        found = rows["inlets"][:, index]
        heard = found[found["held"] >= 0]
        if len(heard):
            network, age = _spread(heard["transit_ns"]), _spread(heard["age_ns"])
    return InletView(inlet.source.name, inlet.target.name, network, age, *lost)


def _spread(ns: NDArray[np.int64]) -> tuple[float, float]:
    return float(np.median(ns)) * 1e-6, float(ns.max()) * 1e-6


def _losses(
    watched: LiveRun, frames: Mapping[tuple[Life, str], Rows]
) -> dict[tuple[str, str], tuple[int, int]]:
    """(frames not received, frames sent) by (message, receiving node)."""
    return {
        (message, node): _lost(watched, node, watched.system.messages[message], frames)
        for node in watched.system.nodes
        for message in watched.system.received_by(node)
    }


def _lost(
    watched: LiveRun, node: str, carried: Carried, frames: Mapping[tuple[Life, str], Rows]
) -> tuple[int, int]:
    """Frames of a message that its sender logged and the receiver did not, of how many."""
    senders, receivers = watched.lives_of(carried.node), watched.lives_of(node)
    if not senders or not receivers:
        return 0, 0
    out = frames.get((senders[-1], carried.bus))
    into = frames.get((receivers[-1], carried.bus))
    if out is None or into is None or not len(out) or not len(into):
        return 0, 0
    accept = Accept.of(carried.encoding.message)
    end = min(int(out["t_ns"][-1]), int(into["t_ns"][-1])) - round(SLACK * 1e9)
    due = accept.among(out) & (out["t_ns"] <= end) & (out["t_ns"] > end - round(SPAN * 1e9))
    due &= (out["t_ns"] > into["t_ns"][0]) & (out["flags"] & Flags.SENT != 0)
    sent = out[due]
    heard = into[accept.among(into) & (into["flags"] & Flags.SENT == 0)]
    width = int(sent["length"].max(initial=0))  # beyond it there is anything
    there = set(_payloads(heard, width))
    return sum(data not in there for data in _payloads(sent, width)), len(sent)


def _payloads(rows: Rows, width: int) -> list[bytes]:
    raw = np.ascontiguousarray(rows["data"][:, :width]).tobytes()
    return [raw[i : i + width] for i in range(0, len(raw), width)] if width else []


# ---- buses and signals ----------------------------------------------------------------------


def _bus(system: System, name: str, frames: Mapping[tuple[Life, str], Rows]) -> BusView:
    parts = [r for (_, bus), r in frames.items() if bus == name and len(r)]
    if not parts:
        return BusView(name, 0, float("nan"))
    end = max(int(p["t_ns"][-1]) for p in parts)
    parts = [p[p["t_ns"] > end - round(SPAN * 1e9)] for p in parts]
    rows = merge_node_logs(parts)
    spec = system.deployment.buses[name]
    if spec.kind != "can":
        return BusView(name, len(rows), float("nan"))
    bits = log_bits(rows["id"], rows["flags"], rows["length"], rows["data"])
    timing = BusTiming(spec.bitrate, spec.data_bitrate if spec.fd else None)
    return BusView(name, len(rows), float(log_times(bits, timing).sum()) * 1e-9 / SPAN)


def _signals(system: System, rows: Mapping[str, Rows]) -> list[SignalView]:
    return [
        SignalView(
            slot.name,
            ", ".join(dict.fromkeys(slot.units or (slot.unit,))),
            tuple(rows[node]["signals"][-1][slot.start : slot.start + slot.size].tolist()),
        )
        for node, plan in system.nodes.items()
        if node in rows
        for step in plan.plan.components
        for slot in step.outputs
    ]
