"""Algebraic loops among plants in a run: their wires carry values one step late.

At the start such a loop is solved (:mod:`cosim.engine.algebraic_loops`). In a run, without macro
steps, each component computes from the outputs that the others had a step before, which iterates
the equations once a step. A small difference from the solution changes by a factor then, which
follows from the derivatives at the start, the periods, the order, and lines through old values.
From 1 on the iteration leaves the solution, whatever the step, for another one or without a limit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import lcm
from typing import TYPE_CHECKING

import numpy as np

from cosim.base.convert import Struct
from cosim.base.errors import ScenarioError
from cosim.engine.binding import Vector, Views
from cosim.fmi import components
from cosim.schedule.order import strongly_connected
from cosim.schedule.parts import Step, Wire
from cosim.schedule.plan import Plan

if TYPE_CHECKING:
    from cosim.engine.algebraic_loops import Loop

#: A factor that is 1 but for the differences from which derivatives are taken.
KEPT = 1 - 1e-5


class PlantLoop(Struct, frozen=True):
    """A loop along `wires`; `factor`: of a difference from the solution, in one base step."""

    wires: tuple[Wire, ...]
    factor: float

    @property
    def sentence(self) -> str:
        """The loop in words, and the growth of a difference in it."""
        wires = ", ".join(f"{w.source.name} -> {w.target.name}" for w in self.wires)
        return (
            f"outputs of plants depend on each other at once, by {wires}: an algebraic loop. These"
            f" wires carry values one step late, which multiplies a difference from its solution by"
            f" {self.factor:.3g} in each base step"
        )


def plant_loops(plan: Plan, signals: Vector, inputs: Sequence[Views]) -> list[PlantLoop]:
    """The loops among plants, while all components are in their initial states, to which they go
    back.

    `signals` (n_signals,), in their units; `inputs`: those of each component, as views. Raises
    ScenarioError for a loop whose iteration does not come closer to the solution.
    """
    names = possible_loops(plan)
    if not names:
        return []
    from cosim.engine.algebraic_loops import AlgebraicLoops

    kept = signals.copy()
    edges = [w for w in plan.wires if {w.source.component, w.target.component} <= names]
    numbers = {i for i, step in enumerate(plan.components) if step.name in names}
    found = [
        PlantLoop(tuple(w for w in loop.wires() if isinstance(w, Wire)), _factor(plan, loop))
        for loop in AlgebraicLoops(plan, signals, inputs, edges, start=False).blocks(numbers)
    ]
    signals[:] = kept
    for loop in found:
        if loop.factor >= KEPT:
            raise ScenarioError(
                f"{loop.sentence}: it does not stay at the solution. Expected a factor below 1, or"
                ' algorithm = "adaptive", which solves such loops; a state (a filter, a compliance)'
                " in one of the components breaks the loop"
            )
    return found


def possible_loops(plan: Plan) -> frozenset[str]:
    """The plants that wires connect to a circle without a break that is known beforehand.

    None with macro steps, which solve their loops. An FMU that declares its dependencies breaks a
    circle where no output depends on the input; of others, all may.
    """
    plants = {s.name: s for s in plan.components if s.component.kind == "continuous"}
    if plan.algorithm == "adaptive":
        return frozenset()
    wires = [w for w in plan.wires if {w.source.component, w.target.component} <= plants.keys()]
    around = [(w.source.component, w.target.component) for w in wires]
    circles = [b for b in strongly_connected(plants, around) if len(b) > 1]
    near = {n for block in circles for n in block} | {a for a, b in around if a == b}
    wires = [w for w in wires if {w.source.component, w.target.component} <= near]
    pairs = [(w.source.name, w.target.name) for w in wires]
    for name in sorted(near):
        pairs += _through(
            plants[name], frozenset(w.target.port for w in wires if w.target.component == name)
        )
    ports = {port for pair in pairs for port in pair}
    blocks = [b for b in strongly_connected(ports, pairs) if len(b) > 1]
    return frozenset(port.split(".")[0] for block in blocks for port in block)


def _through(step: Step, fed: frozenset[str]) -> Iterator[tuple[str, str]]:
    """Pairs (input, output) of which the second may depend on the first at once."""
    declared = components.feedthrough(step.component)
    for slot in step.outputs:
        for port in sorted(declared.get(slot.port, fed) & fed - step.discrete):
            yield f"{step.name}.{port}", slot.name


def _factor(plan: Plan, loop: Loop) -> float:
    """The growth of a difference of a loop in one base step.

    A run of its linear equations over the least common period, from every difference: `v` is on the
    wires, `held` in the inputs, `before` there one step of the receiver earlier.
    """
    J, (sources, targets) = loop.derivatives(), loop.ends()
    steps = {name: plan.component(name) for name in sorted({*sources, *targets})}
    newest = [n for n in plan.later if n in steps] if plan.algorithm == "gauss-seidel" else []
    order = newest or sorted(steps)
    whole = lcm(*(s.period for s in steps.values()))
    n, rows = len(J), np.arange(len(J))
    earlier = np.array([s in newest and order.index(s) < order.index(t)
                        for s, t in zip(sources, targets, strict=True)])  # fmt: skip
    line = np.array([steps[t].extrapolate for t in targets])[:, None]
    into = {name: rows[[t == name for t in targets]] for name in steps}
    out = {name: rows[[s == name for s in sources]] for name in steps}
    v, held, before = np.split(np.eye(3 * n), 3)
    for tick in range(whole):
        for name in order:
            if tick % steps[name].period == 0:
                i = into[name]
                held[i] = np.where(line[i], 1.5 * v[i] - 0.5 * before[i], v[i])
                before[i] = v[i]
        for name in order:
            if (tick + 1) % steps[name].period == 0:
                i = into[name][earlier[into[name]]]
                held[i] = np.where(line[i], 0.5 * (v[i] + before[i]), v[i])
                v[out[name]] = J[np.ix_(out[name], into[name])] @ held[into[name]]
    most = np.abs(np.linalg.eigvals(np.vstack([v, held, before]))).max()
    return float(most ** (1.0 / whole))


def late_outputs(plan: Plan, inputs: Sequence[Views]) -> list[str]:
    """The outputs that wires carry on to plants and that belong to the middle of a step, by name.

    These depend directly on an input that takes the mean of a line. At the end of the step they are
    half a step old. The components are in their initial states, to which they go back. `inputs`:
    views (n,) of those of each component, in their units.
    """
    carried = [w for w in plan.wires if plan.component(w.source.component).kind == "continuous"]
    found = set()
    for number, step in enumerate(plan.components):
        held = step.discrete | step.sloped
        into = {w.target.port for w in carried if w.target.component == step.name} - held
        if not step.extrapolate or not into:
            continue
        from cosim.engine.feedthrough import direct_outputs

        mask = np.any([*direct_outputs(step, inputs[number], into).values()], axis=0)
        at = 0
        for slot in step.outputs:
            if mask[at : at + slot.size].any():
                found.add(slot.name)
            at += slot.size
    plants = {
        w.source.name for w in carried if plan.component(w.target.component).kind == "continuous"
    }
    return sorted(found & plants)
