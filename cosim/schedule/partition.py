"""Parts of a plan that reach each other over links only, and may run apart for some ticks.

A part needs nothing of the others that is newer than the least delay of the links between them: the
look-ahead of conservative parallel simulation (Chandy and Misra 1979; Fujimoto 2000, ch. 3).
"""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from cosim.native.structs import Code
from cosim.schedule.operations import Operation
from cosim.schedule.plan import Plan


@dataclass(frozen=True, slots=True)
class PlanParts:
    """Parts by their components, in order of the first, and the links between them.

    `operations`: of each part, those of the plan; every part has RECORD. `late`: components whose
    signals are written after it in a tick. `second`: where wires connect parts, the first operation
    of the second stage of a tick, which computes what these wires carry; else None.
    """

    components: tuple[tuple[int, ...], ...]
    operations: tuple[tuple[int, ...], ...]
    links: tuple[int, ...]
    late: frozenset[int]
    second: int | None = None


def partition(
    plan: Plan, together: Collection[int] = (), *, staged: bool = False
) -> PlanParts | None:
    """The smallest parts, or None if there is only one.

    Components are in one part if a wire connects them, or a link that may take no time; those of
    `together` are in one, too, which is then the first. A plan with gates is one part: what passes
    them is not in the plan. `staged`: a wire does not make one part of its ends where it carries
    what was computed at the end of an interval, and a tick has two stages.
    """
    if plan.gates or len(plan.components) < 2:
        return None
    parts = _Sets(len(plan.components))
    number = {c.name: i for i, c in enumerate(plan.components)}
    now = frozenset(plan.order)
    for w in plan.wires:
        if staged and w.source.component not in now and plan.algorithm != "gauss-seidel":
            continue
        parts.join(number[w.source.component], number[w.target.component])
    for group in plan.groups:
        for i in group.components[1:]:
            parts.join(group.components[0], i)
    for x in plan.links:
        if x.table.minimum_delay_ticks < 1:
            parts.join(number[x.source.component], number[x.target.component])
    first, *others = sorted(together) or [0]
    for other in others:
        parts.join(first, other)
    groups = parts.groups()
    if len(groups) < 2:
        return None
    if together:
        groups.sort(key=lambda group: first not in group)
    part_of = {i: k for k, group in enumerate(groups) for i in group}
    ends = [(part_of[number[x.source.component]], part_of[number[x.target.component]])
            for x in plan.links]  # fmt: skip
    operations: list[list[int]] = [[] for _ in groups]
    owners = _Owners(plan)
    for i, op in enumerate(plan.operations):
        if op.code == Code.RECORD:
            for part in operations:
                part.append(i)
        else:
            operations[part_of[owners.of(op)]].append(i)
    return PlanParts(
        tuple(map(tuple, groups)),
        tuple(map(tuple, operations)),
        tuple(i for i, (a, b) in enumerate(ends) if a != b),
        frozenset(i for i, c in enumerate(plan.components) if c.name not in now),
        _second(plan) if staged else None,
    )


def merged(parts: PlanParts, count: int, alone: int) -> PlanParts:
    """`count` consecutive parts as one, each; but the first `alone` stay as they are."""
    n = len(parts.components)
    groups = [range(i, i + 1) for i in range(alone)]
    groups += [range(i, min(i + count, n)) for i in range(alone, n, count)]

    def union(entries: Sequence[tuple[int, ...]]) -> tuple[tuple[int, ...], ...]:
        return tuple(tuple(sorted({i for k in group for i in entries[k]})) for group in groups)

    return replace(parts, components=union(parts.components), operations=union(parts.operations))


def _second(plan: Plan) -> int:
    """The first step over an interval, with which the second stage of a tick begins."""
    record = next(i for i, op in enumerate(plan.operations) if op.code == Code.RECORD)
    stepping = (Code.STEP, Code.MACRO)
    steps = (i for i, op in enumerate(plan.operations) if i > record and op.code in stepping)
    return next(steps, len(plan.operations))


class _Owners:
    """The component to which an operation belongs: that of its input, or of the output it sends."""

    def __init__(self, plan: Plan) -> None:
        self._groups = plan.groups
        slots = sorted(
            (slot.start, i)
            for i, c in enumerate(plan.components)
            for slot in (*c.inputs, *c.outputs)
        )
        self._starts = [start for start, _ in slots]
        self._owners = [i for _, i in slots]

    def of(self, op: Operation) -> int:
        """Its number."""
        if op.code == Code.STEP:
            return op.index
        if op.code == Code.MACRO:
            return self._groups[op.index].components[0]
        signal = op.source if op.code == Code.PUSH else op.target
        return self._owners[bisect_right(self._starts, signal) - 1]


class _Sets:
    """Disjoint sets of the numbers below n (Tarjan 1975)."""

    def __init__(self, n: int) -> None:
        self._parent = list(range(n))

    def join(self, a: int, b: int) -> None:
        """Make one set of those of `a` and `b`."""
        low, high = sorted((self._root(a), self._root(b)))
        self._parent[high] = low

    def _root(self, i: int) -> int:
        while self._parent[i] != i:
            self._parent[i] = self._parent[self._parent[i]]
            i = self._parent[i]
        return i

    def groups(self) -> list[list[int]]:
        """All sets, sorted."""
        found: defaultdict[int, list[int]] = defaultdict(list)
        for i in range(len(self._parent)):
            found[self._root(i)].append(i)
        return list(found.values())
