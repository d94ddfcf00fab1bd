"""Messages that gateways forward: their content and senders, and checks of their routes.

A message with ``forwards`` is another message once more, on another bus: the node ``by`` sends it
when that one has come, with the number, time stamp and status its first sender gave it. So a signal
may be carried by several messages, and a receiver listens to the one on a bus it is on.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from bridge.deployment.spec import Deployment, MessageSpec
from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.schedule.parts import Slot
from cosim.schedule.plan import Plan


@dataclass(frozen=True, slots=True)
class Forward:
    """A message that `by` makes of another one, `of`: values `sources` of that, in this order.

    `origin`: the first message of the route, `hops` before this one; `parts`: slots of the whole
    plan.
    """

    message: str
    of: str
    origin: str
    hops: int
    by: str
    bus: str
    carries: tuple[str, ...]
    parts: tuple[Slot, ...]
    sources: tuple[int, ...]


def carried_signals(plan: Plan, m: MessageSpec, place: str) -> tuple[Slot, ...]:
    """The signals of a message: outputs, or entries of them, of one component.

    Raises ScenarioError if it carries nothing, outputs of several components, or an unknown output.
    """
    if not m.carries:
        raise ScenarioError("is empty; expected outputs (component.port)", place)
    if len({c.partition(".")[0] for c in m.carries}) > 1:
        raise ScenarioError("has outputs of several components; expected those of one", place)
    slots = {s.name: s for c in plan.components for s in c.outputs}
    known = {e.name: e for s in slots.values() for e in entries(s)}
    for signal in m.carries:
        if signal not in slots and signal not in known:
            raise ScenarioError(f"no output {signal!r} in the scenario", place)
    return tuple(slots.get(signal) or known[signal] for signal in m.carries)


def numbered(d: Deployment, plan: Plan) -> Deployment:
    """The same with the numbers of entries that motors of an arm have in its plant: those of some
    FMUs count from 1.
    """
    slots = {s.name: s for c in plan.components for s in c.outputs}

    def own(signal: str, joint: int) -> str:
        slot = slots.get(signal.removesuffix(f"[{joint}]"))
        if slot is None or slot.name == signal or joint >= slot.size:
            return signal  # whoever cuts says what is wrong
        return slot.scalars()[joint]

    messages = {
        name: m
        if m.joint is None
        else replace(m, carries=tuple(own(x, m.joint) for x in m.carries))
        for name, m in d.messages.items()
    }
    return replace(d, messages=messages)


def entries(slot: Slot) -> Iterator[Slot]:
    """The scalars of a slot, as slots."""
    for i, name in enumerate(slot.scalars()):
        units = slot.units[i : i + 1]
        yield replace(slot, name=name, start=slot.start + i, shape=(), units=units)


def gateways(d: Deployment) -> frozenset[str]:
    """Nodes that forward messages."""
    return frozenset(m.by for m in d.messages.values() if m.forwards)


def forwards(plan: Plan, d: Deployment) -> dict[str, Forward]:
    """All messages that forward others, behind those they are made of.

    Raises ScenarioError for a way that leads nowhere, round in a circle, or twice over one bus.
    """
    chains = {name: _chain(d, name) for name in d.messages}
    found: dict[str, Forward] = {}
    for name in sorted(d.messages, key=lambda name: len(chains[name])):
        m = d.messages[name]
        if m.forwards:
            _check(d, name, chains[name])
            found[name] = _forward(plan, d, name, chains[name], found)
        elif m.by:
            text = f"says who forwards it ({m.by}), but not what; expected forwards = a message"
            raise ScenarioError(text, d.place("messages", name, "by"))
    return found


def _chain(d: Deployment, name: str) -> list[str]:
    """A message, the one it forwards, and so on to the first."""
    chain = [name]
    while of := d.messages[chain[-1]].forwards:
        place = d.place("messages", chain[-1], "forwards")
        if of not in d.messages:
            known = ", ".join(sorted(d.messages))
            raise ScenarioError(f"no message {of!r}; there are: {known}", place)
        if of in chain:
            way = " -> ".join([*chain, of])
            raise ScenarioError(f"{way} is a loop; expected a message that carries outputs", place)
        chain.append(of)
    return chain


def _check(d: Deployment, name: str, chain: Sequence[str]) -> None:
    """Check the node that forwards a message, and its buses."""
    m, of = d.messages[name], chain[1]
    if m.by not in d.nodes:
        text = f"no node {m.by!r}" if m.by else f"says no node that forwards {of}"
        nodes = ", ".join(sorted(d.nodes))
        raise ScenarioError(f"{text}; expected one of {nodes}", d.place("messages", name, "by"))
    if m.by == _sender(d, of):
        text = f"{m.by} sends {of} itself; expected another node (a message may carry it as well)"
        raise ScenarioError(text, d.place("messages", name, "by"))
    if m.period is not None:
        text = f"has a period, but comes when {of} comes; expected none"
        raise ScenarioError(text, d.place("messages", name, "period"))
    before = [d.messages[other].bus for other in chain[1:]]
    if m.bus in before:
        way = " -> ".join([*reversed(before), m.bus])
        text = f"{of} has been on bus {m.bus} already ({way}); expected another bus"
        raise ScenarioError(text, d.place("messages", name, "bus"))


def _sender(d: Deployment, message: str) -> str:
    """The node that sends it; none: ""."""
    m = d.messages[message]
    component = next(iter(m.carries), "").partition(".")[0]
    homes = (name for name, node in d.nodes.items() if component in node.components)
    return m.by or next(homes, "")


def _forward(
    plan: Plan, d: Deployment, name: str, chain: Sequence[str], found: Mapping[str, Forward]
) -> Forward:
    m, origin, hops = d.messages[name], chain[-1], len(chain) - 1
    place = d.place("messages", name, "carries")
    if m.forwards in found:
        carries, parts = found[m.forwards].carries, found[m.forwards].parts
    else:
        carries = d.messages[origin].carries
        parts = carried_signals(plan, d.messages[origin], d.place("messages", origin, "carries"))
    there = [e.start for part in parts for e in entries(part)]
    if m.carries:
        carries, parts = m.carries, carried_signals(plan, m, place)
    wanted = [e for part in parts for e in entries(part)]
    for entry in wanted:
        if entry.start not in there:
            text = f"{entry.name} is not in {m.forwards}, which it forwards"
            raise ScenarioError(text, place)
    sources = tuple(there.index(e.start) for e in wanted)
    return Forward(name, m.forwards, origin, hops, m.by, m.bus, carries, parts, sources)


# ---- how buses hang together --------------------------------------------------------------------


def check_single_route(d: Deployment, buses: Mapping[str, Iterable[str]]) -> None:
    """Raise ScenarioError if gateways join two buses by more than one route.

    `buses`: of each gateway. Broadcasts pass every gateway and would circulate forever.
    """
    islands = {bus: {bus} for bus in d.buses}
    for node, joined in buses.items():
        whole: set[str] = set()
        for bus in joined:
            if bus in whole:
                others = ", ".join(sorted(n for n in buses if n != node))
                text = f"joins {' and '.join(joined)}, which are joined already (by {others}): "
                text += "commands would go round; expected one way between two buses"
                raise ScenarioError(text, d.place("nodes", node))
            whole |= islands[bus]
        islands |= dict.fromkeys(whole, whole)


def check_required_nodes(
    d: Deployment, buses: Mapping[str, Iterable[str]], beating: Mapping[str, Iterable[str]]
) -> None:
    """Raise ScenarioError if a node requires a node whose heartbeats it cannot receive.

    `buses`: of each node; `beating`: buses of each node that carry its heartbeats. Heartbeats are
    not forwarded, so stops are decided among the nodes of one bus.
    """
    for node, spec in d.nodes.items():
        for other in spec.requires:
            if other == node or set(buses[node]) & set(beating[other]):
                continue
            here = [n for n in d.nodes if n != node and set(beating[n]) & set(buses[node])]
            text = f"{other} sends heartbeats on no bus of {node}, and they are not forwarded; "
            text += (
                f"expected one of {', '.join(here) or 'none'} (what {other} sends may have an age)"
            )
            raise ScenarioError(text, d.place("nodes", node, "requires"))
