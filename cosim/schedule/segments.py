"""Operations in segments that are due together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from cosim.schedule.operations import Operation


class Segment(NamedTuple):
    """Operations from `first` to before `last`, due at ticks `start`, `start + period`, ..."""

    first: int
    last: int
    period: int
    start: int


def due_together(operations: Sequence[Operation]) -> list[Segment]:
    """Consecutive operations with the same period and phase, in order."""
    starts = [
        i for i, op in enumerate(operations)
        if i == 0 or (op.period, op.first) != (operations[i - 1].period, operations[i - 1].first)
    ]  # fmt: skip
    return [
        Segment(first, last, operations[first].period, operations[first].first)
        for first, last in zip(starts, [*starts[1:], len(operations)], strict=False)
    ]
