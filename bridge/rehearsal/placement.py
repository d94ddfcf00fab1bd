"""Nodes on hosts: the graph of the nodes is cut where links have the largest least delay.

Hosts in lock-step exchange samples once in a window, which is as long as the least delay of the
links between them (the look-ahead of conservative simulation, Chandy and Misra 1979; Nicol 1993).
Nodes that are nearer than a limit stay together; the limit is the greatest for which they fit on
the hosts.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from bridge.deployment.system import System


@dataclass(frozen=True, slots=True)
class LockstepCosts:
    """Costs that are measured with two nodes, s, as ``benchmarks/lockstep.py --many`` does.

    `slot`: CPU time of a slot of a node; `payload`: of a payload at each of its two ends;
    `crossing`: in addition, of a payload between two hosts; `exchange`: time from the end of a
    window to the next one on a host without other work. Between hosts their latency is added.
    """

    slot: float = 2.5e-6
    payload: float = 63e-6
    crossing: float = 774e-6
    exchange: float = 0.12e-3


#: How much more than its share a host may have.
UNEVEN = 1.1


@dataclass(frozen=True, slots=True)
class Way:
    """The messages from one node to another; `lead`: the least delay of their links, s."""

    sender: str
    receiver: str
    lead: float


@dataclass(frozen=True, slots=True)
class HostPlacement:
    """The host of each node; `cut`: the ways between hosts; `seconds`: predicted, by cause."""

    hosts: Mapping[str, str]
    cut: tuple[Way, ...]
    computing: float
    waiting: float

    @property
    def window(self) -> float:
        """The least delay between hosts, s; infinite if nothing goes between hosts."""
        return min((way.lead for way in self.cut), default=float("inf"))

    @property
    def seconds(self) -> float:
        """The predicted time of a simulated second, s."""
        return self.computing + self.waiting

    def lines(self) -> list[str]:
        """For people."""
        on: dict[str, list[str]] = defaultdict(list)
        for node, host in self.hosts.items():
            on[host].append(node)
        found = [f"{host}: {', '.join(nodes)}" for host, nodes in on.items()]
        if self.cut:
            least = min(self.cut, key=lambda way: way.lead)
            found.append(
                f"windows of {1e3 * self.window:g} ms between hosts "
                f"({least.sender} to {least.receiver})"
            )
        found.append(
            f"predicted: a simulated second in {self.seconds:.2g} s "
            f"(computing {self.computing:.2g} s, network {self.waiting:.2g} s)"
        )
        return found


def ways(system: System) -> tuple[Way, ...]:
    """All ways between two nodes of a deployment."""
    d, found = system.deployment, dict[tuple[str, str], float]()
    ahead = d.latency and all(b.options.get("lookahead", True) for b in d.buses.values())
    for node, plan in system.nodes.items():
        for inlet in plan.inlets:
            ticks = inlet.link.table.minimum_delay_ticks if inlet.link and ahead else 0
            pair = (system.messages[inlet.message].node, node)
            found[pair] = min(found.get(pair, float("inf")), ticks * system.plan.h)
    return tuple(Way(*pair, lead) for pair, lead in sorted(found.items()))


def place(
    nodes: Sequence[str],
    between: Sequence[Way],
    cores: Mapping[str, int],
    fixed: Mapping[str, str],
) -> dict[str, str]:
    """The host of each node; `cores`: of the hosts, `fixed`: nodes that are placed already."""
    limits = [float("inf"), *sorted({way.lead for way in between}, reverse=True)]
    uneven = UNEVEN
    while True:
        for limit in limits:
            groups = _groups(nodes, [way for way in between if way.lead < limit])
            if (found := _packed(groups, between, cores, fixed, uneven)) is not None:
                return _refined(found, groups, between, fixed)
        uneven *= 2.0  # the nodes of the file leave too little room elsewhere


def _groups(nodes: Iterable[str], near: Iterable[Way]) -> list[list[str]]:
    """Nodes that belong together, the largest group first (union and find)."""
    root = {node: node for node in nodes}

    def top(node: str) -> str:
        while root[node] != node:
            root[node] = node = root[root[node]]
        return node

    for way in near:
        root[top(way.sender)] = top(way.receiver)
    found: dict[str, list[str]] = defaultdict(list)
    for node in root:
        found[top(node)].append(node)
    return sorted(found.values(), key=len, reverse=True)


def _room(n: int, cores: Mapping[str, int], uneven: float) -> dict[str, float]:
    total = sum(cores.values())
    return {host: max(1.0, -(-n * share // total), uneven * n * share / total)
            for host, share in cores.items()}  # fmt: skip


def _traffic(between: Iterable[Way]) -> dict[str, Counter[str]]:
    found: dict[str, Counter[str]] = defaultdict(Counter)
    for way in between:
        found[way.sender][way.receiver] += 1
        found[way.receiver][way.sender] += 1
    return found


def _packed(
    groups: Sequence[Sequence[str]],
    between: Sequence[Way],
    cores: Mapping[str, int],
    fixed: Mapping[str, str],
    uneven: float,
) -> dict[str, str] | None:
    """Groups on hosts, each where it has room and most traffic; None: they do not fit."""
    room = _room(sum(map(len, groups)), cores, uneven)
    traffic, found, open_ = _traffic(between), dict(fixed), list(groups)
    for host in fixed.values():
        room[host] = max(0.0, room[host] - 1)
    for group in groups:
        at = {fixed[n] for n in group if n in fixed}
        if len(at) > 1:
            return None
        if at:
            host = at.pop()
            room[host] -= sum(n not in fixed for n in group)
            found |= dict.fromkeys(group, host)
            open_.remove(group)
    if any(left < 0 for left in room.values()):
        return None
    while open_:
        group, host = max(
            ((g, h) for g in open_ for h in room),
            key=lambda gh: _gain(gh[0], gh[1], found, traffic, room),
        )
        if len(group) > room[host]:
            return None
        room[host] -= len(group)
        found |= dict.fromkeys(group, host)
        open_.remove(group)
    return {node: found[node] for group in groups for node in group}


def _gain(
    group: Sequence[str],
    host: str,
    found: Mapping[str, str],
    traffic: Mapping[str, Counter[str]],
    room: Mapping[str, float],
) -> tuple[bool, int, int, float]:
    """The order in which groups are put on hosts: large ones first, then by traffic."""
    near = sum(k for n in group for other, k in traffic[n].items() if found.get(other) == host)
    return len(group) <= room[host], len(group), near, room[host]


def _refined(
    found: dict[str, str],
    groups: Sequence[Sequence[str]],
    between: Sequence[Way],
    fixed: Mapping[str, str],
) -> dict[str, str]:
    """Exchange groups of one size while that makes fewer ways between hosts."""
    traffic = _traffic(between)
    free = [g for g in groups if not any(n in fixed for n in g)]

    def near(group: Sequence[str], host: str) -> int:
        return sum(
            k for n in group for other, k in traffic[n].items()
            if found[other] == host and other not in group
        )  # fmt: skip

    better = True
    while better:
        better = False
        for i, one in enumerate(free):
            for other in free[i + 1 :]:
                a, b = found[one[0]], found[other[0]]
                if a == b or len(one) != len(other):
                    continue
                joint = sum(traffic[n][m] for n in one for m in other)
                gain = near(one, b) - near(one, a) + near(other, a) - near(other, b) - 2 * joint
                if gain > 0:
                    found |= dict.fromkeys(one, b) | dict.fromkeys(other, a)
                    better = True
    return found


def predict(
    system: System,
    between: Sequence[Way],
    hosts: Mapping[str, str],
    cores: Mapping[str, float],
    latency: float,
    costs: LockstepCosts = LockstepCosts(),
) -> HostPlacement:
    """A placement with its time of a simulated second, by the theory of windows.

    A window is a superstep of the bulk-synchronous model (Valiant 1990, *A bridging model for
    parallel computation*): the busiest host computes its slots, w, and handles h payloads at g
    each; then what was sent takes l to the others: w + g h + l. A simulated second has 1 / W of
    them. Of l, between hosts, `latency` (s) is a part. Hosts that compute while their samples
    travel take less, at least max(w + g h, l).
    """
    cut = tuple(way for way in between if hosts[way.sender] != hosts[way.receiver])
    busy = dict.fromkeys(cores, 0.0)
    for node, plan in system.nodes.items():
        busy[hosts[node]] += costs.slot / plan.h
    windows = {way: 1.0 / max(way.lead, _period(system, way.sender)) for way in between}
    sent: dict[str, float] = {}
    crossed: dict[tuple[str, str], float] = {}  # one payload for all receivers of a host
    for way, each in windows.items():
        sent[way.sender] = max(sent.get(way.sender, 0.0), each)
        busy[hosts[way.receiver]] += costs.payload * each
        if way in cut:
            pair = (way.sender, hosts[way.receiver])
            crossed[pair] = max(crossed.get(pair, 0.0), each)
    for node, each in sent.items():
        busy[hosts[node]] += costs.payload * each
    for (_, host), each in crossed.items():
        busy[host] += costs.crossing * each
    computing = max(load / cores[host] for host, load in busy.items())
    far = {way: costs.exchange + latency * (way in cut) for way in between}
    waiting = max((each * far[way] for way, each in windows.items()), default=0.0)
    return HostPlacement(dict(hosts), cut, computing, waiting)


def _period(system: System, node: str) -> float:
    found = [m.period_ns * 1e-9 for m in system.messages.values() if m.node == node]
    return min(found, default=system.nodes[node].h)
