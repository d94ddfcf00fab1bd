"""A deployment before it runs: what :mod:`bridge.preflight.bus_checks` finds on its buses."""

from __future__ import annotations

from collections.abc import Iterator

from bridge.can.codec import Codec
from bridge.can.messages import BusMessage, Role
from bridge.deployment import ranges
from bridge.deployment.drive_sequences import commanded_drives
from bridge.deployment.protection import emulated
from bridge.deployment.services import BEATS, commanding_nodes
from bridge.deployment.system import System
from bridge.native.message import STAMP_TURNS, E2EProfile, counter_bits
from bridge.preflight.bus_checks import MessageTimeout, check_buses
from bridge.preflight.feeding import feeding, slow_states
from bridge.preflight.identifiers import collisions
from bridge.safety.limits import limits, to_si
from cosim.base.copies import replace
from cosim.bus.timing import BusTiming
from cosim.checks import Finding
from cosim.checks.wiring import unconnected_inputs

#: s; what comes later over a network than this is nothing a controller wants.
LATE = 10.0
#: Parameter of a controller: the greatest torque that it may ask for.
LIMIT = "tau_max"


def timings(system: System) -> dict[str, BusTiming]:
    """Bit rates of the CAN buses."""
    return {name: bus.timing for name, bus in system.deployment.buses.items() if bus.kind == "can"}


def messages(system: System) -> list[BusMessage]:
    """Everything periodic on CAN buses: SYNC, the deployment's messages, heartbeats.

    Those of a node are in the order in which it sends them.
    """
    found: list[BusMessage] = []
    d = system.deployment
    for bus in timings(system):
        service = system.services[bus]
        if d.sync and bus in system.buses_of(d.sync) and isinstance(service.sync, Codec):
            h, layout = system.sync_ticks * system.plan.h, service.sync.layout
            found.append(BusMessage.of(layout, node=d.sync, bus=bus, period=h, role="sync"))
        for name, m in system.messages.items():
            if m.bus == bus:
                assert isinstance(m.encoding, Codec)
                layout = replace(m.encoding.layout, name=name)
                role: Role = "drive" if d.messages[name].profile else "data"
                period = m.period_ns * 1e-9
                found.append(BusMessage.of(layout, node=m.node, bus=bus, period=period, role=role))
        for node, spec in d.nodes.items():
            if bus not in system.buses_of(node):
                continue
            beat = service.heartbeats.get(spec.number)
            period = d.seconds(spec.heartbeat, "nodes", node, "heartbeat")
            if isinstance(beat, Codec) and period > 0:
                found.append(
                    BusMessage.of(beat.layout, node=node, bus=bus, period=period, role="heartbeat")
                )
        found += _of_hosts(system, bus)
        found += _of_drives(system, bus)
    return [replace(m, queue=d.buses[m.bus].queue_kind) for m in found]


def _of_hosts(system: System, bus: str) -> Iterator[BusMessage]:
    """Messages, other than commands, that drives receive from the nodes that command them."""
    service, nodes = system.services[bus], system.deployment.nodes
    for node in commanding_nodes(system.deployment, bus):
        beat, sync = service.host_heartbeats.get(nodes[node].number), service.host_sync
        if isinstance(beat, Codec):
            layout = replace(beat.layout, name=f"{beat.layout.name}_{nodes[node].number}")
            period = service.timeout / BEATS
            yield BusMessage.of(layout, node=node, bus=bus, period=period, role="heartbeat")
        if isinstance(sync, Codec):
            sent = [m.period_ns for m in system.messages.values() if (m.node, m.bus) == (node, bus)]
            period = min(sent) * 1e-9
            yield BusMessage.of(sync.layout, node=node, bus=bus, period=period, role="sync")


def _of_drives(system: System, bus: str) -> Iterator[BusMessage]:
    """Messages in which drives tell their state by themselves."""
    for plan in system.nodes.values():
        for drive in commanded_drives(system.deployment, plan):
            every = drive.profile.status.every
            if drive.bus == bus and every > 0:
                layout = drive.profile.status_layout(drive.node)
                layout = replace(layout, name=f"{layout.name}_{drive.node}")
                node = f"drive {drive.node}"
                yield BusMessage.of(layout, node=node, bus=bus, period=every, role="drive")


def watchdogs(system: System) -> list[MessageTimeout]:
    """Watchdogs and their messages: emulated drives, and inputs with a `stop`."""
    d = system.deployment
    found: list[MessageTimeout] = []
    for name, plan in system.nodes.items():
        spec = d.nodes[name]
        for inlet in plan.inlets:
            if spec.drive is not None and inlet.target.port == spec.drive.port:
                place = d.place("nodes", name, "drive")
                timeout = to_si(emulated(spec.drive, d).watchdog or 0.0, "s", place)
                found.append(MessageTimeout(f"drive of {name}", inlet.message, timeout))
            stale = spec.stale.get(f"{inlet.component}.{inlet.target.port}")
            if stale is not None and stale.stop:
                timeout = d.seconds(stale.stop, "nodes", name, "stale")
                found.append(
                    MessageTimeout(f"{inlet.target.name} of {name}", inlet.message, timeout)
                )
    return found


