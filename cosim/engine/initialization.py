"""From components to the signals of t = 0: all start, and outputs travel until nothing changes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from heapq import heappop, heappush
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.base.component import Parameter
from cosim.base.errors import RunError, ScenarioError
from cosim.engine.binding import Termination, Vector, Views, part, store
from cosim.fmi.components import exit_initialization, is_fmu, stepped_fmu
from cosim.fmi.failures import starting
from cosim.schedule.parts import Link, Slot, Step, Wire
from cosim.schedule.plan import Plan

if TYPE_CHECKING:
    from cosim.engine.algebraic_loops import AlgebraicLoops


def initialize(
    plan: Plan,
    signals: Vector,
    inputs: Sequence[Views],
    outputs: Sequence[Views],
    settled: Callable[[], None] = lambda: None,
) -> Termination | None:
    """Start all components, and fill in `signals` (n_signals,), in the units of the signals.

    Initial outputs are propagated along wires and links until no value changes, with FMUs in
    Initialization Mode; if they do not come to rest, algebraic loops are solved. `settled` is
    called then. Each FMU leaves this mode, with the events at its start. Its outputs are read
    again, because they may differ, and are propagated. `inputs`, `outputs`: the signals of each
    component. Returns how an FMU ended the simulation in these events. Raises ScenarioError if a
    component does not start or a loop has no solution, RunError if an output is not a finite
    number.
    """
    known = dict[int, tuple[object, dict[str, Parameter]]]()
    for step in plan.components:
        parameters = step.component.parameters
        if id(parameters) not in known:
            known[id(parameters)] = parameters, {p.name: p for p in parameters}
        _start(step, known[id(parameters)][1], signals)
    for player in plan.players:
        part(signals, player.target)[:] = player.source.stream().rows(1)
    start = _Settling(plan, signals, inputs, outputs)
    start.settle()
    settled()
    ended = None
    for i in _exits(plan):
        ended = start.exit(i) or ended
    _check(plan, signals)
    return ended


class _Settling:
    """Components that say their outputs for their inputs, until nothing changes.

    A component has nothing to do while none of those that feed it has changed; those that have are
    `stale`. `unsettled`: those whose outputs may still be computed.
    """

    def __init__(
        self, plan: Plan, signals: Vector, inputs: Sequence[Views], outputs: Sequence[Views]
    ) -> None:
        self._steps, self._inputs, self._outputs = plan.components, inputs, outputs
        self._whole = signals
        self._signals: Any = signals.data  # entries as Python's numbers
        self._address = signals.ctypes.data
        place = {step.name: i for i, step in enumerate(plan.components)}
        self._fed: list[list[Wire | Link]] = [[] for _ in plan.components]
        self._feeds: list[list[int]] = [[] for _ in plan.components]
        edges: list[Wire | Link] = [*plan.wires, *plan.links]
        for edge in edges:
            receiver = place[edge.target.component]
            self._fed[receiver].append(edge)
            self._feeds[place[edge.source.component]].append(receiver)
        self._loops: AlgebraicLoops | None = None  # once they are needed
        self._of_loops = plan, signals, inputs, edges
        self._known = dict[int, bytes]()  # the inputs for which each has said its outputs
        self._unsettled = set(range(len(plan.components)))
        self._stale = set(self._unsettled)
        self._changed = False  # in this pass

    def settle(self) -> None:
        """Pass values on until none changes, or solve the loops that do not come to rest."""
        start, refused = self._whole.copy(), None
        if self._loops is None or not self._loops.loops:
            try:
                if self._iterate():
                    return
            except ScenarioError as error:  # perhaps of a loop that diverges
                refused = error
            self._whole[:] = start
        self._known.clear()
        self._stale = set(range(len(self._steps)))
        if self._loops is None:
            from cosim.engine.algebraic_loops import AlgebraicLoops

            self._loops = AlgebraicLoops(*self._of_loops)
        try:
            looped = self._loops.solve(self._unsettled)
        except ScenarioError:
            looped = bool(self._loops.loops)
            if looped or refused is None:
                raise
        if not looped and refused is not None:
            raise refused

    def _iterate(self) -> bool:
        """Pass values on, component after component; whether they come to rest."""
        for _ in range(len(self._steps) + 1):
            waiting, self._stale, self._changed = self._stale, set(), False
            queue = sorted(waiting)
            while queue:
                i = heappop(queue)
                waiting.remove(i)
                for receiver in self._say(i):
                    if receiver <= i:
                        self._stale.add(receiver)
                    elif receiver not in waiting:
                        waiting.add(receiver)
                        heappush(queue, receiver)
            if not self._changed:
                return True
        return False

    def _say(self, i: int) -> Sequence[int]:
        """Let component `i` say its outputs; returns those that it feeds, if they have changed."""
        step = self._steps[i]
        self._gather(self._fed[i])
        given = self._bytes(step.inputs)
        if self._known.get(i) == given:
            return ()
        self._known[i], self._changed = given, True
        if i not in self._unsettled:
            return ()
        before = self._bytes(step.outputs)
        with starting(step.name):
            if not self._say_in_place(step):
                store(self._outputs[i], step.component.initial(self._inputs[i]))
        return self._feeds[i] if self._bytes(step.outputs) != before else ()

    def _say_in_place(self, step: Step) -> bool:
        """Let an FMU read and write the signals themselves, if it can, and if they are numbers."""
        fmu = stepped_fmu(step.component)
        if fmu is None or not (step.inputs and step.outputs):
            return False
        first, last = step.inputs[0].start, step.inputs[-1]
        if not isfinite(sum(self._signals[first : last.start + last.size])):
            return False
        size = self._signals.itemsize
        outputs = self._address + size * step.outputs[0].start
        return fmu.initial_at(self._address + size * first, outputs)

    def exit(self, i: int) -> Termination | None:
        """Let component `i` leave Initialization Mode, and others see what changes by this."""
        self._unsettled.remove(i)
        step = self._steps[i]
        before = self._bytes(step.outputs)  # all it can change
        ended = _exit(step, self._outputs[i])
        if self._bytes(step.outputs) != before:
            self._stale.update(self._feeds[i])
            self.settle()
        return ended

    def _bytes(self, slots: Sequence[Slot]) -> bytes:
        """The signals of a component's inputs or outputs, which follow each other."""
        if not slots:
            return b""
        first, last = slots[0].start, slots[-1]
        return bytes(self._signals[first : last.start + last.size])

    def _gather(self, fed: Sequence[Wire | Link]) -> None:
        signals = self._signals
        for e in fed:
            first = e.target.start
            if isinstance(e, Link) and e.initial is not None:
                for k, value in enumerate(e.initial):
                    signals[first + k] = value
                continue
            source, gain, offset = e.source.start, e.gain, e.offset
            for k in range(e.source.size):
                signals[first + k] = gain * signals[source + k] + offset


