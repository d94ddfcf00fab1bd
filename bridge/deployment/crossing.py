"""Signals that cross the cuts of a deployment, and the values of messages that carry them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from bridge.deployment.gateways import Forward, carried_signals, entries, gateways
from bridge.deployment.spec import Deployment
from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.schedule.parts import Link, Slot, Wire
from cosim.schedule.plan import Plan

Edge = Wire | Link
#: Messages and numbers of the value in them, the first sender's first, by place in the plan's
#: signal vector.
Carriers = Mapping[int, Sequence[tuple[str, int]]]


@dataclass(frozen=True, slots=True)
class Crossing:
    """An edge between two nodes, or one entry of it: values `first` ... of a message."""

    edge: Edge
    message: str
    first: int


def node_of_component(plan: Plan, d: Deployment) -> dict[str, str]:
    """The node of each component. Raises ScenarioError for one too many or too few."""
    found = {c: name for name, node in d.nodes.items() for c in node.components}
    names = {c.name for c in plan.components}
    for name, node in d.nodes.items():
        place = d.place("nodes", name, "components")
        if not node.components and name not in gateways(d):
            text = "has no component and forwards nothing; expected a component, or a message by it"
            raise ScenarioError(text, place)
        if node.components and node.step is not None:
            text = "has a step and components; expected one of both: components have their periods"
            raise ScenarioError(text, d.place("nodes", name, "step"))
        for c in node.components:
            if c not in names:
                known = ", ".join(sorted(names))
                raise ScenarioError(f"no component {c!r}; the scenario has: {known}", place)
    lost = sorted(names - set(found))
    if lost:
        raise ScenarioError(f"no node for {', '.join(lost)}", d.place("nodes"))
    return found


def message_of_signal(plan: Plan, d: Deployment, forwarded: Mapping[str, Forward]) -> Carriers:
    """The message that carries each signal. Raises ScenarioError for a signal with two first
    carriers.
    """
    found: dict[int, list[tuple[str, int]]] = {}
    for name, message in d.messages.items():
        if name in forwarded:
            continue
        place = d.place("messages", name, "carries")
        for first, entry in enumerate(_values(carried_signals(plan, message, place))):
            if entry.start in found:
                other = found[entry.start][0][0]
                raise ScenarioError(f"{entry.name} is in {other} already", place)
            found[entry.start] = [(name, first)]
    for forward in forwarded.values():
        for first, entry in enumerate(_values(forward.parts)):
            found[entry.start].append((forward.message, first))
    return found


def _values(parts: Sequence[Slot]) -> Iterator[Slot]:
    for part in parts:
        yield from entries(part)


def crossings(
    plan: Plan, d: Deployment, nodes: Mapping[str, str], forwarded: Mapping[str, Forward]
) -> list[Crossing]:
    """Everything that crosses a cut, sorted by target; in entries where messages share it.

    `nodes`: the node of each component. Raises ScenarioError for what no message carries.
    """
    edges: list[Edge] = [*plan.wires, *plan.links]
    cut = [e for e in edges if nodes[e.source.component] != nodes[e.target.component]]
    by_place = message_of_signal(plan, d, forwarded)
    for e in cut:
        _covered(e, by_place, d)
    buses = _buses(cut, by_place, d, nodes)
    return [
        x
        for e in sorted(cut, key=lambda e: e.target.name)
        for x in _split(e, by_place, d, buses[nodes[e.target.component]])
    ]


def _covered(edge: Edge, by_place: Carriers, d: Deployment) -> None:
    for source in entries(edge.source):
        if source.start not in by_place:
            raise ScenarioError(
                f"{edge.source.name} -> {edge.target.name} crosses a cut, but no message carries "
                f"{source.name}",
                d.place("messages"),
            )


def _buses(
    cut: Sequence[Edge], by_place: Carriers, d: Deployment, nodes: Mapping[str, str]
) -> dict[str, set[str]]:
    """The buses each node is on anyway: it sends there, or there only is something it needs."""
    found: dict[str, set[str]] = {name: set() for name in d.nodes}
    for m in d.messages.values():
        if m.forwards:
            found[m.by] |= {m.bus, d.messages[m.forwards].bus}
        else:
            found[nodes[m.carries[0].partition(".")[0]]].add(m.bus)
    for e in cut:
        for source in entries(e.source):
            if len(by_place[source.start]) == 1:
                message = by_place[source.start][0][0]
                found[nodes[e.target.component]].add(d.messages[message].bus)
    return found


def _chosen(there: Sequence[tuple[str, int]], d: Deployment, buses: set[str]) -> tuple[str, int]:
    """The message with a value that has the shortest way to a bus a node is on.

    A node that is on none of their buses listens to the first sender.
    """
    near = [carrier for carrier in there if d.messages[carrier[0]].bus in buses]
    return near[0] if near else there[0]


def _split(edge: Edge, by_place: Carriers, d: Deployment, buses: set[str]) -> list[Crossing]:
    found = []
    for source, target in zip(entries(edge.source), entries(edge.target), strict=True):
        message, first = _chosen(by_place[source.start], d, buses)
        found.append(Crossing(replace(edge, source=source, target=target), message, first))
    message, first = found[0].message, found[0].first
    together = [(message, first + i) for i in range(len(found))]
    if [(x.message, x.first) for x in found] == together:
        return [Crossing(edge, message, first)]
    return found
