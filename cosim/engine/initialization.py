"""The signals of t = 0: all components start, and outputs travel until nothing changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

import numpy as np

from cosim.base.component import Outputs
from cosim.base.errors import RunError, ScenarioError
from cosim.engine.binding import Termination, Vector, Views, extent, part, store
from cosim.fmi.components import ended_at_start, exit_initialization, is_fmu, stepped_fmu
from cosim.fmi.failures import starting_one_of
from cosim.fmi.starting import InputSources, Member, Starts, Turns
from cosim.native.structs import BringingStruct
from cosim.schedule.parts import Link, Wire
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
    start = PlanStart(plan, signals, inputs, outputs)
    start.enter()
    start.play()
    start.settle()
    settled()
    start.leave()
    _check(plan, signals)
    return start.ended


class PlanStart:
    """The start of a plan. Components say their outputs for their inputs until nothing changes.

    A component has nothing to do while none of those that feed it has changed. `ended`: how an FMU
    ended the simulation. `starts`: the calls of FMUs.
    """

    def __init__(
        self, plan: Plan, signals: Vector, inputs: Sequence[Views], outputs: Sequence[Views]
    ) -> None:
        self._plan, self._signals, self._inputs, self._outputs = plan, signals, inputs, outputs
        self._edges: list[Wire | Link] = [*plan.wires, *plan.links]
        self._loops: AlgebraicLoops | None = None  # once they are needed
        self.ended: Termination | None = None
        fmus = [stepped_fmu(step.component) for step in plan.components]
        begin = next((fmu.begin for fmu in fmus if fmu is not None), 0.0)
        self.starts = Starts(
            [
                Member(fmu, step.values if fmu else {}, *extent(step.inputs), *extent(step.outputs))
                for fmu, step in zip(fmus, plan.components, strict=True)
            ],
            signals,
            Turns(self._initialize, self._say, self._exit, self._take),
            _input_sources(plan, self._edges),
            begin,
        )

    def _starting(self) -> AbstractContextManager[None]:
        return starting_one_of(lambda: self._plan.components[self.starts.number].name)

    def enter(self) -> None:
        """Start all components with their values, and set inputs that nothing feeds."""
        with self._starting():
            self.starts.enter()
        for step in self._plan.components:
            first, size = extent(step.inputs)
            self._signals[first : first + size] = [
                v
                for port in step.component.inputs
                for v in step.start.get(port.name) or port.default or (0.0,) * port.size
            ]

    def play(self) -> None:
        """Set inputs that tables feed to their first values."""
        for player in self._plan.players:
            part(self._signals, player.target)[:] = player.source.stream().rows(1)

    @property
    def looped(self) -> bool:
        """True if the values did not come to rest by being passed on."""
        return self._loops is not None

    def settle(self) -> None:
        """Pass values on until none changes, or solve the loops that do not come to rest."""
        signals, starts, refused = self._signals, self.starts, None
        start = signals.copy()
        if self._loops is None or not self._loops.loops:
            try:
                with self._starting():
                    if starts.settle():
                        return
            except ScenarioError as error:  # perhaps of a loop that diverges
                refused = error
            signals[:] = start
        starts.asked[:], starts.stale[:] = 0, 1
        if self._loops is None:
            from cosim.engine.algebraic_loops import AlgebraicLoops

            self._loops = AlgebraicLoops(self._plan, signals, self._inputs, self._edges)
        try:
            looped = self._loops.solve(set(np.flatnonzero(starts.unsettled).tolist()))
        except ScenarioError:
            looped = bool(self._loops.loops)
            if looped or refused is None:
                raise
        if not looped and refused is not None:
            raise refused

    def leave(self) -> None:
        """Let FMUs leave Initialization Mode, and others see what changes by this."""
        leaving = self.starts.leave(exits(self._plan))
        while True:
            with self._starting():
                if next(leaving, None) is None:
                    return
            self.settle()

    # ---- what C leaves to Python -------------------------------------------------------------

    def _initialize(self, i: int) -> None:
        step = self._plan.components[i]
        shapes = {p.name: p.shape for p in step.component.parameters}
        step.component.initialize(
            {k: np.array(v).reshape(shapes[k]) for k, v in step.values.items()}
        )

    def _say(self, i: int) -> None:
        store(self._outputs[i], self._plan.components[i].component.initial(self._inputs[i]))

    def _exit(self, i: int) -> None:
        self._take(i, exit_initialization(self._plan.components[i].component))

    def _take(self, i: int, found: Outputs) -> None:
        step = self._plan.components[i]
        for port, value in found.items():
            self._outputs[i][port][...] = value
        at = ended_at_start(step.component)
        self.ended = self.ended if at is None else Termination(step.name, at)


def _input_sources(plan: Plan, edges: Sequence[Wire | Link]) -> InputSources:
    """The sources of inputs, in the order of the wires and links of each component."""
    n, place = len(plan.components), {step.name: i for i, step in enumerate(plan.components)}
    receivers = np.array([place[e.target.component] for e in edges], np.int64)
    senders = np.array([place[e.source.component] for e in edges], np.int64)
    order = np.argsort(receivers, kind="stable")
    bringing = np.zeros(len(edges), np.dtype(BringingStruct))
    bringing["source"] = [e.source.start for e in edges]
    bringing["target"] = [e.target.start for e in edges]
    bringing["count"] = [e.source.size for e in edges]
    bringing["gain"] = [e.gain for e in edges]
    bringing["offset"] = [e.offset for e in edges]
    initial = {
        i: np.array(e.initial)
        for i, e in enumerate(edges)
        if isinstance(e, Link) and e.initial is not None
    }
    for i, values in initial.items():
        bringing["initial"][i], bringing["count"][i] = values.ctypes.data, len(values)
    by_sender = np.argsort(senders, kind="stable")
    counts = range(n + 1)
    return InputSources(
        bringing[order],
        np.searchsorted(receivers[order], counts),
        receivers[by_sender],
        np.searchsorted(senders[by_sender], counts),
        initial,
    )


def exits(plan: Plan) -> list[int]:
    """FMUs in the order in which they leave Initialization Mode: plants, then sampled components.

    An output that changes at this time is seen by the components that are still in it.
    """
    place = {name: i for i, name in enumerate(plan.order)}
    fmus = [i for i, s in enumerate(plan.components) if is_fmu(s.component)]
    return sorted(fmus, key=lambda i: place.get(plan.components[i].name, -1))


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