def overruns(system: System) -> list[Finding]:
    """Nodes that may be later than a turn of a counter: their samples could be numbered wrongly.

    Time stamps tell them apart, so only messages without one are looked at.
    """
    d = system.deployment
    found: list[Finding] = []
    for name, m in system.messages.items():
        if m.forward is not None:
            continue  # a gateway numbers nothing
        if m.encoding.message.time >= 0:
            continue
        profile = E2EProfile(m.encoding.message.e2e)
        turn = (1 << counter_bits(profile)) * m.period_ns * 1e-9
        overrun = d.seconds(d.nodes[m.node].overrun, "nodes", m.node, "overrun")
        if profile is E2EProfile.NONE or 0 < overrun < turn:
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


def forwarding_overruns(system: System) -> list[Finding]:
    """Forwarded messages whose counters wrap within the possible delay of a network."""
    d = system.deployment
    found: list[Finding] = []
    for name, m in system.messages.items():
        message = m.encoding.message
        if m.forward is None or message.e2e == E2EProfile.NONE:
            continue
        stamp = message.header[message.time].length if message.time >= 0 else 0
        counter = (1 << counter_bits(E2EProfile(message.e2e))) * m.period_ns * 1e-9
        latest = STAMP_TURNS * (1 << stamp) * 1e-6 if stamp else 0.75 * counter
        allowed = system.messages[m.forward.of].max_age_ns * 1e-9
        if latest > LATE or 0 < allowed <= latest:
            continue
        what = "time stamp" if stamp else "counter"
        found.append(
            Finding(
                rule="forward",
                severity="warning",
                where=name,
                number=latest,
                unit="s",
                reason=f"its {what} identifies samples that are at most {latest * 1e3:.3g} ms old:"
                " older ones would be numbered wrongly",
                advice=f'messages.{m.forward.of}.max_age = "{latest * 1e3:.3g} ms" drops them,'
                f" or another layout for {d.messages[name].bus}",
            )
        )
    return found


def unlimited(system: System) -> list[Finding]:
    """Signals without a range: every received value is accepted."""
    found: dict[str, Finding] = {}
    for node in system.nodes:
        for name in system.received_by(node):
            for signal in ranges.unlimited(system, node, system.messages[name]):
                port = signal.partition(".")[2]
                found[signal] = Finding(
                    rule="no-range",
                    severity="warning",
                    where=signal,
                    number=0.0,
                    unit="",
                    reason="has no range: any finite value with a correct CRC is accepted",
                    advice=f'[signals] {port} = {{ range = "..." }} in the deployment, or min and'
                    " max of the component",
                )
    return list(found.values())


def windups(system: System) -> list[Finding]:
    """Controllers whose own torque limit is above that of their guard: their estimates wind up.

    A controller with a parameter ``tau_max`` stops adapting while its torque is at that limit. If
    the limit is above that of its guard, it continues to adapt to a torque that is never applied.
    """
    found: list[Finding] = []
    for node, plan in system.nodes.items():
        spec = system.deployment.nodes[node].guard
        for step in plan.plan.components if spec is not None else ():
            assert spec is not None
            torque = next((o for o in step.outputs if o.port == spec.port), None)
            own = next((p for p in step.component.parameters if p.name == LIMIT), None)
            if torque is None or own is None:
                continue
            place = system.deployment.place("nodes", node, "guard", LIMIT)
            allowed = limits(spec.tau_max, torque.size, "N.m", place)
            known = max(step.values.get(LIMIT, own.default))
            if allowed is None or known <= allowed.max():
                continue
            found.append(
                Finding(
                    rule="windup",
                    severity="warning",
                    where=step.name,
                    number=known,
                    unit="N.m",
                    reason=f"assumes the limit {known:g} N.m ({LIMIT}), but the guard of {node}"
                    f" limits the torque to {allowed.max():g} N.m: beyond it the estimates wind up",
                    advice=f'[set] "components.{step.name}.parameters.{LIMIT}" ='
                    f' "{allowed.max():g} N.m" in the deployment',
                )
            )
    return found


def check(system: System) -> list[Finding]:
    """Findings: of inputs that nothing feeds, of the buses, then of the nodes."""
    plain = check_buses(messages(system), timings(system), watchdogs(system))
    buses = [f for f in plain if f.rule != "identifier"]  # collisions() looks at all parties
    found = [*unconnected_inputs(system.plan), *buses, *feeding(system), *slow_states(system)]
    found += [*collisions(system), *overruns(system), *forwarding_overruns(system)]
    return [*found, *windups(system), *unlimited(system)]
