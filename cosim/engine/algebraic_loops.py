"""Outputs at the start where components wait for each other: algebraic loops, solved by Newton.

An output with direct feed-through and a wire make an input depend on another one at once. Inputs
and outputs are the nodes of a graph; its strongly connected components with more than one node are
the loops, and everything else is computed in topological order (Cellier and Kofman, Continuous
System Simulation, ch. 7). In a loop the unknowns are the inputs u that its wires feed::

    r(u) = u - (gain y(u) + offset) = 0        u <- u - s (dr/du)^-1 r

The derivatives are those of an FMU that has them, else differences. The step is halved (s) until r
decreases.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

from cosim.base.errors import CosimError, ScenarioError
from cosim.engine.binding import Vector, Views, part
from cosim.engine.feedthrough import dependent_outputs, initial_outputs
from cosim.fmi import components
from cosim.fmi.components import output_derivatives
from cosim.schedule.order import strongly_connected
from cosim.schedule.parts import Link, Slot, Wire
from cosim.schedule.plan import Plan

#: Steps of Newton's method, halvings of one, and the residual that is no more than rounding.
STEPS, HALVINGS, ROUNDING = 50, 30, 1e-9

Edge = Wire | Link


@dataclass(slots=True)
class AlgebraicLoops:
    """The inputs and outputs of a plan whose components are in their initial states.

    `signals` (n_signals,); `inputs`: those of each component, as views; `edges`: what feeds inputs;
    `start`: which dependencies of FMUs hold, those of the start or those of a run.
    `loops`: the ports of each loop of the last solution, along its wires.
    """

    plan: Plan
    signals: Vector
    inputs: Sequence[Views]
    edges: Sequence[Edge]
    start: bool = True
    loops: list[tuple[str, ...]] = field(default_factory=list)
    _numbers: dict[str, int] = field(default_factory=dict)
    _edges: dict[str, list[Edge]] = field(default_factory=dict)
    _direct: dict[int, list[tuple[str, str]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Number the components, and sort the edges by the inputs that they feed."""
        self._numbers = {step.name: i for i, step in enumerate(self.plan.components)}
        for e in self.edges:
            self._edges.setdefault(_port(e.target), []).append(e)

    def solve(self, unsettled: Collection[int]) -> bool:
        """Compute all inputs, and the outputs of the `unsettled` components, in order.

        Returns whether there was a loop. Raises ScenarioError for a loop without a solution.
        """
        blocks = self._blocks(unsettled)
        self.loops = [block for block in blocks if len(block) > 1]
        slots = self.plan.slots()
        for block in blocks:
            if len(block) > 1:
                Loop(self, block).solve()
                continue
            self.gather(self.edges_to(block[0]))
            number = self.number(slots[block[0]])
            if number in unsettled:
                self.put(number, self.outputs_of(number), block)
        return bool(self.loops)

    def blocks(self, numbers: Collection[int]) -> list[Loop]:
        """The loops through the components of these `numbers`, at their present values."""
        return [Loop(self, block) for block in self._blocks(numbers) if len(block) > 1]

    def _blocks(self, unsettled: Collection[int]) -> list[tuple[str, ...]]:
        """Ports in topological order, those of a loop together."""
        pairs = [(_port(e.source), _port(e.target)) for e in self.edges if _initial(e) is None]
        for i in sorted(unsettled):
            if i not in self._direct:
                self._direct[i] = self._feedthrough(i)
            pairs += self._direct[i]
        names = [s.name for c in self.plan.components for s in (*c.inputs, *c.outputs)]
        return strongly_connected(names, pairs)

    def _feedthrough(self, number: int) -> list[tuple[str, str]]:
        """Pairs (input, output) of a component of which the second depends on the first at once."""
        step = self.plan.components[number]
        declared = components.feedthrough(step.component, start=self.start)
        fed = {e.target.port for e in self.edges if e.target.component == step.name}
        fed -= step.discrete  # what jumps is not solved for
        found = [
            (f"{step.name}.{port}", slot.name)
            for slot in step.outputs
            for port in sorted(declared.get(slot.port, frozenset()) & fed)
        ]
        open_ = [slot for slot in step.outputs if slot.port not in declared]
        places = [(p, i) for p in sorted(fed) for i in range(self.inputs[number][p].size)]
        if not open_ or not places:
            return found
        masks = dependent_outputs(step, self.inputs[number], places)
        first = self.first(number)
        for (port, _), mask in zip(places, masks, strict=True):
            for slot in open_:
                if mask[first[slot.name] : first[slot.name] + slot.size].any():
                    found.append((f"{step.name}.{port}", slot.name))
        return list(dict.fromkeys(found))

    def first(self, number: int) -> dict[str, int]:
        """The place of each output among all outputs of a component."""
        found, at = {}, 0
        for slot in self.plan.components[number].outputs:
            found[slot.name] = at
            at += slot.size
        return found

    def number(self, slot: Slot) -> int:
        """The number of the component of a slot."""
        return self._numbers[slot.component]

    def edges_to(self, port: str) -> Sequence[Edge]:
        """The edges that feed an input; nothing feeds an output."""
        return self._edges.get(port, ())

    def gather(self, edges: Sequence[Edge]) -> None:
        """Carry values along edges to their inputs."""
        for e in edges:
            initial = _initial(e)
            value = e.gain * part(self.signals, e.source) + e.offset
            part(self.signals, e.target)[:] = value if initial is None else initial

    def outputs_of(self, number: int) -> Vector:
        """All outputs of a component for its inputs as they stand, (scalars,), in their units."""
        return initial_outputs(self.plan.components[number], self.inputs[number])

    def put(self, number: int, values: Vector, names: Collection[str]) -> None:
        """Put outputs of these names into the signals; `values` (scalars,): all, in their units."""
        first = self.first(number)
        for slot in self.plan.components[number].outputs:
            if slot.name in names:
                at = first[slot.name]
                part(self.signals, slot)[:] = values[at : at + slot.size]


