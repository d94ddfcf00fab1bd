"""A plan in parts that may run apart, as ``partitions.c`` sees it: with operations of their own."""

from __future__ import annotations

import ctypes as c
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from cosim.base.copies import replace
from cosim.engine.arrays import LINE, Numbers, Rows, ranges, rows_of, segments, stretches
from cosim.native import enums, structs
from cosim.native.enums import Code
from cosim.schedule.partition import NONE, PlanParts, partition
from cosim.schedule.plan import Plan

#: What of an FMU may lie behind its outputs, bytes: its parameters.
BEHIND = 256
_SPAN, _PART = np.dtype(structs.SpanStruct), np.dtype(structs.PartStruct)
_RECEIVED, _COLUMNS = np.dtype(structs.ReceivedStruct), np.dtype(structs.ColumnsStruct)


class Bound(Protocol):
    """A plan as C has it, before it is divided (:class:`cosim.engine.binding.Binding`).

    `columns`: the signals in a recorded row. `sender_of` (links,): whose samples a link takes.
    """

    plan: Plan
    signals: NDArray[np.float64]
    operations: Rows
    units: c.Array[structs.UnitStruct]
    links: c.Array[structs.LinkStruct]
    senders: c.Array[structs.SenderStruct]
    sender_of: Numbers
    columns: Sequence[int]


