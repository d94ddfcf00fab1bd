"""Operations in segments that are due together, and which parts of a segment threads may share.

A segment is a run of operations with the same period and phase. Its blocks are the operations of
one component each. If no block reads what another one writes, it makes no difference in which order
they are executed, or by whom.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from cosim.native.structs import Code
from cosim.schedule.operations import Operation
from cosim.schedule.parts import Step

#: Operations that stand alone: they concern all signals, or what is outside of the plan.
ALONE = frozenset({Code.RECORD, Code.GATE})
#: Operations that read signals, at `source`.
READING = frozenset({
    Code.COPY, Code.SCALE, Code.PUSH, Code.AHEAD, Code.BETWEEN, Code.SLOPE_AHEAD,
    Code.SLOPE_BETWEEN,
})  # fmt: skip


@dataclass(frozen=True, slots=True)
class Segment:
    """Operations from `first` to before `last`, due at ticks `start`, `start + period`, ...

    `blocks`: where its blocks begin, and where the last one ends; `independent`: no block reads
    what another one writes, if what travels over each of `links` takes at least a tick.
    """

    first: int
    last: int
    period: int
    start: int
    blocks: tuple[int, ...]
    independent: bool
    links: tuple[int, ...] = ()


def segments(operations: Sequence[Operation], components: Sequence[Step]) -> tuple[Segment, ...]:
    """All segments of a tick, in order, for threads. A component has one block in each."""
    owners = _Owners(components)
    found = []
    for first, last in _runs(operations, owners):
        blocks = [first]
        for i in range(first + 1, last):
            if owners.of(operations[i]) != owners.of(operations[i - 1]):
                blocks.append(i)
        independent, waiting = _dependence(operations[first:last], owners)
        op = operations[first]
        found.append(
            Segment(first, last, op.period, op.first, (*blocks, last), independent, waiting)
        )
    return tuple(found)


def due_together(operations: Sequence[Operation]) -> tuple[Segment, ...]:
    """Segments for one thread: consecutive operations with the same period and phase."""
    starts = [
        i for i, op in enumerate(operations)
        if i == 0 or (op.period, op.first) != (operations[i - 1].period, operations[i - 1].first)
    ]  # fmt: skip
    ends = [*starts[1:], len(operations)]
    return (
        tuple(
            Segment(
                first, last, operations[first].period, operations[first].first, (first, last), False
            )
            for first, last in zip(starts, ends, strict=True)
        )
        if starts
        else ()
    )


class _Owners:
    """The component to which an operation belongs: that of its input, or of the output it sends."""

    def __init__(self, components: Sequence[Step]) -> None:
        slots = sorted(
            (slot.start, i) for i, c in enumerate(components) for slot in (*c.inputs, *c.outputs)
        )
        self._starts = [start for start, _ in slots]
        self._owners = [i for _, i in slots]

    def at(self, signal: int) -> int:
        """Of an entry of the signal vector."""
        return self._owners[bisect_right(self._starts, signal) - 1]

    def of(self, op: Operation) -> int:
        """Its number; -1: of none."""
        if op.code in ALONE:
            return -1
        if op.code is Code.STEP:
            return op.index
        return self.at(op.source if op.code is Code.PUSH else op.target)


def _runs(operations: Sequence[Operation], owners: _Owners) -> Iterator[tuple[int, int]]:
    """(first, behind the last) of each segment."""
    first, seen, before = 0, set[int](), -1
    for i, op in enumerate(operations):
        owner = owners.of(op)
        head = operations[first]
        another = (op.period, op.first) != (head.period, head.first)
        alone = op.code in ALONE or head.code in ALONE
        if i > first and (another or alone or (owner != before and owner in seen)):
            yield first, i
            first, seen = i, set()
        seen.add(owner)
        before = owner
    if operations:
        yield first, len(operations)


def _dependence(operations: Sequence[Operation], owners: _Owners) -> tuple[bool, tuple[int, ...]]:
    """Whether blocks are independent, and the links that then have to take at least a tick."""
    stepped = {op.index for op in operations if op.code is Code.STEP}
    pushed = {op.index for op in operations if op.code is Code.PUSH}
    waiting = tuple(op.index for op in operations if op.code is Code.PULL and op.index in pushed)
    for op in operations:
        if op.code in ALONE:
            return False, ()
        if op.code in READING:
            source = owners.at(op.source)
            if source in stepped and source != owners.of(op):
                return False, ()
    return True, waiting
