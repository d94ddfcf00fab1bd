"""Rings of processes at 200 Hz, ours next to bare zenoh: a part of ``zenoh_latency.py``.

Node i hears node i - 1; every node has a session with every other, as in our deployments. Ours: a
`ZenohAttachment` and a tick in C, without components, journal or heartbeats. Bare zenoh: a loop in
Python, the same configuration and QoS, a default call-back. Ticks are spread over the period, so
that what a node holds is about half a period old where nothing takes time.
"""

from __future__ import annotations

import ctypes as c
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from math import gcd
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

import numpy as np
import zenoh

from benchmarks import tables
from benchmarks.zenoh_far import (
    ROW,
    Far,
    everybody,
    free_ports,
    obey,
    options,
    pointer,
    prefer,
    tick_library,
)
from bridge.deployment.zenoh_keys import Names, codec
from bridge.native import pace
from bridge.realtime.requests import Realtime, enter
from bridge.zenoh.channel import ZenohAttachment, ZenohTraffic, control_publisher
from bridge.zenoh.session import configure
from cosim.base.clock import monotonic_ns, sleep

RATE = 200
KINDS = ("ours", "bare zenoh")
NAMES = Names("ring")
NUMBERS = (0x1000, 0x1001)  # said, heard
LEAD_NS = 300_000_000


def key(i: int) -> str:
    return NAMES.message(f"n{i}", "component", "m")


