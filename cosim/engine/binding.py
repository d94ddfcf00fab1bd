"""A plan as ``engine.c`` sees it: its operations, units, links and players, as structs in memory.

FMUs become units with the addresses of their functions, or with the mailbox of their process;
Python components become call-backs.
"""

from __future__ import annotations

import ctypes as c
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.base.component import NativeComponent
from cosim.base.errors import RunError
from cosim.fmi import access_order
from cosim.fmi.components import stepped_fmu, terminated_at
from cosim.fmi.failures import starting
from cosim.fmi.layout import bind, bind_alike, late_clock_ticks
from cosim.fmi.library import DISCARD
from cosim.native import structs
from cosim.native.structs import MEANS, SLOPES, Code, EngineResult, UnitKind
from cosim.schedule.operations import Operation
from cosim.schedule.partition import PlanParts, merged, partition
from cosim.schedule.parts import Slot, Step
from cosim.schedule.plan import Plan
from cosim.schedule.segments import due_together

#: Results by which an FMU ends the simulation: after its step, and before it.
ENDS = (EngineResult.TERMINATED, EngineResult.ENDED)
#: Parts from which on they are run apart: with several threads, and with one, for its cache.
LEAST, ALONE = 32, 128
#: Ticks in a window, at most: they cost memory, and Ctrl-C waits for its end.
WINDOW = 64
#: What may be stepped by any thread: it does not call Python, and has no solver of its own.
ANYWHERE = frozenset({UnitKind.NATIVE, UnitKind.FMI2, UnitKind.FMI3, UnitKind.REMOTE})
Vector = NDArray[np.float64]
Views = dict[str, Vector]


@dataclass(frozen=True, slots=True)
class Termination:
    """An FMU that ended the simulation at `time` (s)."""

    component: str
    time: float

    def __str__(self) -> str:
        return f"ended by {self.component} at t = {self.time:.6g} s"


