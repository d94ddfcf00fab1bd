"""Parts of a plan that reach each other over links only, and may run apart for some ticks.

A part needs nothing of the others that is newer than the least delay of the links between them: the
look-ahead of conservative parallel simulation (Chandy and Misra 1979; Fujimoto 2000, ch. 3).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cosim.base.copies import replace
from cosim.native.enums import Code
from cosim.schedule.plan import Plan

#: Instead of the component that owns an operation: every part does it, or none.
EVERY, NONE = -1, -2
Numbers = NDArray[np.int64]


@dataclass(frozen=True)
class PlanParts:
    """Parts, numbered in order of their first components, and the links between them.

    `part_of` (components,): the part of each. `owners` (operations,): the component to which each
    operation of the plan belongs, or :data:`EVERY`, as RECORD, or :data:`NONE`. `late`
    (components,): whether its signals are written after RECORD in a tick. `second`: where wires
    connect parts, the first operation of the second stage of a tick, which computes what these
    wires carry; else None.
    """

    part_of: Numbers
    owners: Numbers
    links: tuple[int, ...]
    late: NDArray[np.bool_]
    second: int | None = None

    @property
    def count(self) -> int:
        """The number of parts."""
        return int(self.part_of.max()) + 1

    @cached_property
    def operations(self) -> tuple[Numbers, Numbers]:
        """Pairs (number of the part, an operation of the plan), part by part, (n,) each."""
        own, every = np.flatnonzero(self.owners >= 0), np.flatnonzero(self.owners == EVERY)
        parts = np.arange(self.count)
        part = np.r_[self.part_of[self.owners[own]], np.tile(parts, len(every))]
        place = np.r_[own, np.repeat(every, self.count)]
        order = np.lexsort((place, part))
        return part[order], place[order]

    @property
    def ends(self) -> Numbers:
        """The end of each part among :attr:`operations`, (parts,)."""
        return np.cumsum(np.bincount(self.operations[0], minlength=self.count))

    def merged(self, count: int, alone: int) -> PlanParts:
        """`count` consecutive parts as one, each; but the first `alone` stay as they are."""
        later = self.part_of >= alone
        part_of = np.where(later, alone + (self.part_of - alone) // count, self.part_of)
        return replace(self, part_of=part_of)


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
    roots = parts.roots()
    if together:
        roots[roots == roots[first]] = -1
    _, part_of = np.unique(roots, return_inverse=True)
    if not part_of.any():
        return None
    source, target = (
        part_of[np.array([number[slot.component] for slot in slots], np.int64)]
        for slots in ([x.source for x in plan.links], [x.target for x in plan.links])
    )
    return PlanParts(
        part_of,
        _owners(plan),
        tuple(np.flatnonzero(source != target).tolist()),
        np.array([c.name not in now for c in plan.components]),
        _second(plan) if staged else None,
    )


def _second(plan: Plan) -> int:
    """The first step over an interval, with which the second stage of a tick begins."""
    record = next(i for i, op in enumerate(plan.operations) if op.code == Code.RECORD)
    stepping = (Code.STEP, Code.MACRO)
    steps = (i for i, op in enumerate(plan.operations) if i > record and op.code in stepping)
    return next(steps, len(plan.operations))


def _owners(plan: Plan) -> Numbers:
    """The component of each operation: that of its input, or of the output it sends."""
    first = [(s.start, i) for i, c in enumerate(plan.components) for s in (*c.inputs, *c.outputs)]
    starts, of = np.array(sorted(first), np.int64).reshape(-1, 2).T
    owners = np.full(len(plan.operations), EVERY)
    lying, signals = list[int](), list[int]()
    for i, op in enumerate(plan.operations):
        if op.code == Code.STEP:
            owners[i] = op.index
        elif op.code == Code.MACRO:
            owners[i] = plan.groups[op.index].components[0]
        elif op.code != Code.RECORD:
            lying.append(i)
            signals.append(op.source if op.code == Code.PUSH else op.target)
    owners[lying] = of[np.searchsorted(starts, signals, side="right") - 1]
    return owners


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

    def roots(self) -> Numbers:
        """The least number in the set of each, (n,)."""
        return np.array([self._root(i) for i in range(len(self._parent))], np.int64)
