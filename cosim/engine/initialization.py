"""From components to the signals of t = 0: all start, and outputs travel until nothing changes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Sequence

import numpy as np

from cosim.base.errors import RunError, ScenarioError
from cosim.engine.algebraic_loops import AlgebraicLoops
from cosim.engine.binding import Termination, Vector, Views, store
from cosim.fmi.components import exit_initialization, is_fmu
from cosim.fmi.failures import starting
from cosim.schedule.parts import Link, Slot, Step, Wire
from cosim.schedule.plan import Plan


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
    fed: defaultdict[str, list[Wire | Link]] = defaultdict(list)
    edges: list[Wire | Link] = [*plan.wires, *plan.links]
    for edge in edges:
        fed[edge.target.component].append(edge)
    for step in plan.components:
        _start(step, signals)
    for player in plan.players:
        part(signals, player.target)[:] = player.source.stream().rows(1)

    loops = AlgebraicLoops(plan, signals, inputs, edges)
    known = dict[int, bytes]()  # the inputs for which each component has said its outputs

    def iterate(unsettled: Collection[int]) -> bool:
        for _ in range(len(plan.components) + 1):
            before = signals.tobytes()
            for i, step in enumerate(plan.components):
                _gather(signals, fed[step.name])
                given = b"".join(part(signals, slot).tobytes() for slot in step.inputs)
                if i in unsettled and known.get(i) != given:
                    known[i] = given
                    with starting(step.name):
                        store(outputs[i], step.component.initial(inputs[i]))
            if signals.tobytes() == before:
                return True
        return False

    def settle(unsettled: Collection[int]) -> None:
        start, refused = signals.copy(), None
        if not loops.loops:
            try:
                if iterate(unsettled):
                    return
            except ScenarioError as error:  # perhaps of a loop that diverges
                refused = error
            signals[:] = start
        known.clear()
        if not loops.solve(unsettled) and refused is not None:
            raise refused

    unsettled = set(range(len(plan.components)))  # whose outputs may still be computed
    settle(unsettled)
    settled()
    ended = None
    for i in _exits(plan):
        unsettled.remove(i)
        step = plan.components[i]
        before = [part(signals, slot).tobytes() for slot in step.outputs]  # all it can change
        ended = _exit(step, outputs[i]) or ended
        if [part(signals, slot).tobytes() for slot in step.outputs] != before:
            settle(unsettled)
    _check(plan, signals)
    return ended


def part(signals: Vector, slot: Slot) -> Vector:
    """The signals of a slot, (size,)."""
    return signals[slot.start : slot.start + slot.size]


def _start(step: Step, signals: Vector) -> None:
    parameters = {p.name: p for p in step.component.parameters}
    values = {k: np.array(v).reshape(parameters[k].shape) for k, v in step.values.items()}
    with starting(step.name):
        step.component.initialize(values)
    for slot, port in zip(step.inputs, step.component.inputs, strict=True):
        part(signals, slot)[:] = step.start.get(port.name) or port.default or (0.0,) * port.size


def _gather(signals: Vector, fed: Sequence[Wire | Link]) -> None:
    for e in fed:
        if isinstance(e, Link) and e.initial is not None:
            part(signals, e.target)[:] = e.initial
        else:
            part(signals, e.target)[:] = e.gain * part(signals, e.source) + e.offset


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
    for step in plan.components:
        for slot in step.outputs:
            if not np.isfinite(part(signals, slot)).all():
                value = part(signals, slot).tolist()
                raise RunError(
                    f"{slot.name} = {value} at the start", component=step.name, tick=0, time=0.0
                )