class Binding:
    """The structs that the engine runs: `state`, and the memory to which it points.

    `inputs`, `outputs`: the signals of each component, as views. `failure`: the last exception of a
    callback. `threads`: how many will run it. `columns`: the signals in a recorded row; None: all.
    `partition`: parts that may run apart, if that is worth it, after :meth:`bind`. `exact`: whether
    it can be rewound (:mod:`cosim.engine.rewind`), None: not determined yet.
    """

    def __init__(
        self,
        plan: Plan,
        signals: Vector,
        inputs: Sequence[Views],
        outputs: Sequence[Views],
        gates: Mapping[str, tuple[int, int]],
        threads: int = 1,
        columns: Sequence[int] | None = None,
    ) -> None:
        self.plan, self.signals, self._threads = plan, signals, threads
        self.state = structs.EngineState()
        self.failure: BaseException | None = None
        self.partition: PlanParts | None = None
        self.exact: bool | None = None
        self.columns = range(plan.n_signals) if columns is None else columns
        self._inputs, self._outputs, self._gates = inputs, outputs, gates
        self._sampled = frozenset(plan.order)
        self._kept = {name: n for bus in plan.buses for name, n in bus.history.items()}
        self._alive: list[Any] = []  # what C points to
        self._alike: dict[tuple[object, int, int], structs.UnitStruct] = {}

    def bind(self, tick: int = 0) -> None:
        """Fill in :attr:`state`, once all components have started; `tick`: the next to run. Raises
        ScenarioError.
        """
        plan, state = self.plan, self.state
        self.units = (structs.UnitStruct * len(plan.components))()
        self._alike.clear()
        for i, step in enumerate(plan.components):
            with starting(step.name):
                self.units[i] = self._unit(i, step)
        self._divide()
        self._senders = self._shared_senders() if self.partition else range(len(plan.links))
        self.operations = operations = _operations(plan.operations, self.partition)
        self._step_at_once(operations)
        self.senders = (structs.SenderStruct * len(plan.links))()
        self.links = (structs.LinkStruct * len(plan.links))()
        rows = [1] * len(plan.links)
        for i, sender in enumerate(self._senders):
            rows[sender] = max(rows[sender], self._rows(i))
        for i, sender in enumerate(self._senders):
            self._link(i, sender, rows[i])
        self.players = (structs.PlayerStruct * len(plan.players))()
        self.segments = segments = self._segments([plan.operations], 0, tick)
        self.first_due = bytes(segments)
        state.segments, state.n_segments = c.addressof(segments), len(segments)
        self._bind_parts(tick)
        through = (structs.GateStruct * len(plan.gates))(
            *(structs.GateStruct(*self._gates[g.name]) for g in plan.gates)
        )
        state.gates = c.addressof(through)
        self._alive.append(through)
        state.operations, state.units = operations.ctypes.data, c.addressof(self.units)
        state.links, state.senders = c.addressof(self.links), c.addressof(self.senders)
        state.players = c.addressof(self.players)
        state.signals = self.signals.ctypes.data
        state.width, state.columns = len(self.columns), self._recorded()
        state.h, state.tick = plan.h, tick
        self.keep_last()

    def keep_last(self) -> None:
        """What there was before the start is what there is at the start."""
        for o in self.plan.operations:
            if o.code in MEANS | SLOPES:
                self.signals[o.index : o.index + o.count] = self.signals[o.target :][: o.count]

    def fail(self, error: BaseException) -> None:
        """Keep the exception of a call-back: it is the reason why the run stops."""
        self.failure = error

    def _divide(self) -> None:
        """Divide the plan into parts, if there are enough of them."""
        least = LEAST if self._threads > 1 else ALONE
        if len(self.plan.components) < least:
            return
        kinds = [UnitKind(unit.kind) for unit in self.units]
        own = [i for i, kind in enumerate(kinds) if kind not in ANYWHERE]
        for staged in (False, True) if self._threads > 1 else (False,):
            found = partition(self.plan, own, staged=staged)
            if found and len(found.components) >= least:
                count = min(structs.AT_ONCE, len(found.components) // (4 * self._threads))
                if count > 1 and any(unit.steps for unit in self.units):
                    found = merged(found, count, bool(own))
                self.partition, self.together = found, bool(own)
                return

    def _shared_senders(self) -> list[int]:
        """Of each link, the first one that sends the same: parts send it once."""
        plan, first = self.plan, dict[tuple[Any, ...], int]()
        found = [
            first.setdefault((x.source.start, x.source.size, x.gain, x.offset), i)
            for i, x in enumerate(plan.links)
        ]
        again = {
            i for i, op in enumerate(plan.operations)
            if op.code == Code.PUSH and found[op.index] != op.index
        }  # fmt: skip
        if self.partition:
            own = tuple(tuple(i for i in x if i not in again) for x in self.partition.operations)
            self.partition = replace(self.partition, operations=own)
        return found

    def _step_at_once(self, operations: NDArray[np.void]) -> None:
        """Let steps of instances of one FMU be done together where they follow each other.

        `operations` (n,): of the plan and of its parts, as C has them; their counts are changed.
        """
        steps = np.array([u.steps or 0 for u in self.units], dtype=np.uint64)
        if not steps.any():
            return
        step = np.flatnonzero(operations["code"] == Code.STEP)
        unit = operations["index"][step]
        alike = np.array([(u.kind, u.lag, u.period) for u in self.units])
        same = (np.diff(step) == 1) & (steps[unit[1:]] == steps[unit[:-1]]) & (steps[unit[1:]] > 0)
        same &= (alike[unit[1:]] == alike[unit[:-1]]).all(axis=1)
        parts = self.partition.operations if self.partition else ()
        behind = np.cumsum([len(self.plan.operations), *map(len, parts)])
        same &= ~np.isin(step[1:], behind)
        starts = np.flatnonzero(np.r_[True, ~same])
        for start, end in pairwise([*starts.tolist(), len(step)]):
            for i in range(start, end, structs.AT_ONCE):
                operations["count"][step[i]] = min(structs.AT_ONCE, end - i) - 1

    def _segments(
        self, stages: Sequence[Sequence[Operation]], first: int, tick: int
    ) -> c.Array[structs.SegmentStruct]:
        """The segments of the operations in these stages, which begin at `first` in C."""
        made = []
        for operations in stages:
            made += [
                structs.SegmentStruct(x.period, x.start + tick, x.first + first, x.last + first)
                for x in due_together(operations)
            ]
            first += len(operations)
        segments = (structs.SegmentStruct * len(made))(*made)
        self._alive.append(segments)
        return segments

    def _bind_parts(self, tick: int) -> None:
        """The parts with their segments: their operations are behind those of the plan."""
        if self.partition is None:
            return
        plan, second = self.plan, self.partition.second
        self.parts = (structs.PartStruct * len(self.partition.operations))()
        first = len(plan.operations)
        for part, places in zip(self.parts, self.partition.operations, strict=True):
            cut = len(places) if second is None else bisect_left(places, second)
            stages = [[plan.operations[i] for i in some] for some in (places[:cut], places[cut:])]
            segments = self._segments(stages, first, tick)
            part.segments, part.n_segments = c.addressof(segments), len(segments)
            part.n_first = sum(x.last <= first + cut for x in segments)
            pulled = [op.index for stage in stages for op in stage if op.code == Code.PULL]
            links = np.array(pulled, dtype=np.int32)
            self._alive.append(links)
            part.links, part.n_links = links.ctypes.data, len(links)
            first += len(places)

    def _recorded(self) -> int:
        """Address of the columns of a recorded row: all, then those of each part."""
        signals = np.asarray(self.columns, dtype=np.int64)
        every = np.arange(len(signals))
        sets = [_stretches(every, signals, np.zeros(len(signals), bool))]
        if self.partition:
            owners, after = self._owners(self.partition)
            owner, late = owners[signals], after[signals]
            order = np.argsort(owner, kind="stable")
            bounds = np.searchsorted(owner[order], range(len(self.partition.components) + 1))
            sets += [_stretches(order[a:b], signals, late) for a, b in pairwise(bounds)]
        columns = (structs.ColumnsStruct * len(sets))(
            *(structs.ColumnsStruct(found.ctypes.data, len(found)) for found in sets)
        )
        self._alive += [sets, columns]
        return c.addressof(columns)

    def _owners(self, parts: PlanParts) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Of which part each signal is, and whether it is written behind RECORD (n_signals,)."""
        owner = np.zeros(self.plan.n_signals, np.int64)
        late = np.zeros(self.plan.n_signals, bool)
        for number, part in enumerate(parts.components):
            for i in part:
                for slots in (self.plan.components[i].inputs, self.plan.components[i].outputs):
                    start, n = extent(slots)
                    owner[start : start + n] = number
                    late[start : start + n] = i in parts.late
        for group in self.plan.groups:
            for slot in group.slots:
                owner[slot.start] = owner[
                    self.plan.components[group.components[0]].outputs[0].start
                ]
                late[slot.start] = True
        return owner, late

    def _unit(self, index: int, step: Step) -> structs.UnitStruct:
        late = step.name not in self._sampled
        lag, h = step.period - 1 if late else 0, step.period * self.plan.h
        unit = structs.UnitStruct(lag=lag, h=h, period=step.period, kind=structs.UnitKind.CALL)
        unit.input, unit.input_count = extent(step.inputs)
        unit.output, unit.output_count = extent(step.outputs)
        fmu = stepped_fmu(step.component)
        if fmu is None and isinstance(step.component, NativeComponent):
            unit.kind = structs.UnitKind.NATIVE
            unit.step, unit.instance = step.component.native_step(h)
            return unit
        if fmu is not None:
            alike = self._alike.get((fmu.sort, lag, step.period))
            if alike is not None:
                return bind_alike(fmu.instance, alike, unit)
            layout = access_order.layout(
                fmu, h, lag, step.period, unit.input, unit.output, self._slopes(step)
            )
            stop = c.addressof(self.state) + structs.EngineState.stop.offset
            if fmu.remote is None:
                unit = bind(fmu.instance, layout, self._alive, stop)
                if layout.plain and layout.exchange is None:
                    self._alike[fmu.sort, lag, step.period] = unit
                return unit
            return fmu.remote.bind(layout, access_order.isolated(fmu, layout), stop)
        call = structs.CALL(self._call_back(index, step))
        self._alive.append(call)
        unit.step = structs.address(call)
        return unit

    def _slopes(self, step: Step) -> dict[int, int]:
        """Where slopes of inputs are in the signals, by where the inputs are."""
        return {
            o.target + i: o.index + o.count + i
            for o in (self.plan.operations if step.sloped else ())
            if o.code in SLOPES and any(s.start <= o.target < s.start + s.size for s in step.inputs)
            for i in range(o.count)
        }

    def ended(self, index: int, result: EngineResult) -> Termination | None:
        """How the FMU of component `index` ended the simulation, if `result` means that."""
        at = None
        if result in ENDS:
            at = self.units[index].reached
        elif result is EngineResult.STEP and self.state.failed_status == DISCARD:
            at = terminated_at(self.plan.components[index].component)
        return None if at is None else Termination(self.plan.components[index].name, at)

    def _call_back(self, index: int, step: Step) -> Callable[[int, float, float], int]:
        inputs, outputs, component = self._inputs[index], self._outputs[index], step.component

        def call(_: int, t: float, h: float) -> int:
            try:
                store(outputs, component.step(t, h, inputs))
            except BaseException as error:
                self.failure = error
                return EngineResult.STEP
            return EngineResult.OK

        return call

    def _rows(self, index: int) -> int:
        """Samples that the sender of a link keeps for it."""
        link = self.plan.links[index]
        kept = self._kept.get(link.name, link.table.history)
        ahead = WINDOW // link.table.grid.n_s + 2 if self.partition else 0
        return 1 << (kept + ahead - 1).bit_length()

    def _link(self, index: int, sender: int, rows: int) -> None:
        link = self.plan.links[index]
        width = link.source.size
        history = np.zeros((rows, width))
        at = link.target.start
        initial = self.signals[at : at + width].copy()
        self._alive += [history, initial]
        self.senders[index] = structs.SenderStruct(history.ctypes.data, width, 0, rows)
        self.links[index] = structs.LinkStruct(
            sender=c.addressof(self.senders) + sender * c.sizeof(structs.SenderStruct),
            initial=initial.ctypes.data, held=-1,
        )  # fmt: skip

    def late_clock_ticks(self) -> dict[str, tuple[int, float]]:
        """Number of late clock ticks of each FMU, and their greatest delay (s)."""
        found = {}
        for step, unit in zip(self.plan.components, self.units, strict=True):
            fmu = stepped_fmu(step.component)
            if fmu is not None:
                count, most = (
                    late_clock_ticks(unit) if fmu.remote is None else fmu.remote.late_clock_ticks()
                )
                if count:
                    found[step.name] = count, most
        return found


def _operations(operations: Sequence[Operation], parts: PlanParts | None) -> NDArray[np.void]:
    """As C has them: those of the plan, then those of each part, which record for themselves."""
    found = np.zeros(len(operations), np.dtype(structs.OperationStruct))
    for name, _ in structs.OperationStruct._fields_:
        found[name] = [getattr(op, name) for op in operations]
    if parts is None:
        return found
    own = [found, *(found[list(places)] for places in parts.operations)]
    for number, rows in enumerate(own[1:], start=1):
        record = rows["code"] == Code.RECORD
        rows["index"][record], rows["count"][record] = number, 0
    return np.concatenate(own)


def _stretches(
    places: NDArray[np.int64], signals: NDArray[np.int64], late: NDArray[np.bool_]
) -> NDArray[np.void]:
    """The entries `places` (n,) of a row, which is of `signals`, as C has them."""
    source, after = signals[places], late[places]
    apart = (np.diff(places) != 1) | (np.diff(source) != 1) | (after[1:] != after[:-1])
    first = np.flatnonzero(np.r_[np.ones(min(1, len(places)), bool), apart])
    found = np.zeros(len(first), np.dtype(structs.StretchStruct))
    found["place"], found["source"], found["late"] = places[first], source[first], after[first]
    found["count"] = np.diff(np.r_[first, len(places)])
    return found


def extent(slots: Sequence[Slot]) -> tuple[int, int]:
    """First entry and number of the signals of slots that follow each other."""
    if not slots:
        return 0, 0
    first, last = slots[0].start, slots[-1]
    return first, last.start + last.size - first


def part(signals: Vector, slot: Slot) -> Vector:
    """The signals of a slot, (size,)."""
    return signals[slot.start : slot.start + slot.size]


def store(views: Views, outputs: Mapping[str, Any]) -> None:
    """Write what a component returned.

    Raises RunError if an output is missing or does not have its shape.
    """
    for port, view in views.items():
        try:
            view[...] = outputs[port]
        except KeyError:
            raise RunError(f"returned no {port!r}") from None
        except (TypeError, ValueError) as error:
            raise RunError(f"returned {port!r}: {error}") from None
