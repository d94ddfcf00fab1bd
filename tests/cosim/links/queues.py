"""Queues of all kinds, short and long."""

from __future__ import annotations

from cosim.links.semantics import QueueSemantics

QUEUES = tuple(
    QueueSemantics(depth, drop, take)
    for depth in (1, 2, 5, 1000)
    for drop in ("oldest", "newest")
    for take in ("one", "all")
)