def _start(step: Step, parameters: Mapping[str, Parameter], signals: Vector) -> None:
    values = {k: np.array(v).reshape(parameters[k].shape) for k, v in step.values.items()}
    with starting(step.name):
        step.component.initialize(values)
    for slot, port in zip(step.inputs, step.component.inputs, strict=True):
        part(signals, slot)[:] = step.start.get(port.name) or port.default or (0.0,) * port.size


def _exits(plan: Plan) -> list[int]:
    """FMUs in the order in which they leave Initialization Mode: plants, then sampled components.

    An output that changes at this time is seen by the components that are still in it.
    """
    place = {name: i for i, name in enumerate(plan.order)}
    fmus = [i for i, s in enumerate(plan.components) if is_fmu(s.component)]
    return sorted(fmus, key=lambda i: place.get(plan.components[i].name, -1))


def _exit(step: Step, outputs: Views) -> Termination | None:
    with starting(step.name):
        found, ended = exit_initialization(step.component)
        for port, value in found.items():
            outputs[port][...] = value
        return None if ended is None else Termination(step.name, ended)


def _check(plan: Plan, signals: Vector) -> None:
    finite = np.isfinite(signals)
    if finite.all():
        return
    for step in plan.components:
        for slot in step.outputs:
            if not finite[slot.start : slot.start + slot.size].all():
                value = part(signals, slot).tolist()
                raise RunError(
                    f"{slot.name} = {value} at the start", component=step.name, tick=0, time=0.0
                )
