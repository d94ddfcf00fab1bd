"""A scenario under a deployment: the nodes' plans, and the messages between them with their codecs.

Each node, the twin and the replay build it from the same two files and therefore agree.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bridge.can import dbc
from bridge.can.codec import Codec
from bridge.can.codec_check import verify
from bridge.can.layout import MessageLayout, find
from bridge.deployment import drive_messages, drive_sequences, protection, start_positions
from bridge.deployment import gateways as routes
from bridge.deployment import spec as deploy
from bridge.deployment import zenoh_keys as names
from bridge.deployment.carried import Carried, Subscription
from bridge.deployment.cut import NodePlan, Outlet, cut_plan, start_values
from bridge.deployment.gateways import Forward
from bridge.deployment.services import Encoding, Service, services_on
from bridge.deployment.spec import Deployment
from bridge.native.bus import Accept
from cosim.base.copies import replace
from cosim.base.errors import ScenarioError, UnitError
from cosim.base.units import conversion
from cosim.fmi.components import has_unit, unit_of
from cosim.loading.files import load as load_scenario
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario
from cosim.schedule.plan import Plan

#: The least number of rows of a bus log: a node may babble.
LEAST = 50_000


@dataclass(frozen=True, slots=True)
class System:
    """Scenario, deployment, the whole plan and those of the nodes, messages and services by bus."""

    scenario: Scenario
    deployment: Deployment
    plan: Plan
    nodes: Mapping[str, NodePlan]
    messages: Mapping[str, Carried]
    services: Mapping[str, Service]

    def buses_of(self, node: str) -> tuple[str, ...]:
        """The buses on which a node sends or receives, in the order of the deployment."""
        plan = self.nodes[node]
        used = {o.bus for o in plan.outlets} | {f.bus for f in plan.forwards}
        used |= {self.messages[m].bus for m in self.received_by(node)}
        return tuple(name for name in self.deployment.buses if name in used)

    def received_by(self, node: str) -> tuple[str, ...]:
        """Messages a node receives, sorted."""
        plan = self.nodes[node]
        heard = {i.message for i in plan.inlets} | {f.of for f in plan.forwards}
        buses = {o.bus for o in plan.outlets} | {self.messages[m].bus for m in heard}
        compared = start_positions.messages(self.deployment, node, self.messages, buses)
        return tuple(sorted(heard | compared))

    def forwards_of(self, origin: str) -> tuple[Carried, ...]:
        """Messages that gateways make of one message, at any depth, each after its source."""
        made = [m for m in self.messages.values() if m.forward and m.forward.origin == origin]
        return tuple(made)

    @property
    def sync_ticks(self) -> int:
        """Base ticks between two SYNC: a slot of the slowest node."""
        return max(node.ticks for node in self.nodes.values() if node.plan.components)

    def log_rows(self, bus: str) -> int:
        """Rows of the log of a bus: twice what its messages are, and as much again for the rest.

        Not more: pages of a log are written to the disk once, whether they hold frames or not.
        """
        seconds = self.plan.ticks * self.plan.h + 10.0
        rate = sum(1e9 / m.period_ns for m in self.messages.values() if m.bus == bus)
        nodes = sum(bus in self.buses_of(node) for node in self.nodes)
        sync = 1.0 / (self.sync_ticks * self.plan.h)
        return int(min(max(LEAST, 2.0 * (rate + sync + 20.0 * nodes) * seconds), 4e6))

    def subscriptions(self, node: str) -> tuple[Subscription, ...]:
        """Messages and services that a node listens to, with the bus and the format of each.

        Everything else does not reach its decisions. An emergency stop may be of any length.
        """
        heard = [self.messages[name] for name in self.received_by(node)]
        found = [Subscription(m.bus, m.name, Accept.of(m.encoding.message)) for m in heard]
        for bus in self.buses_of(node):
            for name, encoding in self.services[bus].named().items():
                of = Accept.for_estop if name == "ESTOP" else Accept.of
                found.append(Subscription(bus, name, of(encoding.message)))
        return tuple(found)

    def accepts(self, node: str, bus: str) -> tuple[Accept, ...]:
        """Frames that a node listens to on a bus."""
        found = tuple(one.accept for one in self.subscriptions(node) if one.bus == bus)
        return found + drive_sequences.accepted_frames(self.deployment, self.nodes[node], node, bus)

    def peers_of(self, node: str) -> tuple[str, ...]:
        """Nodes whose heartbeats it receives: those on one of its buses that has heartbeats."""
        here, nodes = set(self.buses_of(node)), self.deployment.nodes
        return tuple(
            other
            for other, spec in nodes.items()
            if other != node
            and any(
                spec.number in self.services[bus].heartbeats
                for bus in here & set(self.buses_of(other))
            )
        )


def load_system(scenario: str | Path, deployment: str, settings: Sequence[str] = ()) -> System:
    """Read both files, assemble and cut. Raises ScenarioError, FmuError, PlanError, CosimError.

    `settings`: ``path=value``; those that begin with ``deploy.`` change the deployment.
    """
    scenario = Path(scenario)
    ours = [s.removeprefix("deploy.") for s in settings if s.startswith("deploy.")]
    theirs = [s for s in settings if not s.startswith("deploy.")]
    found = deploy.load(deploy.find(scenario, deployment), ours)
    return make_system(load_scenario(scenario, [*found.settings(), *theirs]), found)


def make_system(scenario: Scenario, deployment: Deployment) -> System:
    """Assemble and cut what has been read.

    Raises as :func:`load_system`, and ScenarioError for a run that begins at another time than 0.
    """
    if scenario.seconds(scenario.run.start, "run.start"):
        raise ScenarioError(
            f"found {scenario.run.start}, expected 0 with a deployment: its nodes begin at 0",
            scenario.place("run.start"),
        )
    start = start_values(assemble(scenario))
    plan = assemble(scenario)
    deployment = routes.numbered(deployment, plan)
    nodes = cut_plan(plan, deployment, start)
    protection.check(nodes, deployment)
    layouts = {
        name: dbc.load(deployment.file(bus.dbc)) if bus.dbc else ()
        for name, bus in deployment.buses.items()
        if bus.kind == "can"
    }
    services = {bus: services_on(deployment, bus, layouts.get(bus, ())) for bus in deployment.buses}
    messages = {
        outlet.message: _carried(outlet, name, plan, deployment, layouts)
        for name in deployment.nodes
        for outlet in nodes[name].outlets
    }
    forwarded = [f for node in nodes.values() for f in node.forwards]
    for forward in sorted(forwarded, key=lambda f: f.hops):
        first = messages[forward.origin]
        messages[forward.message] = _forwarded(forward, first, plan, deployment, layouts)
    system = System(scenario, deployment, plan, nodes, messages, services)
    _joined(system)
    return system


def _joined(system: System) -> None:
    """Buses hang together as they may. Raises ScenarioError."""
    buses = {node: system.buses_of(node) for node in system.nodes}
    numbers = {node: spec.number for node, spec in system.deployment.nodes.items()}
    beating = {
        node: [bus for bus in buses[node] if numbers[node] in system.services[bus].heartbeats]
        for node in system.nodes
    }
    routes.check_required_nodes(system.deployment, buses, beating)
    gateways = sorted(routes.gateways(system.deployment))
    routes.check_single_route(system.deployment, {node: buses[node] for node in gateways})


def _forwarded(
    forward: Forward,
    first: Carried,
    plan: Plan,
    d: Deployment,
    layouts: Mapping[str, Sequence[MessageLayout]],
) -> Carried:
    outlet = replace(
        first.outlet,
        message=forward.message,
        bus=forward.bus,
        carries=forward.carries,
        parts=forward.parts,
    )
    made = _carried(outlet, forward.by, plan, d, layouts)
    return replace(made, offset_ns=first.offset_ns, forward=forward)


def _carried(
    outlet: Outlet,
    node: str,
    plan: Plan,
    d: Deployment,
    layouts: Mapping[str, Sequence[MessageLayout]],
) -> Carried:
    spec = d.messages[outlet.message]
    place = d.place("messages", outlet.message)
    if spec.profile:
        return _timed(outlet, node, drive_messages.codec(outlet, d), plan, d)
    signals = spec.signals or _signals(outlet)
    if len(signals) != outlet.width:
        raise ScenarioError(f"{len(signals)} signals for {outlet.width} values", f"{place}.signals")
    if spec.bus not in layouts:
        return _timed(outlet, node, _streamed(outlet, node, d, signals), plan, d)
    layout = find(layouts[spec.bus], spec.name or outlet.message)
    verify(Codec(layout, signals))  # before units are converted
    made = _in_units(layout, signals, outlet, plan, f"{place}.carries")
    return _timed(outlet, node, Codec(made, signals), plan, d)


def _in_units(
    layout: MessageLayout, names: Sequence[str], outlet: Outlet, plan: Plan, place: str
) -> MessageLayout:
    """The layout with the signals `names` in the units of the values that they carry.

    A signal or a value without a unit is taken as it is. Raises ScenarioError for a unit that does
    not fit or that is unknown.
    """
    entries = [(part, i, name) for part in outlet.parts for i, name in enumerate(part.scalars())]
    found = {s.name: s for s in layout.signals}
    for name, (part, i, entry) in zip(names, entries, strict=True):
        signal, unit = layout.signal(name), part.unit_of(i)
        component = plan.component(part.component).component
        if signal.unit in ("", unit) or not has_unit(component, part.port):
            continue
        try:
            gain, offset = conversion(signal.unit, unit_of(component, unit))
        except UnitError as error:
            raise ScenarioError(
                f"{layout.place}: signal {name} is in [{signal.unit}], but {entry} is in [{unit}]:"
                f" {error}; expected a unit that fits, or none, in the DBC file",
                place,
            ) from None
        found[name] = signal.converted(gain, offset, unit)
    return replace(layout, signals=tuple(found.values()))


def _streamed(outlet: Outlet, node: str, d: Deployment, signals: Sequence[str]) -> Encoding:
    """The coder of a message on a Zenoh bus."""
    key = names.names_of(d, outlet.bus).message(node, outlet.component, outlet.message)
    return names.codec(key, names.numbers(d, outlet.bus)[outlet.message], signals)


def _timed(outlet: Outlet, node: str, encoding: Encoding, plan: Plan, d: Deployment) -> Carried:
    spec = d.messages[outlet.message]
    return Carried(
        name=outlet.message,
        bus=spec.bus,
        node=node,
        outlet=outlet,
        encoding=encoding,
        period_ns=round(outlet.ticks * plan.h * 1e9),
        offset_ns=round(d.seconds(d.nodes[node].phase, "nodes", node, "phase") * 1e9),
        max_age_ns=round(d.seconds(spec.max_age, "messages", outlet.message, "max_age") * 1e9),
    )


def _signals(outlet: Outlet) -> list[str]:
    """``q1, q2, dq1, dq2`` for the ports q and dq of two entries each; a scalar by its name."""
    names: list[str] = []
    for part in outlet.parts:
        index = part.name[len(f"{part.component}.{part.port}[") :].rstrip("]")
        port = part.port
        if part.shape:
            names += [f"{port}{i + 1}" for i in range(part.size)]
        else:
            names.append(f"{port}{int(index) + 1 - part.base}" if index.isdigit() else port)
    return names
