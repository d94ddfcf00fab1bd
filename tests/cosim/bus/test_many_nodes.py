"""Arbitration among many nodes, beside a plain search for the next frame."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from cosim.bus.frames import REQUEST, BusEvent
from cosim.bus.settings import BusNodeSettings, QueueKind
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import BusTiming, frame_bits

BIT_PS, COUNT = 1_000_000, 200


def next_frames(rows: NDArray[np.void], queue: QueueKind) -> list[tuple[int, int]]:
    """The number of each request in the order in which frames are sent, and the time of its EOF."""
    left = list(range(len(rows)))
    free, found = 0, []
    while left:
        start = max(free, min(int(rows["at"][k]) for k in left))
        heads: dict[int, int] = {}
        for k in left:
            node = int(rows["node"][k])
            if rows["at"][k] > start or (node in heads and queue is QueueKind.FIFO):
                continue
            if node not in heads or rows["frame"]["id"][k] < rows["frame"]["id"][heads[node]]:
                heads[node] = k
        best = min(heads.values(), key=lambda k: int(rows["frame"]["id"][k]))
        left.remove(best)
        frame = rows["frame"][best]
        bits = int(frame_bits(int(frame["id"]), bytes(frame["data"][:2])).nominal)
        found.append((best, start + (bits - 3) * BIT_PS))
        free = start + bits * BIT_PS
    return found


@pytest.mark.parametrize("queue", [QueueKind.FIFO, QueueKind.SORTED])
@pytest.mark.parametrize("nodes", [2, 3, 7, 64, 65, 128])
@pytest.mark.parametrize("at_once", [False, True])
def test_the_order_of_frames_is_that_of_a_plain_search(
    nodes: int, queue: QueueKind, at_once: bool
) -> None:
    random = np.random.default_rng(nodes)
    rows = np.zeros(COUNT, REQUEST)
    rows["at"] = np.sort(random.integers(0, 1 if at_once else COUNT * 80, COUNT)) * BIT_PS
    rows["node"] = random.integers(0, nodes, COUNT)
    rows["frame"]["id"] = random.integers(0, 2048 // nodes, COUNT) * nodes + rows["node"]
    rows["frame"]["length"] = 2
    rows["frame"]["data"][:, :2] = random.integers(0, 256, (COUNT, 2))
    settings = [
        BusNodeSettings(f"n{i}", queue=queue, queue_length=COUNT, inbox=COUNT) for i in range(nodes)
    ]
    bus = SimulatedBus(BusTiming(1e6), settings, record=[BusEvent.SENT])
    bus.request_many(rows)
    events = bus.advance(COUNT * 200 * BIT_PS)
    seen = list(zip(events["request"].tolist(), events["time"].tolist(), strict=True))
    assert seen == next_frames(rows, queue)
