"""Everything that a deployment defines for one of its nodes, as plain data.

It is read from the structs with which the node itself runs, so both agree.
"""

from __future__ import annotations

import ctypes as c
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from bridge.deployment.carried import Carried
from bridge.deployment.services import Encoding
from bridge.deployment.system import System
from bridge.deployment.zenoh_keys import Names, names_of
from bridge.native import message as messages
from bridge.native import node as native
from bridge.native.frame import Flags
from bridge.wiring.wiring import WiredNode
from cosim.base.copies import asdict
from cosim.base.errors import ScenarioError


@dataclass(frozen=True, slots=True)
class FieldEntry:
    """A field of a message, as in a DBC file; `low`, `high`: raw values."""

    start: int
    bits: int
    motorola: bool
    kind: str
    scale: float
    offset: float
    low: float
    high: float
    invalid: int | None


@dataclass(frozen=True, slots=True)
class LayoutEntry:
    """The bytes of a message. `id`: of CAN; on Zenoh a number inside the program. `key`: of Zenoh.

    `data_id`: hexadecimal, 16 bytes, little endian (P02: one for each counter).
    """

    id: int
    key: str | None
    fd: bool
    brs: bool
    extended: bool
    bytes: int
    profile: str
    data_id: str
    fields: tuple[FieldEntry, ...]
    status: FieldEntry | None
    time: FieldEntry | None
    fill: str


@dataclass(frozen=True, slots=True)
class ReceivedEntry:
    """A message that the node receives; times in ns, 0: none. `values`: names with units."""

    name: str
    bus: str
    sender: str
    layout: LayoutEntry
    values: tuple[str, ...]
    period_ns: int
    offset_ns: int
    max_age_ns: int
    stop_ns: int
    watchdog_ns: int
    torque: bool
    awaited: bool
    limits: tuple[tuple[float, float, float, bool], ...]


@dataclass(frozen=True, slots=True)
class SentEntry:
    """A message that the node sends, every `every` slots. `torque`: the first guarded value and the
    number of these; `tau_max`: of them; `start`: the first values.
    """

    name: str
    bus: str
    layout: LayoutEntry
    values: tuple[str, ...]
    every: int
    torque: tuple[int, int]
    tau_max: tuple[float, ...]
    start: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class NeighbourEntry:
    """Another node, and its heartbeat on a bus; `takes`: its drives take torques of the node."""

    name: str
    number: int
    bus: str
    heartbeat: LayoutEntry
    required: bool
    takes: bool
    within_ns: int


@dataclass(frozen=True, slots=True)
class BusEntry:
    """A bus with its services by name (heartbeat, nmt, estop, epoch, sync)."""

    name: str
    kind: str
    prefix: str | None
    services: Mapping[str, LayoutEntry]


@dataclass(frozen=True, slots=True)
class NodeTable:
    """A node of a deployment; times in ns."""

    node: str
    number: int
    h_ns: int
    phase_ns: int
    slots: int
    heartbeat_slots: int
    sync_slots: int
    ramp_slots: int
    overrun_ns: int
    patience_ns: int
    buses: tuple[BusEntry, ...]
    received: tuple[ReceivedEntry, ...]
    sent: tuple[SentEntry, ...]
    neighbours: tuple[NeighbourEntry, ...]

    def bus_number(self, name: str) -> int:
        """The position of a bus in `buses`."""
        return [bus.name for bus in self.buses].index(name)


def as_json(table: NodeTable) -> str:
    """The table as JSON; a number that is not finite is null."""
    return json.dumps(_finite(asdict(table)), indent=1) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _finite(x) for name, x in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(x) for x in value]
    return None if isinstance(value, float) and not isfinite(value) else value


def node_table(system: System, name: str) -> NodeTable:
    """The table of a node. Raises ScenarioError for a node that no participant can replace."""
    _check(system, name)
    with (
        TemporaryDirectory(prefix="participant-") as folder,
        WiredNode(system, name, {}, Path(folder) / "node.journal", native.REPLAY) as wired,
    ):
        return _table(system, wired)


