"""Topological orders of names: deterministic for given edges, ties resolved by name.

An edge (a, b) means that b comes after a. The cost is linear in edges, except for ties.
"""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Iterable, Mapping

from cosim.base.errors import CosimError

Edge = tuple[str, str]


class CycleError(CosimError, ValueError):
    """Names that wait for each other: `cycle`, first and last entry the same, along the edges."""

    def __init__(self, cycle: tuple[str, ...]) -> None:
        super().__init__(" -> ".join(cycle))
        self.cycle = cycle


def topological(names: Iterable[str], edges: Iterable[Edge]) -> tuple[str, ...]:
    """Every name after all that it waits for. Raises CycleError where there is a cycle."""
    sources, targets = _neighbours(names, edges)
    ready = [name for name, waits in sources.items() if not waits]
    heapq.heapify(ready)
    order: list[str] = []
    while ready:
        name = heapq.heappop(ready)
        order.append(name)
        del sources[name]
        for other in targets[name]:
            sources[other].discard(name)
            if not sources[other]:
                heapq.heappush(ready, other)
    if sources:
        raise CycleError(_cycle(sources))
    return tuple(order)


def sequence(names: Iterable[str], edges: Iterable[Edge]) -> tuple[str, ...]:
    """An order in which few components precede those for which they wait, chosen greedily.

    The next component is the one that waits for the fewest unplaced components; of these, the first
    by name. Without a cycle this is a topological order.
    """
    sources, targets = _neighbours(names, edges)
    heap = [(len(waits), name) for name, waits in sources.items()]
    heapq.heapify(heap)
    order: list[str] = []
    while heap:
        n, name = heapq.heappop(heap)
        if name not in sources or n != len(sources[name]):
            continue  # came already, or waits for fewer by now and is queued twice
        order.append(name)
        del sources[name]
        for other in targets[name]:
            if other in sources:
                sources[other].discard(name)
                heapq.heappush(heap, (len(sources[other]), other))
    return tuple(order)


def strongly_connected(names: Iterable[str], edges: Iterable[Edge]) -> list[tuple[str, ...]]:
    """Sets of names that wait for each other, each after those that it waits for (Tarjan 1972).

    The names of a set are sorted; a name with an edge to itself alone is a set of one.
    """
    sources, _ = _neighbours(names, edges)
    number: dict[str, int] = {}
    lowest: dict[str, int] = {}
    stack: list[str] = []
    waiting: set[str] = set()  # those on the stack
    found: list[tuple[str, ...]] = []
    for root in sorted(sources):
        path = [(root, iter(sorted(sources[root])))] if root not in number else []
        while path:
            name, waits = path[-1]
            if name not in number:
                number[name] = lowest[name] = len(number)
                stack.append(name)
                waiting.add(name)
            for other in waits:
                if other not in number:
                    path.append((other, iter(sorted(sources[other]))))
                    break
                if other in waiting:
                    lowest[name] = min(lowest[name], number[other])
            else:
                path.pop()
                if path:
                    above = path[-1][0]
                    lowest[above] = min(lowest[above], lowest[name])
                if lowest[name] == number[name]:
                    place = stack.index(name)
                    found.append(tuple(sorted(stack[place:])))
                    waiting.difference_update(stack[place:])
                    del stack[place:]
    return found


def _neighbours(
    names: Iterable[str], edges: Iterable[Edge]
) -> tuple[dict[str, set[str]], Mapping[str, set[str]]]:
    """(the components for which each waits, those that wait for each), among `names`."""
    sources: dict[str, set[str]] = {name: set() for name in names}
    targets: defaultdict[str, set[str]] = defaultdict(set)
    for a, b in edges:
        if a in sources and b in sources:
            sources[b].add(a)
            targets[a].add(b)
    return sources, targets


def _cycle(sources: Mapping[str, set[str]]) -> tuple[str, ...]:
    """Walk backwards from the first that waits until one repeats."""
    walk = [min(sources)]
    place = {walk[0]: 0}
    while True:
        name = min(s for s in sources[walk[-1]] if s in sources)
        walk.append(name)
        if name in place:
            return tuple(walk[place[name] :][::-1])
        place[name] = len(walk) - 1
