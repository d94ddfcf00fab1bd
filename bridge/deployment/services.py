"""Services of a bus: messages of nodes in addition to those of the deployment.

The services are NMT (commands), SYNC, ESTOP (emergency stop of all nodes), EPOCH (the run and its
t = 0) and heartbeats. A CAN bus has those that its deployment lists, as the messages NMT, SYNC,
ESTOP, EPOCH and HEARTBEAT_n of its DBC file (default: all of the file). A bus with the frames of
drives with their own protocol has none; a Zenoh bus has all except SYNC.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from bridge.can.codec import Codec
from bridge.can.layout import MessageLayout, find
from bridge.deployment import zenoh_keys
from bridge.deployment.spec import SERVICES, Deployment, ServiceName
from bridge.drives.profile_files import load_profile
from bridge.drives.profiles import DriveProfile
from bridge.native.epoch import SIGNALS as EPOCH_SIGNALS
from bridge.native.message import Message
from cosim.base.errors import ScenarioError
from cosim.base.names import signal_of

#: Heartbeats of a host in the time-out of the drive that waits for them.
BEATS = 4


class Encoding(Protocol):
    """The coder of a message: a :class:`bridge.can.codec.Codec`, or one of Zenoh."""

    @property
    def message(self) -> Message:
        """The C struct, alive as long as this."""


@dataclass(frozen=True, slots=True)
class Service:
    """Messages of a bus in addition to those of the deployment: heartbeats, SYNC, NMT, ESTOP,
    EPOCH.

    A missing service does not exist on this bus: no node sends or obeys it there. Heartbeats are by
    node number. `host_heartbeats` by node number and `host_sync` are messages that the drives of a
    profile require on their bus from the nodes that command them (CANopen); `timeout`: of the
    shortest watchdog that depends on them, s.
    """

    heartbeats: Mapping[int, Encoding] = field(default_factory=dict)
    sync: Encoding | None = None
    nmt: Encoding | None = None
    estop: Encoding | None = None
    epoch: Encoding | None = None
    host_heartbeats: Mapping[int, Encoding] = field(default_factory=dict)
    host_sync: Encoding | None = None
    timeout: float = 0.0

    def named(self) -> dict[str, Encoding]:
        """All there are, by the name that messages of a DBC file have."""
        shared = {"SYNC": self.sync, "NMT": self.nmt, "ESTOP": self.estop, "EPOCH": self.epoch}
        found = {name: encoding for name, encoding in shared.items() if encoding is not None}
        return found | {f"HEARTBEAT_{n}": beat for n, beat in self.heartbeats.items()}


def services_on(d: Deployment, bus: str, layouts: Sequence[MessageLayout]) -> Service:
    """The services of a bus; `layouts`: of its DBC file. Raises ScenarioError."""
    if d.buses[bus].kind == "can":
        return _in_file(d, bus, layouts)
    if d.buses[bus].services is not None:
        text = "is of CAN buses; a Zenoh bus has all services but SYNC"
        raise ScenarioError(text, d.place("buses", bus, "services"))
    return _streamed(d, bus)


def drives_on(d: Deployment, bus: str) -> tuple[str, ...]:
    """Messages on a bus to and from drives with their own protocols."""
    return tuple(name for name, m in d.messages.items() if m.bus == bus and m.profile)


def commanding_nodes(d: Deployment, bus: str) -> dict[str, DriveProfile]:
    """Nodes that send torques to drives of a profile on a bus, with the profile."""
    homes = {component: name for name, node in d.nodes.items() for component in node.components}
    found = {}
    for name in drives_on(d, bus):
        m = d.messages[name]
        ports = {signal_of(signal.partition(".")[2]) for signal in m.carries}
        home = homes.get(m.carries[0].partition(".")[0]) if m.carries else None
        if "tau" in ports and home is not None:
            found[home] = load_profile(d.file(m.profile))
    return found


def _of_drives(d: Deployment, bus: str) -> Service:
    """Services that the drives on a bus require from the nodes that command them."""
    hosts = commanding_nodes(d, bus)
    numbers = {node: d.nodes[node].number for node in hosts}
    beats = {numbers[node]: p.host_heartbeat(numbers[node]) for node, p in hosts.items()}
    syncs = [sync for p in hosts.values() if (sync := p.host_sync()) is not None]
    return Service(
        host_heartbeats={n: beat for n, beat in beats.items() if beat is not None},
        host_sync=syncs[0] if syncs else None,
        timeout=min((p.timeout for p in hosts.values() if p.host.heartbeat), default=0.0),
    )


def _selected_services(d: Deployment, bus: str) -> tuple[ServiceName, ...]:
    """Services of a CAN bus: those listed, else all, but none on a bus with frames of drives."""
    said, drives = d.buses[bus].services, drives_on(d, bus)
    if said and drives:
        text = f"{', '.join(said)} on a bus with a drive's own frames ({drives[0]})"
        place = d.place("buses", bus, "services")
        raise ScenarioError(f"{text}; expected none: drives interpret them differently", place)
    if said is None:
        return () if drives else SERVICES
    return said


def _in_file(d: Deployment, bus: str, layouts: Sequence[MessageLayout]) -> Service:
    """The selected services of a CAN bus, with the messages of its DBC file."""
    if not _selected_services(d, bus):
        return _of_drives(d, bus)
    there, wanted = {layout.name for layout in layouts}, _selected_services(d, bus)

    def codec(service: ServiceName, name: str, *signals: str) -> Encoding | None:
        if service not in wanted:
            return None
        if name not in there and d.buses[bus].services is not None:
            text = f"no message {name} in {d.buses[bus].dbc or 'a DBC file'} for {service}"
            raise ScenarioError(text, d.place("buses", bus, "services"))
        return Codec(find(layouts, name), signals) if name in there else None

    beats = {
        spec.number: codec(
            "heartbeat", f"HEARTBEAT_{spec.number}", "state", "reasons", "boots", "armed"
        )
        for spec in d.nodes.values()
    }
    return Service(
        heartbeats={number: beat for number, beat in beats.items() if beat is not None},
        sync=codec("sync", "SYNC", "counter"),
        nmt=codec("nmt", "NMT", "command", "node"),
        estop=codec("estop", "ESTOP", "node", "reasons"),
        epoch=codec("epoch", "EPOCH", *EPOCH_SIGNALS),
    )


def _streamed(d: Deployment, bus: str) -> Service:
    """The services of a Zenoh bus: it has no SYNC."""
    keys = zenoh_keys.names_of(d, bus)
    beats = {spec.number: zenoh_keys.heartbeat(keys, node, spec) for node, spec in d.nodes.items()}
    return Service(
        beats, None, zenoh_keys.nmt(keys), zenoh_keys.estop(keys), zenoh_keys.epoch(keys)
    )
