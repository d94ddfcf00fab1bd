"""Journals of nodes -> a run folder like that of an offline run, with bus logs and link tables.

Signals are on the base tick of the scenario: values that a node computed in a slot hold until its
next slot, and the last values of a node that has ended remain.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from bridge.can.log import FrameLog, merge_node_logs, write_log
from bridge.deployment.cut import NodePlan
from bridge.deployment.system import System
from bridge.native.journal import Journal
from bridge.records.node_lives import Life, frame_files, lives_of
from bridge.wiring.wiring import Rows
from cosim.engine.simulate import columns
from cosim.links.semantics import Grid
from cosim.links.storage import TableWriter
from cosim.links.table import LinkStatistics, statistics
from cosim.record import Recorder, link_file
from cosim.schedule.parts import Link

#: The folder of bus logs in a run folder.
BUSES = "buses"
#: Base ticks worked on at once.
CHUNK = 8192
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Collected:
    """The collected data: base ticks, ages of what links held, and the log of each bus."""

    ticks: int
    ages: Mapping[str, LinkStatistics]
    logs: Mapping[str, FrameLog]


def collect(
    system: System,
    rows: Mapping[Life, Rows],
    nodes: Path,
    into: Path,
    *,
    wall_ns: int,
    formats: tuple[str, ...] = ("log",),
) -> Collected:
    """Write trajectories, link tables and bus logs of the lives in `nodes` into the folder `into`.

    `rows`: the rows (slots,) of each life. `wall_ns`: offset from frame times to the wall clock,
    ns. Raises RunError if a file cannot be written.
    """
    ticks = write_trajectories(system, rows, into)
    ages = write_tables(system, rows, into)
    logs = bus_logs(system, nodes)
    write_bus_logs(logs, into / BUSES, formats, wall_ns)
    return Collected(ticks, ages, logs)


def write_trajectories(system: System, rows: Mapping[Life, Rows], folder: Path) -> int:
    """Write ``trajectories.parquet`` with outputs and received inputs; return its number of ticks.

    `rows`: the rows (slots,) of each life. The file ends with the last slot of any node and
    contains the signals of the nodes that ran. Raises RunError if the file cannot be written.
    """
    plan, scenario = system.plan, system.scenario
    parts = [
        (_JoinedLives(rows, name, node.ticks), *places(system, node))
        for name, node in system.nodes.items()
        if lives_of(rows, name)
    ]
    known = {int(i) for _, whole, _ in parts for i in whole}
    recorded = [c for c in columns(plan, scenario.run.record.signals) if c.index in known]
    ticks = min(plan.ticks, max(int(joined.at[-1]) for joined, _, _ in parts) + 1)
    with Recorder(
        folder,
        recorded,
        h=plan.h,
        every=scenario.run.record.every,
        rows_per_chunk=CHUNK,
        n_signals=plan.n_signals,
        ticks=ticks,
    ) as recorder:
        for first in range(0, ticks, CHUNK):
            n = min(CHUNK, ticks - first)
            buffer = recorder.buffer()
            buffer[:n] = 0.0
            for joined, whole, own in parts:
                buffer[:n, whole] = joined.signals(first, n)[:, own]
            recorder.submit(buffer, first, n)
    return ticks


@final
class _JoinedLives:
    """The signals of all lives of a node, whose slots are `ticks` base ticks long.

    `at` (slots,): the base tick of each row.
    """

    def __init__(self, rows: Mapping[Life, Rows], node: str, ticks: int) -> None:
        self._lives = [rows[life] for life in lives_of(rows, node)]
        self.at: IntArray = ticks * np.concatenate([life["slot"] for life in self._lives])

    def signals(self, first: int, n: int) -> NDArray[np.float64]:
        """The signals (n, signals) at `n` base ticks: those of the last slot that has begun."""
        places = np.searchsorted(self.at, np.arange(first, first + n), side="right") - 1
        places, begin = np.maximum(places, 0), 0
        found = []
        for life in self._lives:
            mine = places[(places >= begin) & (places < begin + len(life))] - begin
            found.append(life["signals"][mine])
            begin += len(life)
        return np.concatenate(found)


def places(system: System, node: NodePlan) -> tuple[IntArray, IntArray]:
    """Return the indices (n,) of the node's signals in the whole plan's vector and in its own."""
    whole, own = system.plan.slots(), node.plan.slots()
    pairs = [
        (whole[name].start + i, slot.start + i)
        for name, slot in own.items()
        for i in range(slot.size)
    ]
    found = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return found[:, 0], found[:, 1]


# ---- links ----------------------------------------------------------------------------------


def at_hits(
    system: System,
    rows: Mapping[Life, Rows],
    node: str,
    ticks: int,
    of: Callable[[Rows], NDArray[Any]],
    before: float,
) -> NDArray[Any]:
    """The values of `of` in a node's rows, (rows,), at each hit of a component, (hits,).

    `ticks`: base ticks between two hits. Hits without a row (a node that was dead) have what was
    there before them, at first `before`.
    """
    every = ticks // system.nodes[node].ticks
    hits = -(-system.plan.ticks // ticks)
    known = np.zeros(hits, bool)
    found = np.full(hits, before)
    for life in lives_of(rows, node):
        slots = rows[life]["slot"]
        due = slots % every == 0
        at = slots[due] // every
        found[at], known[at] = of(rows[life])[due], True
    return found[np.maximum.accumulate(np.where(known, np.arange(hits), 0))]


def held_samples(system: System, rows: Mapping[Life, Rows], link: Link) -> IntArray | None:
    """The sent sample a link's receiver held at each of its hits, (hits,); None: not crossing."""
    for name, node in system.nodes.items():
        for i, inlet in enumerate(node.inlets):
            if inlet.link is None or inlet.link.name != link.name:
                continue

            def held_of(found: Rows, i: int = i) -> NDArray[Any]:
                return np.asarray(found["inlets"]["held"][:, i])

            held = at_hits(system, rows, name, inlet.ticks, held_of, -1)
            period = system.messages[inlet.message].outlet.period
            return np.where(held < 0, -1, held * period)
    return None