class _Node:
    """Node i of a ring: `ready`, then `run`."""

    def __init__(self, i: int, ports: list[int], path: str) -> None:
        self.i, self.n = i, len(ports)
        self.before = (i - 1) % self.n
        self.options = options(ports[i : i + 1], ports[:i])
        self.memory = 0.0  # MB, when it is ready

    def _ticks(self, start_ns: int, period: int, n: int) -> tuple[Any, int]:
        """Rows of ``tick_t`` (n, 5), and how many samples came."""
        raise NotImplementedError

    def run(self, start_ns: int, n: int) -> dict[str, float]:
        """Tick `n` times; what it cost and how old what it held was."""
        period = 10**9 // RATE
        start_ns += period * (stride(self.n) * self.i % self.n) // self.n
        cpu, began = time.process_time(), time.monotonic()
        ticks, came = self._ticks(start_ns, period, n)
        busy = (time.process_time() - cpu) / (time.monotonic() - began)
        late, paid, number, sent, arrived = ticks[n // 10 :].T / 1e3
        woke = start_ns / 1e3 + period / 1e3 * np.arange(n // 10, n) + late
        late50, late99 = np.percentile(late, [50, 99])
        way50, way99 = np.percentile((arrived - sent)[number >= 0], [50, 99])
        age50, age99 = np.percentile((woke - sent)[number >= 0], [50, 99])
        return {
            "late_p50": late50, "late_p99": late99, "way_p50": way50, "way_p99": way99,
            "age_p50": age50, "age_p99": age99, "paid": float(np.median(paid)),
            "unheard": n - came, "cpu": 100 * busy, "memory": self.memory,
        }  # fmt: skip


class _Ours(_Node):
    """A node's end of a bus, ticks in C."""

    def __init__(self, i: int, ports: list[int], path: str) -> None:
        super().__init__(i, ports, path)
        said, heard = key(i), key(self.before)
        peers = tuple(f"n{k}" for k in range(self.n) if k != i)
        traffic = ZenohTraffic(f"n{i}", {said: NUMBERS[0]}, {heard: NUMBERS[1]}, peers, (said,))
        self._said, self._heard = (
            codec(k, number, ("number", "sent", "x", "y"))
            for k, number in zip((said, heard), NUMBERS, strict=True)
        )
        self._end = ZenohAttachment("net", NAMES, traffic, self.options)
        self._lib = tick_library(path)

    def ready(self) -> None:
        self._end.wait_for_peers()
        self.memory = memory()
        self._granted = enter(Realtime(priority=0))  # locks all memory, stacks too

    def _ticks(self, start_ns: int, period: int, n: int) -> tuple[Any, int]:
        ticks = np.zeros((n, 5), np.int64)
        came = self._lib.tick_run(
            c.byref(self._end.bus.struct), c.byref(self._heard.message),
            c.byref(self._said.message), c.c_int64(start_ns), c.c_int64(period), c.c_int64(n),
            pointer(ticks),
        )  # fmt: skip
        return ticks, came

    def close(self) -> None:
        self._granted.leave()
        self._end.close()


class _Bare(_Node):
    """As one writes it with zenoh-python."""

    def __init__(self, i: int, ports: list[int], path: str) -> None:
        super().__init__(i, ports, path)
        self._session = zenoh.open(configure(self.options, f"n{i}"))
        self._publisher = control_publisher(self._session, key(i), "best-effort")
        self._newest: tuple[int, ...] = (-1, 0, 0)
        self._came = 0
        self._session.declare_subscriber(key(self.before), self._hear)

    def _hear(self, sample: zenoh.Sample) -> None:
        self._newest = (*ROW.unpack(sample.payload.to_bytes()), monotonic_ns())
        self._came += 1

    def ready(self) -> None:
        while not getattr(self._publisher.matching_status, "matching", False):
            sleep(0.01)
        self.memory = memory()

    def _ticks(self, start_ns: int, period: int, n: int) -> tuple[Any, int]:
        ticks = []
        for k in range(n):
            woke = pace.wait(start_ns + k * period)
            held, before = self._newest, monotonic_ns()
            self._publisher.put(ROW.pack(k, before))
            ticks.append((woke - start_ns - k * period, monotonic_ns() - before, *held))
        return np.array(ticks), self._came

    def close(self) -> None:
        self._session.close()  # type: ignore[no-untyped-call]


def stride(n: int) -> int:
    """The next node's tick is this many n-ths of a period later: about the half, all different."""
    return next(s for s in range(max(1, n // 2), n + 1) if gcd(s, n) == 1)


def memory() -> float:
    """MB of this process, what it shares with others divided among them."""
    lines = Path("/proc/self/smaps_rollup").read_text(encoding="utf-8").splitlines()
    return float(next(line.split()[1] for line in lines if line.startswith("Pss:"))) / 1024


# ---- all of them ---------------------------------------------------------------------------------


def ring(kind: str, n: int, path: Path, seconds: float, priority: int) -> dict[str, Any]:
    """One run of one ring: medians of the nodes, the worst node's p99, the sum of what was lost."""
    ports = free_ports(n)
    with ExitStack() as stack:
        nodes = []
        for i in range(n):
            given = (kind, str(i), str(path), str(priority), *map(str, ports))
            nodes.append(Far(f"{kind}, node {i}", "zenoh_ring.py", *given))
            stack.callback(nodes[-1].close)
        everybody(nodes, "ready")
        start = monotonic_ns() + LEAD_NS
        found = everybody(nodes, "run", start, round(seconds * RATE))
    worst = {"late_p99", "way_p99", "age_p99"}
    row = {k: (max if k in worst else np.median)([f[k] for f in found]) for k in found[0]}
    row["unheard"] = sum(max(0, f["unheard"] - 1) for f in found)  # the last one's still to come
    nominal = 1e6 / RATE * stride(n) / n
    return {"kind": kind, "nodes": n, "nominal": nominal, **{k: float(v) for k, v in row.items()}}


def measure(
    path: Path, counts: list[int], blocks: int, seconds: float, priority: int
) -> list[dict[str, Any]]:
    """Medians of blocks, the kinds in turns."""
    rows = []
    for n in counts:
        got: dict[str, list[dict[str, Any]]] = {kind: [] for kind in KINDS}
        for _ in range(blocks):
            for kind in KINDS:
                got[kind].append(ring(kind, n, path, seconds, priority))
        for kind, found in got.items():
            numbers = {k: float(np.median([f[k] for f in found])) for k in found[0] if k != "kind"}
            rows.append({"kind": kind, **numbers, "blocks": found})
    return rows


def report(rows: list[dict[str, Any]]) -> Iterator[str]:
    """One table."""
    header = [f"ring at {RATE} Hz", "nodes", "one way p50 / p99, us", "late p50 / p99, us",
              "age p50 / p99 (nominal), ms", "publishing, us", "not heard", "CPU of a node, %",
              "memory of a node, MB"]  # fmt: skip
    yield tables.grid(header, [
        [r["kind"], f"{r['nodes']:.0f}", f"{r['way_p50']:.0f} / {r['way_p99']:.0f}",
         f"{r['late_p50']:.0f} / {r['late_p99']:.0f}",
         f"{r['age_p50'] / 1e3:.2f} / {r['age_p99'] / 1e3:.2f} ({r['nominal'] / 1e3:.2f})",
         f"{r['paid']:.1f}", f"{r['unheard']:.0f}", f"{r['cpu']:.1f}", f"{r['memory']:.0f}"]
        for r in rows
    ])  # fmt: skip


def main() -> None:
    kind, number, path, priority, *ports = sys.argv[1:]
    prefer(int(priority))
    made = _Ours if kind == "ours" else _Bare
    obey(made(int(number), [int(port) for port in ports], path))


if __name__ == "__main__":
    main()
