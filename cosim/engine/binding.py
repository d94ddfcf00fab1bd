"""A plan as ``engine.c`` sees it: its operations, units, links and players, as structs in memory.

FMUs become units with the addresses of their functions; Python components, and FMUs in processes of
their own, become call-backs.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.base.component import NativeComponent
from cosim.base.errors import RunError
from cosim.fmi import access_order
from cosim.fmi.component import FmuComponent
from cosim.fmi.components import stepped_fmu, terminated_at
from cosim.fmi.failures import starting
from cosim.fmi.isolated import RemoteInstance, RemoteStep
from cosim.fmi.layout import StepLayout, bind, late_clock_ticks
from cosim.fmi.library import DISCARD
from cosim.fmi.refusals import step_refused
from cosim.native import structs
from cosim.native.structs import MEANS, SLOPES, EngineResult
from cosim.schedule.parts import Slot, Step
from cosim.schedule.plan import Plan
from cosim.schedule.segments import Segment, due_together

#: Results by which an FMU ends the simulation: after its step, and before it.
ENDS = (EngineResult.TERMINATED, EngineResult.ENDED)
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
    callback. `threads`: how many will run it.
    """

    def __init__(
        self,
        plan: Plan,
        signals: Vector,
        inputs: Sequence[Views],
        outputs: Sequence[Views],
        gates: Mapping[str, tuple[int, int]],
        threads: int = 1,
    ) -> None:
        self.plan, self.signals, self._threads = plan, signals, threads
        self.state = structs.EngineState()
        self.failure: BaseException | None = None
        self._inputs, self._outputs, self._gates = inputs, outputs, gates
        self._sampled = frozenset(plan.order)
        self._kept = {name: n for bus in plan.buses for name, n in bus.history.items()}
        self._alive: list[Any] = []  # what C points to

    def bind(self, tick: int = 0) -> None:
        """Fill in :attr:`state`, once all components have started; `tick`: the next to run. Raises
        ScenarioError.
        """
        plan, state = self.plan, self.state
        operations = (structs.OperationStruct * len(plan.operations))()
        for i, o in enumerate(plan.operations):
            operations[i] = structs.OperationStruct(
                *(o.code, o.index, o.period, o.source, o.target, o.count),
                *(o.gain, o.offset),
            )
        self.units = (structs.UnitStruct * len(plan.components))()
        for i, step in enumerate(plan.components):
            with starting(step.name):
                self.units[i] = self._unit(i, step)
        self.links = (structs.LinkStruct * len(plan.links))(
            *(self._link(i) for i in range(len(plan.links)))
        )
        self.players = (structs.PlayerStruct * len(plan.players))()
        parts = plan.segments if self._threads > 1 else due_together(plan.operations)
        self.segments = (structs.SegmentStruct * len(parts))(
            *(self._segment(segment, tick) for segment in parts)
        )
        state.segments, state.n_segments = c.addressof(self.segments), len(parts)
        through = (structs.GateStruct * len(plan.gates))(
            *(structs.GateStruct(*self._gates[g.name]) for g in plan.gates)
        )
        state.gates = c.addressof(through)
        self._alive += [operations, through]
        state.operations, state.units = c.addressof(operations), c.addressof(self.units)
        state.links = c.addressof(self.links)
        state.players = c.addressof(self.players)
        state.signals = self.signals.ctypes.data
        state.n_signals = plan.n_signals
        state.h, state.tick = plan.h, tick
        for o in plan.operations:  # what there was before the start is what there is at the start
            if o.code in MEANS | SLOPES:
                self.signals[o.index : o.index + o.count] = self.signals[o.target :][: o.count]

    def _segment(self, segment: Segment, tick: int) -> structs.SegmentStruct:
        """Not shared yet: see :class:`cosim.engine.team.Team`."""
        blocks = np.array(segment.blocks, dtype=np.int64)
        self._alive.append(blocks)
        return structs.SegmentStruct(
            period=segment.period, next=segment.start + tick, first=segment.first,
            last=segment.last, blocks=blocks.ctypes.data, n_blocks=len(blocks) - 1,
        )  # fmt: skip

    def _unit(self, index: int, step: Step) -> structs.UnitStruct:
        late = step.name not in self._sampled
        lag, h = step.period - 1 if late else 0, step.period * self.plan.h
        unit = structs.UnitStruct(lag=lag, h=h, period=step.period, kind=structs.UnitKind.CALL)
        unit.input, unit.input_count = _extent(step.inputs)
        unit.output, unit.output_count = _extent(step.outputs)
        fmu = stepped_fmu(step.component)
        if isinstance(step.component, NativeComponent):
            unit.kind = structs.UnitKind.NATIVE
            unit.step, unit.instance = step.component.native_step(h)
            return unit
        if fmu is not None:
            layout = access_order.layout(
                fmu, h, lag, step.period, unit.input, unit.output, self._slopes(step)
            )
            if fmu.remote is None:
                return bind(fmu.instance, layout, self._alive)
            function = self._remote_call_back(index, step, layout, fmu, fmu.remote)
        else:
            function = self._call_back(index, step)
        call = structs.CALL(function)
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

    def _remote_call_back(
        self, index: int, step: Step, layout: StepLayout, fmu: FmuComponent, remote: RemoteInstance
    ) -> Callable[[int, float, float], int]:
        there = access_order.isolated(fmu, layout)
        stepped = RemoteStep(remote, layout, there, self.signals)
        remote.stopping = lambda: bool(self.state.stop)

        def call(_: int, t: float, h: float) -> int:
            try:
                result, status, place = stepped(t, self.state.tick)
                if result in ENDS:
                    self.units[index].reached = remote.reached()
                elif result is EngineResult.STEP and status == DISCARD:
                    at = remote.terminated()
                    if at is not None:
                        result, self.units[index].reached = EngineResult.ENDED, at
                if result is not EngineResult.OK and result not in ENDS:
                    raise RunError(step_refused(step, self.signals, result, status, place))
            except BaseException as error:
                self.failure = error
                return EngineResult.STEP
            return result

        return call

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

    def _link(self, index: int) -> structs.LinkStruct:
        link = self.plan.links[index]
        width = link.source.size
        history = np.zeros((self._kept.get(link.name, link.table.history), width))
        at = link.target.start
        initial = self.signals[at : at + width].copy()
        self._alive += [history, initial]
        return structs.LinkStruct(
            history=history.ctypes.data, initial=initial.ctypes.data, width=width,
            capacity=len(history), held=-1,
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


def _extent(slots: Sequence[Slot]) -> tuple[int, int]:
    return (slots[0].start if slots else 0), sum(s.size for s in slots)


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