def divide(
    plan: Plan, own: Sequence[int], threads: int, least: int, *, at_once: bool
) -> PlanParts | None:
    """Parts of a plan, if there are `least` of them.

    `own`: components that only the calling thread may step. `at_once`: some can be stepped together
    with others.
    """
    for staged in (False, True) if threads > 1 else (False,):
        found = partition(plan, own, staged=staged)
        if found and found.count >= least:
            count = min(enums.AT_ONCE, found.count // (4 * threads))
            return found.merged(count, bool(own)) if count > 1 and at_once else found
    return None


def shared_senders(plan: Plan, parts: PlanParts) -> tuple[Numbers, PlanParts]:
    """The first link that sends the same, for each link, (links,): parts send it once."""
    first = dict[tuple[Any, ...], int]()
    found = np.array([
        first.setdefault((x.source.start, x.source.size, x.gain, x.offset), i)
        for i, x in enumerate(plan.links)
    ], np.int64)  # fmt: skip
    again = [
        i
        for i, op in enumerate(plan.operations)
        if op.code == Code.PUSH and found[op.index] != op.index
    ]
    owners = parts.owners.copy()
    owners[again] = NONE
    return found, replace(parts, owners=owners)


def own_operations(plan: Rows, parts: PlanParts) -> Rows:
    """The operations of the `plan` (n,), then those of each part, which record for themselves."""
    part, place = parts.operations
    rows = plan[place]
    record = rows["code"] == Code.RECORD
    rows["index"][record], rows["count"][record] = part[record] + 1, 0
    return np.concatenate([plan, rows])


class DividedPlan:
    """The parts of `bound`, whose operations, units, links and senders are there.

    `parts` (parts,): as C has them, for the next tick `tick`. `columns`: the address of what is
    recorded, of all and then of each part.
    """

    def __init__(self, bound: Bound, divided: PlanParts, tick: int) -> None:
        self._bound, self._divided = bound, divided
        self._part, self._place = divided.operations
        self.parts = np.zeros(divided.count, _PART)
        self._alive: list[Any] = []
        self._set_segments(tick)
        rows = self._rows()
        self._pulls = np.flatnonzero(rows["code"] == Code.PULL)
        received = np.zeros(len(self._pulls), _RECEIVED)
        received["link"], received["period"] = (rows[n][self._pulls] for n in ("index", "period"))
        self._give("links", received, self._part[self._pulls])
        self.columns = self._record()
        self._set_spans()

    def _rows(self) -> Rows:
        """Operations of the parts, one part after the other."""
        rows: Rows = self._bound.operations[len(self._bound.plan.operations) :]
        return rows

    def _give(self, name: str, found: Rows, part: Numbers) -> None:
        """Let each part have what of `found` (n,) is its own; `part` (n,), sorted: whose it is."""
        counts = np.bincount(part, minlength=len(self.parts))
        before = np.cumsum(counts) - counts
        self.parts[name] = found.ctypes.data + before * found.itemsize
        self.parts[f"n_{name}"] = counts
        self._alive.append(found)

    def _set_segments(self, tick: int) -> None:
        plan, rows, second = self._bound.plan, self._rows(), self._divided.second
        late = self._place >= (len(plan.operations) if second is None else second)
        first = np.array([op.first for op in plan.operations])[self._place]
        apart = np.diff(self._part, prepend=-1) != 0
        apart[1:] |= late[1:] != late[:-1]
        found = segments(rows["period"], first, apart, tick)
        start = found["first"].copy()
        found["first"] += len(plan.operations)
        found["last"] += len(plan.operations)
        self._give("segments", found, self._part[start])
        n_first = np.bincount(self._part[start[~late[start]]], minlength=len(self.parts))
        self.parts["n_first"] = n_first

    def _record(self) -> int:
        bound, late = self._bound, self._divided.late
        signals = np.asarray(bound.columns, dtype=np.int64)
        owner = np.zeros(bound.plan.n_signals, np.int64)
        after = np.zeros(bound.plan.n_signals, bool)
        for start, count in self._signals():
            owner[ranges(start, count)] = np.repeat(self._divided.part_of, count)
            after[ranges(start, count)] = np.repeat(late, count)
        for group in bound.plan.groups:
            own = [slot.start for slot in group.slots]
            owner[own], after[own] = self._divided.part_of[group.components[0]], True
        owner, after = owner[signals], after[signals]
        whole, _ = stretches(np.arange(len(signals)), signals, after & False, owner * 0)
        own_ones, part = stretches(np.argsort(owner, kind="stable"), signals, after, owner)
        columns = np.zeros(len(self.parts) + 1, _COLUMNS)
        counts = np.bincount(part, minlength=len(self.parts))
        columns["n_stretches"] = np.r_[len(whole), counts]
        before = np.cumsum(counts) - counts
        columns["stretches"][0] = whole.ctypes.data
        columns["stretches"][1:] = own_ones.ctypes.data + before * own_ones.itemsize
        self._alive += [whole, own_ones, columns]
        return columns.ctypes.data

    def _signals(self) -> list[tuple[Numbers, Numbers]]:
        """First signal and number of the inputs of each component, and of its outputs."""
        units = rows_of(self._bound.units)
        return [(units[n], units[f"{n}_count"]) for n in ("input", "output")]

    # ---- what a part uses ------------------------------------------------------------------------

    def _set_spans(self) -> None:
        """The memory of each part that is brought into the cache before it runs."""
        part_of, rows, parts = self._divided.part_of, self._rows(), self.parts
        every, at = np.arange(len(parts)), self._bound.signals.ctypes.data
        begin, end = np.searchsorted(self._part, [every, every + 1]) * rows.itemsize
        kept = [
            (every, rows.ctypes.data + begin, end - begin),
            (every, parts["segments"], parts["n_segments"] * c.sizeof(structs.SegmentStruct)),
            (part_of, *self._instances()),
            *((part_of, at + 8 * start, 8 * count) for start, count in self._signals()),
            self._entries(part_of, self._bound.units, np.arange(len(part_of))),
        ]
        link = rows["index"][self._pulls].astype(np.int64)
        links = self._part[self._pulls]
        kept.append(self._entries(links, self._bound.links, link))
        kept.append(self._entries(links, self._bound.senders, self._bound.sender_of[link]))
        part, first, size = (np.concatenate([x[k] for x in kept]) for k in range(3))
        self._give("spans", *_merged(part, first, size))

    @staticmethod
    def _entries(
        part: Numbers, array: c.Array[Any], index: Numbers
    ) -> tuple[Numbers, Numbers, Numbers]:
        size = c.sizeof(array._type_)
        return part, c.addressof(array) + index * size, np.full(len(index), size)

    def _instances(self) -> tuple[Numbers, Numbers]:
        """The places of FMUs, and their sizes, as far as is known: (components,) each."""
        units = rows_of(self._bound.units)
        first = units["instance"].astype(np.int64)
        values = units["values"].astype(np.int64)
        places = units["n_inputs"] + units["n_outputs"]
        end = np.where(values > 0, values + 8 * places + BEHIND, first + LINE)
        return first, np.where(first > 0, end - first, 0)


def _merged(part: Numbers, first: Numbers, size: Numbers) -> tuple[Rows, Numbers]:
    """Pieces of memory, in whole lines and once each, with the part of each."""
    used = size > 0
    part, first, end = part[used], first[used] // LINE * LINE, (first + size)[used]
    order = np.lexsort((first, part))
    part, first, end = part[order], first[order], end[order]
    new = np.ones(len(part), bool)
    new[1:] = (np.diff(part) != 0) | (first[1:] > end[:-1])
    start = np.flatnonzero(new)
    found = np.zeros(len(start), _SPAN)
    found["first"] = first[start]
    if len(start):
        found["size"] = np.maximum.reduceat(end, start) - first[start]
    return found, part[start]
