"""Controllers run on the frames of a bus log; their torques are compared with the sent ones.

No journal is needed, so it works for any run with hardware with a bus log. Each controller's node
runs unchanged (receivers, delay lines, guard, codec, life cycle) in slots at the times of its own
frames, and receives the frames that had arrived according to the log. Data that the log lacks can
cause differences: a state from before its first frame, a command that came over no bus, an arrival
in another order than in the log.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from bridge.can.log import frame_of
from bridge.deployment.system import System
from bridge.native import node as native
from bridge.native.bus import Accept, Bus, BusKind
from bridge.native.frame import Ring
from bridge.native.safety import LifeState
from bridge.replay import bus_log
from bridge.replay.bus_log import LoggedSample
from bridge.replay.received_and_sent import History
from bridge.wiring.wiring import WiredNode
from cosim.base.errors import ScenarioError

#: Slots done between two fillings of the rings, and the frames that fit into one.
CHUNK, RING = 64, 1 << 14
Buses = Mapping[str, NDArray[np.void]]


@dataclass(frozen=True, slots=True)
class SentDifference:
    """A value of a controller's messages: computed here, against sent; `t`: of the largest, s.

    `differ`: of how many frames; `first`: the first slot in which it differs, -1: none.
    """

    name: str
    unit: str
    rms: float
    largest: float
    t: float
    differ: int
    first: int


@dataclass(frozen=True, slots=True)
class ControllerReplay:
    """One controller's node: slots run, frames compared, and what they differ in.

    `first`: the slot it began in; `unheard`: slots of which the log has no frame; `stopping`:
    frames that were not compared, their node being in another state than active.
    """

    node: str
    first: int
    slots: int
    compared: int
    unheard: int
    stopping: int
    values: tuple[SentDifference, ...]

    @property
    def exact(self) -> bool:
        """True if every frame is what was sent."""
        return self.compared > 0 and all(v.differ == 0 for v in self.values)


@dataclass(frozen=True, slots=True)
class LogReplay:
    """The replays of the controllers in a log; `start_ns`: t = 0 on the log's clock."""

    start_ns: int
    nodes: tuple[ControllerReplay, ...]
    remarks: tuple[str, ...]

    @property
    def exact(self) -> bool:
        """True if every controller sent what it computes here."""
        return bool(self.nodes) and all(n.exact for n in self.nodes)


def replay_log(
    system: System, logs: Path | Sequence[Path], start_ns: int | None = None
) -> LogReplay:
    """Run every controller's node on a log (candump text, .blf, .asc, .mf4; one or one per bus).

    A node is a controller's if all its components are sampled. `start_ns`: t = 0 on the log's
    clock, if the frames do not contain it. Raises ScenarioError if the log has no frame of a
    controller, or is of other buses; LogError for a file that is not a log.
    """
    paths = [logs] if isinstance(logs, Path) else list(logs)
    buses = bus_log.read_buses(system, paths)
    heard = {
        name: [*bus_log.samples(m, buses[m.bus], system.deployment.buses[m.bus])]
        for name, m in system.messages.items()
        if m.bus in buses
    }
    start = bus_log.start_of(system, heard) if start_ns is None else start_ns
    remarks = [f"{b}: not logged" for b in system.deployment.buses if b not in buses]
    found = []
    for name, node in system.nodes.items():
        sent = [o.message for o in node.outlets if heard.get(o.message)]
        if not sent or any(step.kind != "sampled" for step in node.plan.components):
            continue
        found.append(_follow(system, name, buses, {m: heard[m] for m in sent}, start))
        if found[-1].first > 0:
            text = f"{name}: begins in slot {found[-1].first}; what it knew then is not in the log"
            remarks.append(text)
    if not found:
        controllers = [n for n, p in system.nodes.items() if p.outlets]
        text = f"no frame of a controller; expected messages of {', '.join(controllers)}"
        raise ScenarioError(text, ", ".join(map(str, paths)))
    return LogReplay(start, tuple(found), tuple(remarks))


# ---- one node -----------------------------------------------------------------------------------


def _follow(
    system: System,
    name: str,
    buses: Buses,
    sent: Mapping[str, Sequence[LoggedSample]],
    start: int,
) -> ControllerReplay:
    own = {message: _numbered(system, message, frames, start) for message, frames in sent.items()}
    limits, first, known = _limits(system, name, own, start)
    with TemporaryDirectory() as scratch:
        rings = {b: Ring(RING) for b in system.buses_of(name)}
        ports = {
            b: Bus.from_rings(ring, Ring(64), i, kind=BusKind.MEMORY)
            for i, (b, ring) in enumerate(rings.items())
        }
        wired = WiredNode(system, name, ports, Path(scratch) / "node.journal", native.SIMULATED)
        with wired:
            made = _begin(wired, first)
            _run(wired, rings, _arrivals(system, name, buses, start), limits)
    active = (LifeState.ACTIVE, -1)
    kept = {
        m: {j: s for j, s in frames.items() if s.life in active and j < made[m].there.size}
        for m, frames in own.items()
    }
    values = [v for m in own for v in _values(system, m, kept[m], made[m])]
    compared = sum(map(len, kept.values()))
    stopping = sum(map(len, own.values())) - compared
    unheard = len(limits) - known
    return ControllerReplay(name, first, len(limits), compared, unheard, stopping, tuple(values))


