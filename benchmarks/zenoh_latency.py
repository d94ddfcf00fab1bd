"""Our Zenoh channel, bare zenoh-python, UDP and ZeroMQ: there and back, one way, and in rings.

    python benchmarks/zenoh_latency.py [--quick] [--json FILE] [--blocks N] [--count N]
                                       [--seconds S] [--nodes N ...] [--priority P]

Each kind has two processes of its own on the loopback interface, which live to the end; the kinds
run a short block each, in turns. A message has 56 bytes and carries when it was sent. Ours is from
a tick in C to a tick in C: codec, CRC, rings, a sending thread, a call-back (`zenoh_ends.py`). Bare
zenoh has our configuration and QoS. Rings: `zenoh_ring.py`. Nothing else should run meanwhile.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

import numpy as np

from benchmarks import tables, zenoh_ring
from benchmarks.zenoh_ends import KINDS
from benchmarks.zenoh_far import Far, build, everybody, free_ports, quantiles
from cosim.base.clock import sleep

RATES = (200, 1000)
BARE = ("zenoh, default call-back", "zenoh, direct call-back")
ROUND_TRIP = "round trip"
Numbers = dict[str, float]


@dataclass(frozen=True)
class Pair:
    """Two ends of a kind."""

    near: Far
    far: Far

    def round_trips(self, n: int) -> Numbers:
        """Of n pings, us."""
        self.far.ask("echo", True)
        try:
            taken = np.array(self.near.ask("ping", n)) / 1e3
        finally:
            self.far.ask("echo", False)
        return quantiles(taken)

    def one_way(self, rate: int, seconds: float) -> Numbers:
        """Of what is sent at a rate: how long it takes, its gaps, what publishing takes; us."""
        n = round(rate * seconds)
        self.far.ask("taken")
        paid = np.array(self.near.ask("stream", n, 10**9 // rate)) / 1e3
        sleep(0.1)
        rows = np.array(self.far.ask("taken"))
        number, sent, arrived = rows.T
        off = np.diff(arrived) / 1e3 - np.diff(number) * 1e6 / rate
        return {
            **quantiles((arrived - sent) / 1e3),
            "jitter": float(off.std()),
            "jitter p99": float(np.percentile(np.abs(off), 99)),
            "publish p50": float(np.median(paid)),
            "publish p99": float(np.percentile(paid, 99)),
            "lost": n - len(rows),
        }


@contextmanager
def pairs(path: Path, priority: int) -> Iterator[dict[str, Pair]]:
    """Every kind there is, both ends ready."""
    kinds = [kind for kind in KINDS if kind != "zeromq" or find_spec("zmq")]
    with ExitStack() as stack:
        found = {}
        for kind in kinds:
            given = [str(path), str(priority), *map(str, free_ports(3))]
            found[kind] = Pair(*(
                Far(f"{kind}, {side}", "zenoh_ends.py", kind, side, *given)
                for side in ("near", "far")
            ))  # fmt: skip
        ends = [end for pair in found.values() for end in (pair.near, pair.far)]
        for end in ends:
            stack.callback(end.close)
        everybody(ends, "ready")
        sleep(0.5)  # ZeroMQ's subscriptions travel
        yield found


def measure(found: dict[str, Pair], blocks: int, n: int, seconds: float) -> list[dict[str, Any]]:
    """Everybody, in turns."""
    got: dict[tuple[str, str], list[Numbers]] = {}
    for pair in found.values():  # what runs for the first time
        pair.round_trips(min(n, 50))
    for _ in range(blocks):
        for kind, pair in found.items():
            got.setdefault((ROUND_TRIP, kind), []).append(pair.round_trips(n))
        for rate in RATES:
            for kind, pair in found.items():
                row = pair.one_way(rate, seconds)
                got.setdefault((f"one way, {rate} Hz", kind), []).append(row)
    return [
        {
            "case": case,
            "kind": kind,
            "us": {key: median(b[key] for b in rows) for key in rows[0]},
            "blocks": rows,
        }
        for (case, kind), rows in got.items()
    ]


def report(rows: list[dict[str, Any]]) -> Iterator[str]:
    """One table a case."""
    for case in dict.fromkeys(row["case"] for row in rows):
        there = {row["kind"]: row["us"] for row in rows if row["case"] == case}
        columns = list(next(iter(there.values())))
        header = [f"{case}, us", *columns, "p50 to bare zenoh", "p99 to bare zenoh"]
        lines = [
            [kind, *(f"{us[key]:.1f}" for key in columns),
             *(" / ".join(f"{us[q] / there[bare][q]:.2f}" for bare in BARE)
               for q in ("p50", "p99"))]
            for kind, us in there.items()
        ]  # fmt: skip
        yield tables.grid(header, lines)


def versions() -> dict[str, str | None]:
    """Of what is compared."""
    found: dict[str, str | None] = {}
    for name in ("eclipse-zenoh", "pyzmq"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = None
    return found


def parser() -> argparse.ArgumentParser:
    found = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    found.add_argument("--quick", action="store_true", help="one short block of everything")
    found.add_argument("--json", type=Path, metavar="FILE", help="write all numbers here")
    found.add_argument("--blocks", type=int, default=9, help="blocks of each (default 9)")
    found.add_argument("--count", type=int, default=2000, help="round trips of a block")
    found.add_argument("--seconds", type=float, default=2.0, help="of a block one way")
    found.add_argument("--nodes", type=int, nargs="*", default=[2, 6, 20], help="of rings")
    found.add_argument("--priority", type=int, default=0, help="SCHED_FIFO for all processes")
    return found


def main() -> None:
    """Measure, print the tables, write the numbers."""
    options = parser().parse_args()
    blocks, n, seconds, nodes = options.blocks, options.count, options.seconds, options.nodes
    if options.quick:
        blocks, n, seconds, nodes = 1, 50, 0.1, [2]
    with tempfile.TemporaryDirectory(prefix="zenoh-") as folder:
        path = build(Path(folder))
        with pairs(path, options.priority) as found:
            rows = measure(found, blocks, n, seconds)
        print("medians of blocks; ratios: to bare zenoh with the default / a direct call-back\n")
        print(*report(rows), sep="\n\n", end="\n\n", flush=True)
        rings = zenoh_ring.measure(path, nodes, -(-blocks // 3), 2 * seconds, options.priority)
    if rings:
        print(*zenoh_ring.report(rings), sep="\n\n")
    if find_spec("zmq") is None:
        print("zeromq: not installed (pip install pyzmq)")
    if options.json:
        facts = {"machine": tables.machine(), "versions": versions(), "blocks": blocks, "count": n,
                 "seconds": seconds, "priority": options.priority, "rows": rows, "rings": rings,
                 }  # fmt: skip
        options.json.write_text(json.dumps(facts, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
