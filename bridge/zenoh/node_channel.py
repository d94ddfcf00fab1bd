"""A node's end of a Zenoh bus: publications, subscriptions and required peers."""

from __future__ import annotations

from collections.abc import Mapping

from bridge.deployment.gateways import gateways
from bridge.deployment.system import System
from bridge.deployment.zenoh_keys import names_of
from bridge.native.journal import Journal
from bridge.zenoh.access import access_control
from bridge.zenoh.channel import ZenohAttachment, ZenohTraffic
from bridge.zenoh.options import options_of


def traffic_of(system: System, bus: str, node: str) -> ZenohTraffic:
    """Keys and numbers of one node on one bus."""
    names, d = names_of(system.deployment, bus), system.deployment
    peers = tuple(p for p in d.nodes if p != node and bus in system.buses_of(p))
    keys = {
        m.name: names.message(m.node, m.outlet.component, m.name)
        for m in system.messages.values()
        if m.bus == bus
    }
    number = {name: system.messages[name].encoding.message.id for name in keys}
    own = [name for name in keys if system.messages[name].node == node]
    heard = [name for name in system.received_by(node) if name in keys]
    elsewhere = {name for p in peers for name in system.received_by(p)}
    publishes = {keys[name]: number[name] for name in own}
    hears = {keys[name]: number[name] for name in heard}
    service = system.services[bus]
    for other in (node, *peers):
        beat = service.heartbeats.get(d.nodes[other].number)
        if beat is not None:
            mine = publishes if other == node else hears
            mine[names.of(other, "heartbeat")] = beat.message.id
    for what, encoding in (("estop", service.estop), ("epoch", service.epoch)):
        if encoding is not None:
            publishes[names.shared(what)] = hears[names.shared(what)] = encoding.message.id
    if service.nmt is not None:
        hears[names.shared("nmt")] = service.nmt.message.id
        if system.nodes[node].forwards:
            publishes[names.shared("nmt")] = service.nmt.message.id
    awaited = tuple(keys[name] for name in own if name in elsewhere)
    steady = {keys[n]: system.messages[n].period_ns * 1e-9 for n in heard if _first(system, n)}
    beats = {p: d.seconds(d.nodes[p].heartbeat, "nodes", p, "heartbeat") for p in peers}
    beaten = {names.of(p, "heartbeat"): period for p, period in beats.items() if period > 0}
    steady |= {key: period for key, period in beaten.items() if key in hears}
    longest = max(steady.values(), default=0.0)
    return ZenohTraffic(node, publishes, hears, peers, awaited, tuple(steady), longest)


def _first(system: System, message: str) -> bool:
    """True if its sender makes it; a gateway is silent where what it forwards is."""
    return system.messages[message].forward is None


def rules_of(system: System, bus: str) -> Mapping[str, object]:
    """Permissions of every session on a bus to publish, if its file enables rules."""
    nodes = [n for n in system.deployment.nodes if bus in system.buses_of(n)]
    names = names_of(system.deployment, bus)
    return access_control(names, nodes, gateways=gateways(system.deployment))


def open_bus(
    system: System, bus: str, node: str, *, number: int = 0, log: Journal | None = None
) -> ZenohAttachment:
    """Open a node's session on a Zenoh bus. Raises ScenarioError, BusError."""
    return ZenohAttachment(
        bus,
        names_of(system.deployment, bus),
        traffic_of(system, bus, node),
        options_of(system.deployment, bus, node),
        number=number,
        log=log,
        access=rules_of(system, bus),
    )
