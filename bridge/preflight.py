"""A deployment before it runs: what :mod:`bridge.check` finds on its buses."""

from __future__ import annotations

from dataclasses import replace

from bridge.can import dbc
from bridge.can.codec import Codec
from bridge.can.layout import find
from bridge.can.messages import BusMessage
from bridge.can.timing import BusTiming
from bridge.check import Watchdog, check_buses
from bridge.native.message import Profile
from bridge.protect import emulated
from bridge.safety import in_si
from bridge.system import System
from cosim.check.finding import Finding


def timings(system: System) -> dict[str, BusTiming]:
    """Bit rates of the CAN buses."""
    return {
        name: BusTiming(b.bitrate, b.data_bitrate if b.fd else None, b.fd)
        for name, b in system.deployment.buses.items()
        if b.kind == "can"
    }


def messages(system: System) -> list[BusMessage]:
    """Everything that is sent on CAN buses: the deployment's messages, heartbeats, SYNC, NMT."""
    found: list[BusMessage] = []
    d = system.deployment
    for bus in timings(system):
        layouts = dbc.load(d.file(d.buses[bus].dbc)) if d.buses[bus].dbc else ()
        there = {layout.name for layout in layouts}
        for name, m in system.messages.items():
            if m.bus == bus:
                assert isinstance(m.encoding, Codec)
                layout = replace(m.encoding.layout, name=name)
                found.append(BusMessage.of(layout, node=m.node, bus=bus, period=m.period_ns * 1e-9))
        for node, spec in d.nodes.items():
            if bus not in system.buses_of(node):
                continue
            beat = f"HEARTBEAT_{spec.number}"
            period = d.seconds(spec.heartbeat, "nodes", node, "heartbeat")
            if beat in there and period > 0:
                layout = find(layouts, beat)
                found.append(
                    BusMessage.of(layout, node=node, bus=bus, period=period, role="heartbeat")
                )
            if d.sync == node and "SYNC" in there:
                h = system.sync_ticks * system.plan.h
                layout = find(layouts, "SYNC")
                found.append(BusMessage.of(layout, node=node, bus=bus, period=h, role="sync"))
    return found


def watchdogs(system: System) -> list[Watchdog]:
    """Who stops without what: emulated drives, and inputs with a `stop`."""
    d = system.deployment
    found: list[Watchdog] = []
    for name, plan in system.nodes.items():
        spec = d.nodes[name]
        for inlet in plan.inlets:
            if spec.drive is not None and inlet.target.port == spec.drive.port:
                place = d.place("nodes", name, "drive")
                timeout = in_si(emulated(spec.drive, d).watchdog, "s", place)
                found.append(Watchdog(f"drive of {name}", inlet.message, timeout))
            stale = spec.stale.get(f"{inlet.component}.{inlet.target.port}")
            if stale is not None and stale.stop:
                timeout = d.seconds(stale.stop, "nodes", name, "stale")
                found.append(Watchdog(f"{inlet.target.name} of {name}", inlet.message, timeout))
    return found


def overruns(system: System) -> list[Finding]:
    """Nodes that may be later than a turn of a counter: their samples would be numbered wrongly."""
    d = system.deployment
    found: list[Finding] = []
    for name, m in system.messages.items():
        profile = Profile(m.encoding.message.e2e)
        turn = (1 << profile.counter_bits) * m.period_ns * 1e-9
        overrun = d.seconds(d.nodes[m.node].overrun, "nodes", m.node, "overrun")
        if profile is Profile.NONE or 0 < overrun < turn:
            continue
        reason = f"may be {overrun * 1e3:g} ms late, and the counter of {name} turns in"
        found.append(
            Finding(
                rule="overrun",
                severity="warning",
                where=m.node,
                number=overrun,
                unit="s",
                reason=f"{reason} {turn * 1e3:g} ms: samples could be numbered wrongly",
                advice=f'overrun = "{turn * 750:.3g} ms"',
            )
        )
    return found


def check(system: System) -> list[Finding]:
    """Findings: of the buses, then of the nodes."""
    found = check_buses(messages(system), timings(system), watchdogs(system))
    return [*found, *overruns(system)]