def _check(system: System, name: str) -> None:
    d = system.deployment
    if name not in d.nodes:
        found = ", ".join(d.nodes)
        raise ScenarioError(f"found no node {name!r}, expected one of {found}", str(d.path))
    place = d.place("nodes", name)
    if system.nodes[name].forwards or not system.nodes[name].plan.components:
        raise ScenarioError("found a gateway, expected a node with components", place)
    if not system.buses_of(name):
        raise ScenarioError(
            "found a node without a bus, expected one that sends or receives", place
        )
    mine = [m for m in system.messages.values() if m.node == name]
    heard = [system.messages[m] for m in system.received_by(name)]
    drives = sorted(m.name for m in (*mine, *heard) if d.messages[m.name].profile)
    if drives:
        raise ScenarioError(
            f"found {drives[0]}, a message of a drive with its own protocol; expected a node "
            "without such drives",
            place,
        )


def _table(system: System, wired: WiredNode) -> NodeTable:
    s, name = wired.struct, wired.name
    names = {
        bus: names_of(system.deployment, bus)
        for bus in system.buses_of(name)
        if system.deployment.buses[bus].kind == "zenoh"
    }
    return NodeTable(
        node=name,
        number=int(s.number),
        h_ns=int(s.h_ns),
        phase_ns=int(s.phase_ns),
        slots=int(s.slots),
        heartbeat_slots=int(s.heartbeat_slots),
        sync_slots=int(s.sync_slots),
        ramp_slots=int(s.life.ramp_ticks),
        overrun_ns=int(s.overrun_ns),
        patience_ns=int(s.patience_ns),
        buses=tuple(_bus(system, bus, wired, names) for bus in system.buses_of(name)),
        received=tuple(
            _received(system, wired, system.messages[m], names) for m in system.received_by(name)
        ),
        sent=tuple(_sent(system, wired, i, names) for i in range(len(wired.plan.outlets))),
        neighbours=tuple(_neighbours(system, wired, names)),
    )


def _key(encoding: Encoding, names: Names | None) -> str | None:
    """The key of a message on Zenoh; its layout has it as its name."""
    layout = getattr(encoding, "layout", None)
    return None if names is None or layout is None else str(layout.name)


def _bus(system: System, bus: str, wired: WiredNode, names: Mapping[str, Names]) -> BusEntry:
    service, spec = system.services[bus], system.deployment.buses[bus]
    found: dict[str, Encoding | None] = {
        "heartbeat": service.heartbeats.get(wired.spec.number),
        "nmt": service.nmt,
        "estop": service.estop,
        "epoch": service.epoch,
        "sync": service.sync,
    }
    return BusEntry(
        bus,
        spec.kind,
        names[bus].prefix if bus in names else None,
        {what: _layout(one, names.get(bus)) for what, one in found.items() if one is not None},
    )


def _received(
    system: System, wired: WiredNode, carried: Carried, names: Mapping[str, Names]
) -> ReceivedEntry:
    r = wired.inlet_bindings.receptions[carried.name]
    inlets = [
        entry
        for entry, inlet in zip(wired.inlet_bindings.inlets, wired.plan.inlets, strict=False)
        if inlet.message == carried.name
    ]
    stops = [int(x.stop_ns) for x in inlets if x.stop_ns > 0]
    drives = [x.drive.contents for x in inlets if x.drive]
    watchdogs = [int(x.watchdog.timeout_ns) for x in drives if x.watchdog.timeout_ns > 0]
    limits = [r.limits[i] for i in range(r.width)] if r.limits else []
    return ReceivedEntry(
        name=carried.name,
        bus=carried.bus,
        sender=carried.node,
        layout=_layout(carried.encoding, names.get(carried.bus)),
        values=_values(carried.outlet.parts),
        period_ns=int(r.period_ns),
        offset_ns=int(r.offset_ns),
        max_age_ns=int(r.max_age_ns),
        stop_ns=min(stops, default=0),
        watchdog_ns=min(watchdogs, default=0),
        torque=len(drives) > 0,
        awaited=bool(r.awaited),
        limits=tuple((x.low, x.high, x.rate, bool(x.falls)) for x in limits),
    )