class Loop:
    """One loop: its ports, and the edges inside it, whose targets are the unknowns."""

    def __init__(self, system: AlgebraicLoops, ports: Sequence[str]) -> None:
        self._system, self._ports = system, frozenset(ports)
        slots = system.plan.slots()
        edges = [e for port in ports for e in system.edges_to(port)]
        self._edges = [e for e in edges if self._inside(e.source) and _initial(e) is None]
        system.gather([e for e in edges if e not in self._edges])
        self._components = sorted({system.number(slots[p]) for p in ports})
        self._places = np.concatenate(
            [np.arange(e.target.start, e.target.start + e.target.size) for e in self._edges]
        )

    def _inside(self, slot: Slot) -> bool:
        return _port(slot) in self._ports

    def solve(self) -> None:
        """Set the signals of the loop. Raises ScenarioError without a solution."""
        u = self._system.signals[self._places].copy()
        r = self._residual(u)
        for _ in range(STEPS):
            if not r.any():
                return
            u, r, better = self._shorter(u, r, self._direction(u, r))
            if not better:
                break
        if not (np.abs(r) <= ROUNDING * np.maximum(1.0, np.abs(u))).all():
            raise ScenarioError(self._refusal(u, r))

    def wires(self) -> Sequence[Edge]:
        """The wires that feed the unknowns, from inside the loop."""
        return self._edges

    def ends(self) -> tuple[list[str], list[str]]:
        """The component from which each unknown comes, and the one that takes it."""
        each = [e for e in self._edges for _ in range(e.target.size)]
        return [e.source.component for e in each], [e.target.component for e in each]

    def derivatives(self) -> Vector:
        """Derivatives of what wires bring by the unknowns, (unknowns, unknowns), in their units."""
        u = self._system.signals[self._places].copy()
        found = np.eye(len(u)) - self._jacobian(u, self._residual(u))
        self._residual(u)
        return found

    def _shorter(self, u: Vector, r: Vector, direction: Vector) -> tuple[Vector, Vector, bool]:
        """The first step along a direction that makes the residual smaller, and if there is one."""
        length, size = 1.0, float(np.linalg.norm(r))
        for _ in range(HALVINGS):
            trial = u + length * direction
            found = self._tried(trial)
            if found is not None and float(np.linalg.norm(found)) < (1.0 - 0.1 * length) * size:
                return trial, found, True
            length *= 0.5
        self._residual(u)
        return u, r, False

    def _tried(self, u: Vector) -> Vector | None:
        """The residual; None where a component refuses such inputs, or gives no number."""
        try:
            found = self._residual(u)
        except CosimError:
            return None
        return found if np.isfinite(found).all() else None

    def _residual(self, u: Vector, only: int | None = None) -> Vector:
        """The difference of what the wires bring and `u` (unknowns,), in units of inputs; sets
        signals.

        `only`: the component whose inputs alone have changed.
        """
        system = self._system
        system.signals[self._places] = u
        for number in self._components if only is None else (only,):
            system.put(number, system.outputs_of(number), self._ports)
        brought = [e.gain * part(system.signals, e.source) + e.offset for e in self._edges]
        return u - np.concatenate(brought)

    def _direction(self, u: Vector, r: Vector) -> Vector:
        """Newton's step, (unknowns,): the least one where the derivatives are singular."""
        return np.linalg.lstsq(self._jacobian(u, r), -r, rcond=None)[0].astype(np.float64)

    def _jacobian(self, u: Vector, r: Vector) -> Vector:
        """Derivatives of the residual by the unknowns, (unknowns, unknowns)."""
        jacobian = np.empty((len(u), len(u)))
        owners = [self._system.number(e.target) for e in self._edges for _ in range(e.target.size)]
        for k, owner in enumerate(owners):
            column = self._given_column(k, owner)
            if column is not None:
                jacobian[:, k] = column
                continue
            changed = u.copy()
            change = 1e-7 * max(1.0, abs(u[k]))
            changed[k] += change
            found = self._changed(changed, owner)
            if found is None:
                change = -change
                changed[k] = u[k] + change
                found = self._changed(changed, owner)
            jacobian[:, k] = 0.0 if found is None else (found - r) / change
            self._residual(u, owner)
        return jacobian

    def _given_column(self, k: int, owner: int) -> Vector | None:
        """Derivatives of the residual by unknown `k`, (unknowns,), if its FMU has them."""
        step, place = self._system.plan.components[owner], int(self._places[k])
        slot = next(s for s in step.inputs if s.start <= place < s.start + s.size)
        given = output_derivatives(step.component, slot.port, place - slot.start)
        if given is None:
            return None
        rates = np.zeros(self._system.plan.n_signals)
        for output in step.outputs:
            part(rates, output)[:] = given.get(output.port, 0.0)
        column = -np.concatenate([e.gain * part(rates, e.source) for e in self._edges])
        column[k] += 1.0
        return column

    def _changed(self, u: Vector, owner: int) -> Vector | None:
        try:
            return self._residual(u, owner)
        except CosimError:
            return None

    def _refusal(self, u: Vector, r: Vector) -> str:
        worst = int(np.argmax(np.abs(r)))
        names = [name for e in self._edges for name in e.target.scalars()]
        wires = ", ".join(f"{e.source.name} -> {e.target.name}" for e in self._edges)
        return (
            f"the algebraic loop {wires} has no solution at the start that Newton's method finds: "
            f"{names[worst]} = {u[worst]:g} differs by {abs(r[worst]):.3g} from what the others "
            "give for it. Expected a loop with a solution; a link with an initial value breaks it"
        )


def _port(slot: Slot) -> str:
    return f"{slot.component}.{slot.port}"


def _initial(edge: Edge) -> tuple[float, ...] | None:
    """The value that an edge brings whatever its source is."""
    return edge.initial if isinstance(edge, Link) else None
