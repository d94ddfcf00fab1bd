"""Throughput of the simulated CAN bus in frames per second: ``python -m benchmarks.bus``.

Sixteen nodes (or `--nodes`) with sorted queues, random 11-bit identifiers that no two nodes share,
8 random bytes, exact stuffing, at 1 Mbit/s. `burst`: 8192 requests at the same time, so that all
nodes arbitrate for each frame. `load 60 %`: requests at random times. The result is the processor
time of this process in `request_many` and `advance`, without the preparation of the requests: the
median and the best of several repetitions, which take turns between the cases.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.bus_python_can import print_costs
from benchmarks.tables import machine
from cosim.bus.frames import REQUEST, BusEvent
from cosim.bus.settings import BusNodeSettings, ErrorRate
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import BusTiming

BIT_PS, MEAN_BITS = 1_000_000, 114.3
CHUNK = 8192


def requests(count: int, load: float | None, nodes: int, seed: int = 1) -> NDArray[np.void]:
    """Random requests, shape (count,); `load`: share of the bus they ask for, None: at once.

    `nodes`: a power of two, at most 1024.
    """
    random = np.random.default_rng(seed)
    rows = np.zeros(count, REQUEST)
    if load is not None:
        gaps = random.exponential(MEAN_BITS * BIT_PS / load, count)
        rows["at"] = np.cumsum(gaps).astype(np.int64)
    rows["node"] = np.arange(count) % nodes
    rows["frame"]["id"] = random.integers(0, 2048 // nodes, count) * nodes + rows["node"]
    rows["frame"]["length"] = 8
    rows["frame"]["data"][:, :8] = random.integers(0, 256, (count, 8))
    return rows


def nanoseconds(rows: NDArray[np.void], record: Sequence[BusEvent], rate: float = 0.0) -> float:
    """Processor time of a frame, ns."""
    count = int(rows["node"].max()) + 1
    nodes = [
        BusNodeSettings(f"n{i}", queue_length=2 * CHUNK // count, inbox=2 * CHUNK // count)
        for i in range(count)
    ]
    noise = [ErrorRate(rate)] if rate else []
    bus = SimulatedBus(BusTiming(1e6), nodes, record=record, disturbances=noise, seed=1)
    begin = time.process_time_ns()
    for first in range(0, len(rows), CHUNK):
        part = rows[first : first + CHUNK]
        part["at"] = np.maximum(part["at"], bus.now_ps)
        bus.request_many(part)
        burst = bus.now_ps + 120 * BIT_PS * len(part)
        bus.advance(max(int(part["at"][-1]), burst if part["at"][0] == part["at"][-1] else 0))
    while any(bus.state(i).pending for i in range(count)):
        bus.advance(bus.now_ps + 100_000 * BIT_PS)
    taken = time.process_time_ns() - begin
    assert bus.whole_frames > 0.9 * len(rows)  # the rest bit by bit: disturbed, or cut by a call
    return taken / len(rows)


def main() -> None:
    """Print the tables of docs/bus.md."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=400_000)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--nodes", type=int, nargs="+", default=[16], metavar="N")
    parser.add_argument(
        "--python-can", type=int, metavar="N", help="cost of N messages by python-can"
    )
    given = parser.parse_args()
    print(machine())
    if given.python_can:
        print_costs(given.python_can, given.repeat)
        return
    print("| traffic | events | nodes | ns per frame: median (best) | frames/s: median (best) |")
    print("|---|---|---|---|---|")
    sent, all_kinds = [BusEvent.SENT], list(BusEvent)
    cases = (
        ("load 60 %", 0.6, sent, 0.0),
        ("burst", None, sent, 0.0),
        ("load 60 %", 0.6, all_kinds, 0.0),
        ("burst", None, all_kinds, 0.0),
        ("load 60 %, bit error rate 1e-5", 0.6, sent, 1e-5),
    )
    for name, load, record, rate in cases:
        rows = {nodes: requests(given.frames, load, nodes) for nodes in given.nodes}
        times: dict[int, list[float]] = {nodes: [] for nodes in given.nodes}
        for _ in range(given.repeat):
            for nodes, found in times.items():
                found.append(nanoseconds(rows[nodes].copy(), record, rate))
        for nodes, found in times.items():
            ns, best = statistics.median(found), min(found)
            kinds = "SENT" if record is sent else "all"
            rates = f"{1e3 / ns:.2f} M ({1e3 / best:.2f} M)"
            print(f"| {name} | {kinds} | {nodes} | {ns:.0f} ({best:.0f}) | {rates} |", flush=True)


if __name__ == "__main__":
    main()