def _numbered(
    system: System, message: str, frames: Sequence[LoggedSample], start: int
) -> dict[int, LoggedSample]:
    """Frames of the run by sequence number; the first of two alike."""
    carried = system.messages[message]
    found: dict[int, LoggedSample] = {}
    for sample in frames:
        number = bus_log.sequence(carried, sample, start)
        if sample.running and sample.t_ns >= start and number >= 0:
            found.setdefault(number, sample)
    return found


def _limits(
    system: System, name: str, own: Mapping[str, Mapping[int, LoggedSample]], start: int
) -> tuple[NDArray[np.int64], int, int]:
    """(until when each slot heard, ns; the first slot; how many have a frame that tells)."""
    node = system.nodes[name]
    h_ns, phase = round(node.h * 1e9), 0
    told: dict[int, int] = {}
    for message, frames in own.items():
        carried = system.messages[message]
        phase = carried.offset_ns
        for number, sample in frames.items():
            slot = number * carried.outlet.ticks // node.ticks
            t = bus_log.sent_ns(carried, sample, start)
            told[slot] = min(told.get(slot, t), t)
    if not told:
        raise ScenarioError(f"no frame of {name} from t = 0 on")
    first, last = min(told), max(told)
    slots = np.arange(first, last + 1, dtype=np.int64)
    limits = slots * h_ns + phase
    for slot, t in told.items():
        deadline = int(limits[slot - first])
        if deadline <= t < deadline + h_ns:  # later: done with what there was at the deadline
            limits[slot - first] = t
    return np.maximum.accumulate(limits), first, len(told)


def _begin(wired: WiredNode, first: int) -> dict[str, History]:
    """Make the node active in its first slot; its frames are recorded."""
    s = wired.struct
    s.slot = s.first = first
    s.life.state, s.life.armed = LifeState.ACTIVE, 1
    for i in range(s.n_inlets):
        wired.inlet_bindings.inlets[i].heard_ns = first * s.h_ns
    for peer in wired.peers.values():
        peer.state, peer.heartbeat.last_ns = -1, (first + 1) * s.h_ns
    made = {}
    for i, outlet in enumerate(wired.plan.outlets):
        capacity = wired.plan.slots * wired.plan.ticks // outlet.ticks + 8
        made[outlet.message] = History(outlet.width, capacity)
        wired.outlet_bindings.outlets[i].history = c.pointer(made[outlet.message].struct)
    native.functions().node_enable(c.byref(s), first * s.h_ns)
    return made


def _arrivals(
    system: System, name: str, buses: Buses, start: int
) -> dict[str, tuple[NDArray[np.void], NDArray[np.int64]]]:
    """(rows, times since `start`) of what a node hears, by bus: all but its own frames."""
    number = system.deployment.nodes[name].number
    found = {}
    for bus in system.buses_of(name):
        rows = buses.get(bus)
        if rows is None:
            continue
        sent = [m for m in system.messages.values() if m.node == name and m.bus == bus]
        own = [m.encoding.message for m in sent]
        beat = system.services[bus].heartbeats.get(number)
        own += [] if beat is None else [beat.message]
        for message in own:
            rows = rows[~Accept.of(message).among(rows)]
        found[bus] = rows, rows["t_ns"].astype(np.int64) - start
    return found


def _run(
    wired: WiredNode,
    rings: Mapping[str, Ring],
    arrivals: Mapping[str, tuple[NDArray[np.void], NDArray[np.int64]]],
    limits: NDArray[np.int64],
) -> None:
    """All slots, frames handed over shortly before they are heard."""
    done = dict.fromkeys(arrivals, 0)
    follow = native.functions().node_follow
    for begin in range(0, len(limits), CHUNK):
        part = np.ascontiguousarray(limits[begin : begin + CHUNK])
        for bus, (rows, times) in arrivals.items():
            end = int(np.searchsorted(times, part[-1], side="right"))
            for i in range(done[bus], end):
                frame = frame_of(rows[i])
                frame.t_ns = int(times[i])
                rings[bus].put(frame)
            done[bus] = end
        result = follow(c.byref(wired.struct), part.ctypes.data, len(part))
        if result:
            raise wired.engine.failure(result)


def _values(
    system: System, message: str, sent: Mapping[int, LoggedSample], made: History
) -> list[SentDifference]:
    """Each value of a message, computed against sent."""
    carried = system.messages[message]
    numbers = [j for j in sorted(sent) if made.there[j] == native.THERE]
    names = [
        (name, part.unit_of(i))
        for part in carried.outlet.parts
        for i, name in enumerate(part.scalars())
    ]
    if not numbers:
        return []
    logged_ = np.array([sent[j].values for j in numbers])
    d = np.abs(made.values[numbers] - logged_)
    found = []
    node = system.nodes[carried.node]
    for k, (name, unit) in enumerate(names):
        worst, other = int(np.argmax(d[:, k])), np.flatnonzero(d[:, k])
        slots = [j * carried.outlet.ticks // node.ticks for j in numbers]
        found.append(
            SentDifference(
                name, unit, float(np.sqrt(np.mean(d[:, k] ** 2))), float(d[worst, k]),
                slots[worst] * node.h, int(other.size), slots[int(other[0])] if other.size else -1,
            )
        )  # fmt: skip
    return found
