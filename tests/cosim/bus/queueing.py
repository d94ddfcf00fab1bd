"""A bus without errors whose queues are never full: the oracle of the response times.

A node takes part with its most urgent frame or (``fifo``) with its oldest request.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from cosim.bus.timing import TimingError


@dataclass(frozen=True, slots=True)
class PendingFrame:
    """A frame that waits from `at` ns on and takes `duration` ns, intermission included."""

    at: int
    rank: int
    duration: int
    node: int = 0


@dataclass(frozen=True, slots=True)
class Sent:
    """A request, when its frame began, and when the next could begin, ns.

    Receivers have the frame three bits before `end`, at the end of EOF.
    """

    request: PendingFrame
    start: int
    end: int


def arbitrate(requests: Iterable[PendingFrame], *, fifo: bool = False) -> list[Sent]:
    """All frames in the order of sending; of equal ranks of one node, the oldest request first.

    Raises TimingError if frames of equal rank of two nodes compete: on a bus they collide with bit
    errors, which `cosim.bus.simulation` simulates.
    """
    coming = sorted(requests, key=lambda r: r.at)
    waiting: list[PendingFrame] = []
    sent: list[Sent] = []
    now = 0
    while coming or waiting:
        now = max(now, waiting[0].at if waiting else coming[0].at)
        while coming and coming[0].at <= now:
            waiting.append(coming.pop(0))
        heads = _heads(waiting) if fifo else waiting
        first = min(heads, key=lambda r: r.rank)
        if any(r.rank == first.rank and r.node != first.node for r in heads):
            raise TimingError(
                f"found rank {first.rank} at two nodes at {now} ns, expected one node"
            )
        waiting.remove(first)
        sent.append(Sent(first, now, now + first.duration))
        now += first.duration
    return sent


def _heads(waiting: list[PendingFrame]) -> list[PendingFrame]:
    """The oldest request of each node, from requests in the order of queueing."""
    heads: dict[int, PendingFrame] = {}
    for request in waiting:
        heads.setdefault(request.node, request)
    return list(heads.values())
