"""A plan as ``engine.c`` sees it: its operations, units, links and players, as structs in memory.

FMUs become units with the addresses of their functions, or with the mailbox of their process;
Python components become call-backs.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cosim.base.component import NativeComponent
from cosim.base.convert import Struct
from cosim.base.errors import RunError
from cosim.engine.arrays import (
    Numbers,
    in_lines,
    operation_rows,
    ranges,
    rows_of,
    segments,
    stretches,
)
from cosim.fmi import access_order
from cosim.fmi.components import stepped_fmu, terminated_at
from cosim.fmi.failures import starting
from cosim.fmi.layout import bind, bind_alike, late_clock_ticks
from cosim.fmi.library import DISCARD
from cosim.native import enums, shared, structs
from cosim.native.enums import Code, EngineResult, UnitKind
from cosim.schedule.parts import Slot, Step
from cosim.schedule.plan import Plan

if TYPE_CHECKING:
    from cosim.engine.partitions import DividedPlan
    from cosim.schedule.partition import PlanParts

#: Results by which an FMU ends the simulation: after its step, and before it.
ENDS = (EngineResult.TERMINATED, EngineResult.ENDED)
#: A line through the last two values: its mean over a step; its slope and the value it begins with.
MEANS = frozenset({Code.AHEAD, Code.BETWEEN})
SLOPES = frozenset({Code.SLOPE_AHEAD, Code.SLOPE_BETWEEN})
#: Parts from which on they are run apart: with several threads, and with one, for its cache.
LEAST, ALONE = 32, 128
#: Ticks in a window, at most: they cost memory, and Ctrl-C waits for its end.
WINDOW = 64
#: What may be stepped by any thread: it does not call Python, and has no solver of its own.
ANYWHERE = frozenset({UnitKind.NATIVE, UnitKind.FMI2, UnitKind.FMI3, UnitKind.REMOTE})
Vector = NDArray[np.float64]
Views = dict[str, Vector]


class Termination(Struct, frozen=True):
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
    it can be rewound (:mod:`cosim.engine.reset`), None: not determined yet.
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
        self.state = structs.EngineStruct()
        self.failure: BaseException | None = None
        self.partition: PlanParts | None = None
        self.divided: DividedPlan | None = None
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
        self.operations = operation_rows(plan.operations)
        first = np.array([op.first for op in plan.operations], np.int64)
        apart = np.zeros(len(first), bool)
        self.segments = segments(self.operations["period"], first, apart, tick)
        self.first_due = self.segments.tobytes()
        self._bind_parts_and_links(tick)
        self.players = (structs.PlayerStruct * len(plan.players))()
        state.segments, state.n_segments = self.segments.ctypes.data, len(self.segments)
        through = (structs.GateStruct * len(plan.gates))(
            *(structs.GateStruct(*self._gates[g.name]) for g in plan.gates)
        )
        state.gates = c.addressof(through)
        self._alive.append(through)
        state.operations, state.units = self.operations.ctypes.data, c.addressof(self.units)
        state.links, state.senders = c.addressof(self.links), c.addressof(self.senders)
        state.players = c.addressof(self.players)
        state.signals = self.signals.ctypes.data
        state.width = len(self.columns)
        state.h, state.start, state.tick = plan.h, plan.start, tick
        self.keep_last()

    def keep_last(self) -> None:
        """Use the values of the start for all times before it."""
        for o in self.plan.operations:
            if o.code in MEANS | SLOPES:
                self.signals[o.index : o.index + o.count] = self.signals[o.target :][: o.count]

    def fail(self, error: BaseException) -> None:
        """Keep the exception of a call-back: it is the reason why the run stops."""
        self.failure = error

    def _bind_parts_and_links(self, tick: int) -> None:
        """Divide the plan into parts, if there are enough of them; links keep more samples then."""
        plan = self.plan
        self.sender_of = np.arange(len(plan.links))
        least = LEAST if self._threads > 1 else ALONE
        found = None
        if len(plan.components) >= least:
            from cosim.engine import partitions

            units = rows_of(self.units)
            own = np.flatnonzero(~np.isin(units["kind"], list(ANYWHERE))).tolist()
            at_once = bool(units["steps"].any())
            found = partitions.divide(plan, own, self._threads, least, at_once=at_once)
        if found is None:
            self._step_at_once(np.array([len(plan.operations)]))
            self._bind_links(ahead=0)
            self.state.columns = self._recorded()
            return
        self.sender_of, found = partitions.shared_senders(plan, found)
        self.operations = partitions.own_operations(self.operations, found)
        self._step_at_once(len(plan.operations) + np.r_[0, found.ends])
        self._bind_links(ahead=WINDOW)
        self.partition, self.together = found, bool(own)
        self.divided = partitions.DividedPlan(self, found, tick)
        self.state.columns = self.divided.columns

    def _step_at_once(self, ends: Numbers) -> None:
        """Let steps of instances of one FMU be done together where they follow each other.

        `ends`: of the operations of the plan, and of its parts. Counts of operations are changed.
        """
        operations, units = self.operations, rows_of(self.units)
        if not units["steps"].any():
            return
        step = np.flatnonzero(operations["code"] == Code.STEP)
        unit = operations["index"][step]
        same = (np.diff(step) == 1) & (units["steps"][unit[1:]] > 0) & ~np.isin(step[1:], ends)
        for name in ("steps", "kind", "lag", "period"):
            same &= units[name][unit[1:]] == units[name][unit[:-1]]
        starts = np.flatnonzero(np.r_[True, ~same])
        for start, end in pairwise([*starts.tolist(), len(step)]):
            for i in range(start, end, enums.AT_ONCE):
                operations["count"][step[i]] = min(enums.AT_ONCE, end - i) - 1

    def _recorded(self) -> int:
        """Address of the columns of a recorded row."""
        signals = np.asarray(self.columns, dtype=np.int64)
        nothing = np.zeros(len(signals), np.int64)
        found, _ = stretches(np.arange(len(signals)), signals, nothing > 0, nothing)
        columns = structs.ColumnsStruct(found.ctypes.data, len(found))
        self._alive += [found, columns]
        return c.addressof(columns)

    def _unit(self, index: int, step: Step) -> structs.UnitStruct:
        late = step.name not in self._sampled
        lag, h = step.period - 1 if late else 0, step.period * self.plan.h
        unit = structs.UnitStruct(lag=lag, h=h, period=step.period, kind=enums.UnitKind.CALL)
        unit.input, unit.input_count = extent(step.inputs)
        unit.output, unit.output_count = extent(step.outputs)
        fmu = stepped_fmu(step.component)
        if fmu is None and isinstance(step.component, NativeComponent):
            unit.kind = enums.UnitKind.NATIVE
            unit.step, unit.instance = step.component.native_step(h)
            return unit
        if fmu is not None:
            alike = self._alike.get((fmu.sort, lag, step.period))
            if alike is not None:
                return bind_alike(fmu.instance, alike, unit)
            layout = access_order.layout(
                fmu, h, lag, step.period, unit.input, unit.output, self._slopes(step)
            )
            stop = c.addressof(self.state) + structs.EngineStruct.stop.offset
            if fmu.remote is None:
                unit = bind(fmu.instance, layout, self._alive, stop)
                if layout.plain and layout.exchange is None:
                    self._alike[fmu.sort, lag, step.period] = unit
                return unit
            return fmu.remote.bind(layout, access_order.isolated(fmu, layout), stop)
        call = shared.CALL(self._call_back(index, step))
        self._alive.append(call)
        unit.step = shared.address(call)
        return unit

    def _slopes(self, step: Step) -> dict[int, int]:
        """The places of slopes of inputs in the signals, by the places of the inputs."""
        return {
            o.target + i: o.index + o.count + i
            for o in (self.plan.operations if step.sloped else ())
            if o.code in SLOPES and any(s.start <= o.target < s.start + s.size for s in step.inputs)
            for i in range(o.count)
        }

    def ended(self, index: int, result: EngineResult) -> Termination | None:
        """The end that the FMU of component `index` asked for, if `result` means that."""
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

    def _bind_links(self, ahead: int) -> None:
        """Senders and links, with room for samples that are needed `ahead` ticks later."""
        links, n = self.plan.links, len(self.plan.links)
        self.senders, self.links = (structs.SenderStruct * n)(), (structs.LinkStruct * n)()
        if not links:
            return
        own = self._kept
        kept = [own.get(x.name, x.table.history) for x in links]
        if ahead:
            kept = [k + ahead // x.table.grid.n_s + 2 for k, x in zip(kept, links, strict=True)]
        most = np.ones(n, np.int64)
        np.maximum.at(most, self.sender_of, kept)
        width = np.array([x.source.size for x in links], np.int64)
        room = width << np.frexp(most - 1)[1]
        memory = in_lines(int(room.sum() + width.sum()))
        self._alive.append(memory)
        address = memory.ctypes.data + 8 * (np.cumsum(np.r_[room, width]) - np.r_[room, width])
        at = np.array([x.target.start for x in links], np.int64)
        memory[room.sum() :] = self.signals[ranges(at, width)]
        sender, link = rows_of(self.senders), rows_of(self.links)
        sender["history"], sender["width"], sender["capacity"] = address[:n], width, room // width
        link["sender"] = c.addressof(self.senders) + self.sender_of * sender.itemsize
        link["initial"], link["held"] = address[n:], -1

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


def extent(slots: Sequence[Slot]) -> tuple[int, int]:
    """First entry and number of the signals of slots that follow each other."""
    if not slots:
        return 0, 0
    first, last = slots[0].start, slots[-1]
    return first, last.start + last.size - first


def part(signals: Vector, slot: Slot) -> Vector:
    """The signals of a slot, (size,)."""
    return signals[slot.start : slot.start + slot.size]


def store(views: Views, outputs: Any) -> None:
    """Write what a component returned: a mapping of the name of each port to its value.

    Raises RunError if it is no dict, or if an output is missing or does not have its shape.
    """
    for port, view in views.items():
        try:
            view[...] = outputs[port]
        except KeyError:
            raise RunError(f"returned no {port!r}") from None
        except (TypeError, ValueError, IndexError) as error:
            if not isinstance(outputs, Mapping):
                names = ", ".join(f"{name!r}: ..." for name in views)
                given = type(outputs).__name__
                raise RunError(f"returned a {given}, expected a dict {{{names}}}") from None
            raise RunError(f"returned {port!r}: {error}") from None
