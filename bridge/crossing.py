"""What crosses the cuts of a deployment, and which value of which message carries it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from bridge.deploy import Deployment, MessageSpec
from cosim.errors import ScenarioError
from cosim.plan import Link, Plan, Slot, Wire

Edge = Wire | Link
#: (message, number of the value in it) by place in the plan's signal vector.
Carriers = Mapping[int, tuple[str, int]]


@dataclass(frozen=True, slots=True)
class Crossing:
    """An edge between two nodes, or one entry of it: values `first` ... of a message."""

    edge: Edge
    message: str
    first: int


def homes(plan: Plan, d: Deployment) -> dict[str, str]:
    """The node of each component. Raises ScenarioError for one too many or too few."""
    found = {c: name for name, node in d.nodes.items() for c in node.components}
    names = {c.name for c in plan.components}
    for name, node in d.nodes.items():
        place = d.place("nodes", name, "components")
        if not node.components:
            raise ScenarioError("has no component; expected one at least", place)
        for c in node.components:
            if c not in names:
                known = ", ".join(sorted(names))
                raise ScenarioError(f"no component {c!r}; the scenario has: {known}", place)
    lost = sorted(names - set(found))
    if lost:
        raise ScenarioError(f"no node for {', '.join(lost)}", d.place("nodes"))
    return found


def carried(plan: Plan, m: MessageSpec, place: str) -> tuple[Slot, ...]:
    """What a message carries: outputs, or entries of them, of one component."""
    if not m.carries:
        raise ScenarioError("carries nothing; expected outputs, component.port", place)
    if len({c.partition(".")[0] for c in m.carries}) > 1:
        raise ScenarioError("carries outputs of several components; expected one's", place)
    slots = {s.name: s for c in plan.components for s in c.outputs}
    entries = {e.name: e for s in slots.values() for e in _entries(s)}
    for signal in m.carries:
        if signal not in slots and signal not in entries:
            raise ScenarioError(f"no output {signal!r} in the scenario", place)
    return tuple(slots.get(signal) or entries[signal] for signal in m.carries)


def _entries(slot: Slot) -> Iterator[Slot]:
    """The scalars of a slot, as slots."""
    for i, name in enumerate(slot.scalars()):
        yield replace(slot, name=name, start=slot.start + i, shape=())


def carriers(plan: Plan, d: Deployment) -> Carriers:
    """Who carries what. Raises ScenarioError for a signal that is in two messages."""
    found: dict[int, tuple[str, int]] = {}
    for name, message in d.messages.items():
        place, first = d.place("messages", name, "carries"), 0
        for part in carried(plan, message, place):
            for entry in _entries(part):
                if entry.start in found:
                    other = found[entry.start][0]
                    raise ScenarioError(f"{entry.name} is in {other} already", place)
                found[entry.start] = (name, first)
                first += 1
    return found


def crossings(plan: Plan, d: Deployment, nodes: Mapping[str, str]) -> list[Crossing]:
    """Everything that crosses a cut, sorted by target; in entries where messages share it.

    Raises ScenarioError for what no message carries.
    """
    by_place = carriers(plan, d)
    edges: list[Edge] = [*plan.wires, *plan.links]
    cut = [e for e in edges if nodes[e.source.component] != nodes[e.target.component]]
    return [x for e in sorted(cut, key=lambda e: e.target.name) for x in _split(e, by_place, d)]


def _split(edge: Edge, by_place: Carriers, d: Deployment) -> list[Crossing]:
    found = []
    for source, target in zip(_entries(edge.source), _entries(edge.target), strict=True):
        if source.start not in by_place:
            raise ScenarioError(
                f"{edge.source.name} -> {edge.target.name} crosses a cut, but no message carries "
                f"{source.name}",
                d.place("messages"),
            )
        found.append(Crossing(replace(edge, source=source, target=target), *by_place[source.start]))
    message, first = found[0].message, found[0].first
    together = [(message, first + i) for i in range(len(found))]
    if [(x.message, x.first) for x in found] == together:
        return [Crossing(edge, message, first)]
    return found
