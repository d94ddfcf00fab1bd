"""The engine's oracle: the same plan, executed operation by operation in plain Python.

It is short and simple by design. FMUs are stepped through their Component interface (one ctypes
call per FMI function), everything else is list arithmetic.
"""

from __future__ import annotations

import numpy as np

from cosim.engine.algebraic_loops import AlgebraicLoops
from cosim.fmi import FmuComponent
from cosim.native.enums import Code
from cosim.schedule.parts import Link, Player, Slot, Step
from cosim.schedule.plan import Plan
from tests.cosim.oracle_macro import OracleGroup


def execute(plan: Plan) -> np.ndarray:
    """Run a plan from start to stop; returns (ticks + 1, n_signals), as a recording is."""
    signals, groups = start(plan)
    tables = [link.table.stream().rows(_hits(plan, link)) for link in plan.links]
    sent: list[list[np.ndarray]] = [[] for _ in plan.links]
    before = [signals[_range(link.target)].copy() for link in plan.links]
    played = [p.source.stream().rows(_hits(plan, p)) for p in plan.players]
    now = [-1] * len(plan.links)
    for op in (o for o in plan.operations if o.code in (Code.AHEAD, Code.BETWEEN)):
        signals[op.index : op.index + op.count] = signals[op.target : op.target + op.count]
    rows = []
    for tick in range(plan.ticks):
        for op in plan.operations:
            if tick < op.first or (tick - op.first) % op.period:
                continue
            source, target = (
                slice(op.source, op.source + op.count),
                slice(op.target, op.target + op.count),
            )
            if op.code == Code.COPY:
                signals[target] = signals[source]
            elif op.code == Code.SCALE:
                signals[target] = op.gain * signals[source] + op.offset
            elif op.code in (Code.AHEAD, Code.BETWEEN):
                last = slice(op.index, op.index + op.count)
                value = op.gain * signals[source] + op.offset
                half = 0.5 if op.code == Code.AHEAD else -0.5
                signals[target] = value + half * (value - signals[last])
                signals[last] = value
            elif op.code == Code.PUSH:
                plain = (op.gain, op.offset) == (1.0, 0.0)
                value = signals[source].copy()
                sent[op.index].append(value if plain else op.gain * value + op.offset)
            elif op.code == Code.PULL:
                held = tables[op.index][tick // op.period]
                signals[target] = before[op.index] if held < 0 else sent[op.index][held]
                now[op.index] = held
            elif op.code == Code.AGE:
                signals[op.target] = (tick - max(now[op.index], 0) * op.source) * plan.h
            elif op.code == Code.PLAY:
                signals[op.target] = played[op.index][tick // op.period]
            elif op.code == Code.STEP:
                step = plan.components[op.index]
                first = tick - (0 if step.name in plan.order else step.period - 1)
                u = _values(signals, step.inputs)
                y = step.component.step(first * plan.h, step.period * plan.h, u)
                _store(signals, step, y)
            elif op.code == Code.MACRO:
                groups[op.index].period(tick)
            elif op.code == Code.RECORD:
                rows.append(signals.copy())
    rows.append(signals.copy())
    return np.array(rows)


def start(plan: Plan) -> tuple[np.ndarray, list[OracleGroup]]:
    """Signals at the start: initial outputs travel along every connection until nothing changes.

    And the groups with macro steps.
    """
    signals = np.zeros(plan.n_signals)
    for step in plan.components:
        shapes = {p.name: p.shape for p in step.component.parameters}
        step.component.initialize({k: np.reshape(v, shapes[k]) for k, v in step.values.items()})
        for slot, port in zip(step.inputs, step.component.inputs, strict=True):
            signals[_range(slot)] = step.start.get(port.name) or port.default or 0.0
    inside = {s.name for s in plan.components}  # whose outputs may still be computed
    views = [{s.port: signals[_range(s)].reshape(s.shape) for s in step.inputs}
             for step in plan.components]  # fmt: skip
    loops = AlgebraicLoops(plan, signals, views, [*plan.wires, *plan.links])
    _travel(plan, signals, inside, loops)
    groups = [OracleGroup(plan, group, signals) for group in plan.groups]
    fmus = [s for s in plan.components if isinstance(s.component, FmuComponent)]
    plants = [s for s in fmus if s.name not in plan.order]
    sampled = [plan.component(n) for n in plan.order if plan.component(n) in fmus]
    for step in (*plants, *sampled):
        inside.remove(step.name)
        found = step.component.exit_initialization()
        for slot in step.outputs:
            if slot.port in found:
                signals[_range(slot)] = np.reshape(found[slot.port], -1)
        _travel(plan, signals, inside, loops)
    return signals, groups


def _travel(plan: Plan, signals: np.ndarray, inside: set[str], loops: AlgebraicLoops) -> None:
    """Outputs along connections; loops that do not come to rest are solved as the engine does."""
    start = signals.copy()
    for _ in range(len(plan.components) + 1):
        before = signals.tobytes()
        for step in plan.components:
            for edge in (*plan.wires, *plan.links):
                if edge.target.component == step.name:
                    value = edge.gain * signals[_range(edge.source)] + edge.offset
                    given = getattr(edge, "initial", None)
                    signals[_range(edge.target)] = value if given is None else given
            if step.name in inside:
                _store(signals, step, step.component.initial(_values(signals, step.inputs)))
        if signals.tobytes() == before:
            return
    signals[:] = start
    loops.solve([i for i, step in enumerate(plan.components) if step.name in inside])


def _range(slot: Slot) -> slice:
    return slice(slot.start, slot.start + slot.size)


def _values(signals: np.ndarray, slots: tuple[Slot, ...]) -> dict[str, np.ndarray]:
    return {s.port: signals[_range(s)].reshape(s.shape).copy() for s in slots}


def _store(signals: np.ndarray, step: Step, y: object) -> None:
    for slot in step.outputs:
        signals[_range(slot)] = np.reshape(y[slot.port], -1)  # type: ignore[index]


def _hits(plan: Plan, fed: Link | Player) -> int:
    return -(-plan.ticks // plan.component(fed.target.component).period)