def write_tables(
    system: System, rows: Mapping[Life, Rows], folder: Path
) -> dict[str, LinkStatistics]:
    """Store the tables of the links that cross cuts, for offline replay; return their statistics.

    `rows`: the rows (slots,) of each life.
    """
    found: dict[str, LinkStatistics] = {}
    d = system.deployment
    recorded = {"deployment": d.name, "latency": d.latency}  # held is the network's work as well
    for link in system.plan.links:
        held = held_samples(system, rows, link)
        if held is None:
            continue
        facts = {**link.table.facts(), "recorded": recorded}
        with TableWriter(link_file(folder, link.name), facts) as writer:
            writer.write(held)
        found[link.name] = statistics(_without_future(held, link.table.grid), link.table.grid)
    return found


def _without_future(held: IntArray, grid: Grid) -> IntArray:
    """Without samples from the future, as clocks that differ make them look: of age 0 instead."""
    newest = grid.n_r * np.arange(held.size, dtype=np.int64) // grid.n_s
    return np.minimum(held, newest)


# ---- buses ----------------------------------------------------------------------------------


def bus_logs(system: System, nodes: Path) -> dict[str, FrameLog]:
    """The frames on each CAN bus, by time: those sent by nodes, and those received from others."""
    logs: dict[str, FrameLog] = {}
    for name, bus in system.deployment.buses.items():
        files = list(frame_files(nodes, name).values())
        if bus.kind != "can" or not files:
            continue
        rows = merge_node_logs([Journal.open(path) for path in files])
        rows["bus"] = 0
        logs[name] = FrameLog(rows, (_channel(bus, name),))
    return logs


def _channel(bus: object, name: str) -> str:
    return getattr(bus, "channel", "") or name


def write_bus_logs(
    logs: Mapping[str, FrameLog], folder: Path, formats: tuple[str, ...], wall_ns: int
) -> list[Path]:
    """Write each bus's log as ``FOLDER/BUS.FORMAT`` (log, blf, asc, mf4); returns the files."""
    if logs and formats:
        folder.mkdir(exist_ok=True)
    paths = []
    for name, log in logs.items():
        for suffix in formats:
            path = folder / f"{name}.{suffix}"
            write_log(log, path, wall_ns)
            paths.append(path)
    return paths