def _sent(system: System, wired: WiredNode, i: int, names: Mapping[str, Names]) -> SentEntry:
    outlet, entry = wired.plan.outlets[i], wired.outlet_bindings.outlets[i]
    guard = entry.guard.contents if entry.guard else None
    most = guard.tau_max if guard is not None else None
    count = int(entry.joints) if guard is not None else 0
    first = int(entry.guarded) if guard is not None else 0
    start = np.concatenate(
        [wired.engine.signals[p.start : p.start + p.size] for p in outlet.parts]
    ).tolist()
    start[first : first + count] = [0.0] * count
    carried = system.messages[outlet.message]
    return SentEntry(
        name=outlet.message,
        bus=outlet.bus,
        layout=_layout(carried.encoding, names.get(outlet.bus)),
        values=_values(outlet.parts),
        every=int(entry.every * entry.hit_ticks),
        torque=(first, count),
        tau_max=_doubles(most, count),
        start=tuple(start),
    )


def _doubles(pointer: Any, count: int) -> tuple[float, ...]:
    """Numbers behind a pointer of C, or of its address; none where it is NULL."""
    address = pointer if isinstance(pointer, int) else c.cast(pointer, c.c_void_p).value
    return tuple((c.c_double * count).from_address(address)) if address else ()


def _values(parts: Sequence[Any]) -> tuple[str, ...]:
    return tuple(
        f"{name} [{part.unit_of(i)}]" if part.unit_of(i) else name
        for part in parts
        for i, name in enumerate(part.scalars())
    )


def _neighbours(
    system: System, wired: WiredNode, names: Mapping[str, Names]
) -> list[NeighbourEntry]:
    found = []
    for other, peer in wired.peers.items():
        number = system.deployment.nodes[other].number
        buses = [b for b in system.buses_of(wired.name) if b in system.buses_of(other)]
        bus = next(b for b in buses if number in system.services[b].heartbeats)
        beat = _layout(system.services[bus].heartbeats[number], names.get(bus))
        found.append(
            NeighbourEntry(
                other, number, bus, beat, bool(peer.required), bool(peer.takes),
                int(peer.heartbeat.timeout_ns),
            )
        )  # fmt: skip
    return found


def _layout(encoding: Encoding, names: Names | None) -> LayoutEntry:
    m = encoding.message
    header = [m.header[i] for i in range(max(m.status, m.time) + 1)]
    return LayoutEntry(
        id=int(m.id),
        key=_key(encoding, names),
        fd=bool(m.flags & Flags.FD),
        brs=bool(m.flags & Flags.BRS),
        extended=bool(m.flags & Flags.EXTENDED),
        bytes=int(m.length),
        profile=messages.E2EProfile(m.e2e).name,
        data_id=bytes(m.data_ids).hex(),
        fields=tuple(_field(m.fields[i]) for i in range(m.n_fields)),
        status=_field(header[m.status]) if m.status >= 0 else None,
        time=_field(header[m.time]) if m.time >= 0 else None,
        fill=bytes(m.fill).hex() if any(m.fill) else "",
    )


def _field(f: messages.Field) -> FieldEntry:
    kind = messages.FieldKind(f.kind)
    limits: list[float] = [f.low, f.high]
    if kind is messages.FieldKind.FLOAT:
        limits = np.array([f.low, f.high], np.int64).view(np.float64).tolist()
    return FieldEntry(
        start=int(f.start),
        bits=int(f.length),
        motorola=bool(f.motorola),
        kind=kind.name.lower(),
        scale=float(f.scale),
        offset=float(f.offset),
        low=limits[0],
        high=limits[1],
        invalid=int(f.invalid) if f.has_invalid else None,
    )
