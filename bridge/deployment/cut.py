"""Divide a plan into the plans of its nodes, and find the connections between nodes.

A wire or link whose two ends are in different nodes leaves through an outlet (a message of a bus)
and enters through an inlet. Everything else is unchanged, in the signal vector of the node and on
the tick of the node, which is the greatest common period of its components.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from math import gcd

import numpy as np
from numpy.typing import NDArray

from bridge.deployment.crossing import Crossing, crossings, node_of_component
from bridge.deployment.gateways import Forward, carried_signals, forwards
from bridge.deployment.spec import Deployment, MessageSpec, NodeSpec
from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.engine.engine import Engine
from cosim.schedule.parts import Gate, Link, Slot, Step, Wire
from cosim.schedule.plan import Plan, compile_plan

Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Outlet:
    """A message that leaves: the values of `parts` (slots of the node), in this order.

    `period`: hits of the component between two messages; `ticks`: base ticks between two.
    """

    gate: str
    message: str
    bus: str
    component: str
    carries: tuple[str, ...]
    parts: tuple[Slot, ...]
    period: int
    ticks: int

    @property
    def width(self) -> int:
        """Number of values."""
        return sum(p.size for p in self.parts)


@dataclass(frozen=True, slots=True)
class Inlet:
    """Values of a message, from index `first`, that go to `target` as gain * value + offset.

    `link`: the link whose latency the receiver adds; None: a wire. `age`: the input that receives
    the age of the sample that a link holds, s. `ticks`: base ticks between two steps of the
    receiver; `source`: the slot of the source in the whole plan.
    """

    gate: str
    message: str
    sender: str
    component: str
    target: Slot
    source: Slot
    first: int
    gain: float
    offset: float
    link: Link | None
    age: Slot | None
    ticks: int


@dataclass(frozen=True, slots=True)
class NodePlan:
    """The plan that one node executes: a slot is `ticks` base ticks long, `h` seconds.

    `guarded`: torques of the node's guard that are used in the node itself; the gate of each is
    :func:`guard_gate`.
    """

    name: str
    plan: Plan
    ticks: int
    inlets: tuple[Inlet, ...]
    outlets: tuple[Outlet, ...]
    forwards: tuple[Forward, ...] = ()
    guarded: tuple[Slot, ...] = ()

    @property
    def h(self) -> float:
        """Length of a slot, s."""
        return self.plan.h

    @property
    def slots(self) -> int:
        """Slots of the whole run."""
        return self.plan.ticks


def cut_plan(plan: Plan, deployment: Deployment, start: Vector) -> dict[str, NodePlan]:
    """Return the plans of the nodes, by name. Raises ScenarioError if the deployment does not fit.

    `start`: the signal vector (n_signals,) of the initialized plan, in the units of the signals
    (:func:`start_values`). Inputs from other nodes hold these values until the first sample.
    """
    if plan.algorithm != "sampled":
        raise ScenarioError(
            f'algorithm = "{plan.algorithm}" cannot be cut into nodes; expected "sampled"',
            str(deployment.path),
        )
    forwarded = forwards(plan, deployment)
    crossing = crossings(plan, deployment, node_of_component(plan, deployment), forwarded)
    return {
        name: replace(
            _node(name, spec, plan, deployment, crossing, start),
            forwards=tuple(f for f in forwarded.values() if f.by == name),
        )
        for name, spec in deployment.nodes.items()
    }


def start_values(plan: Plan) -> Vector:
    """Return the signal vector (n_signals,) of a plan at its start, in the units of the signals.

    The components of the plan cannot be used afterwards.
    """
    with Engine(plan) as engine:
        engine.initialize()
        return engine.signals.copy()


def _whole(slot: Slot) -> str:
    return f"{slot.component}.{slot.port}"


# ---- one node -------------------------------------------------------------------------------


def _node(
    name: str,
    spec: NodeSpec,
    plan: Plan,
    d: Deployment,
    crossing: Sequence[Crossing],
    start: Vector,
) -> NodePlan:
    remote = {_whole(x.edge.target) for x in crossing}
    here = [
        _with_start_values(c, remote, start) for c in plan.components if c.name in spec.components
    ]
    ticks = gcd(*(c.period for c in here)) or _step(name, spec, plan, d)
    steps, moved = _steps(here, ticks)
    outlets = [
        _outlet(key, m, plan, d, moved, ticks)
        for key, m in sorted(d.messages.items())
        if not m.forwards and m.carries[0].partition(".")[0] in spec.components
    ]
    inlets = [
        _inlet(x, plan, moved) for x in crossing if x.edge.target.component in spec.components
    ]
    gates = {o.gate: Gate(o.gate, o.component, out=True) for o in outlets}
    gates |= {i.gate: Gate(i.gate, i.component, out=False) for i in inlets}
    edges: list[Wire | Link] = [*plan.wires, *plan.links]
    inside = [e for e in edges if {e.source.component, e.target.component} <= set(spec.components)]
    guarded = _guarded(spec, steps, inside)
    gates |= {guard_gate(s): Gate(guard_gate(s), s.component, out=True) for s in guarded}
    found = compile_plan(
        plan.h * ticks,
        plan.ticks // ticks,
        steps,
        [_moved_wire(e, moved) for e in inside if isinstance(e, Wire)],
        [_moved_link(e, moved) for e in inside if isinstance(e, Link)],
        plan.algorithm,
        [
            replace(p, target=_move(p.target, moved))
            for p in plan.players
            if p.target.component in spec.components
        ],
        gates=gates.values(),
    )
    return NodePlan(name, found, ticks, tuple(inlets), tuple(outlets), guarded=guarded)


def guard_gate(torque: Slot) -> str:
    """The gate at which a torque is guarded that stays in its node."""
    return f"guard {torque.name}"


def _guarded(
    spec: NodeSpec, steps: Sequence[Step], inside: Sequence[Wire | Link]
) -> tuple[Slot, ...]:
    """Torques of the guard that go to components of the same node."""
    if spec.guard is None:
        return ()
    used = {_whole(e.source) for e in inside}
    return tuple(
        s for step in steps for s in step.outputs if s.port == spec.guard.port and s.name in used
    )


def _step(name: str, spec: NodeSpec, plan: Plan, d: Deployment) -> int:
    """Base ticks of a slot of a gateway."""
    if spec.step is None:
        return 1
    place = ("nodes", name, "step")
    return _multiple(d.seconds(spec.step, *place), plan.h, "the base step", d.place(*place))


def _multiple(seconds: float, of: float, what: str, place: str) -> int:
    """The number of times that `of` (s) fits. Raises ScenarioError if this is not a whole number.

    `what`: the owner of the period `of`, for the message.
    """
    found = round(seconds / of)
    if found < 1 or abs(found * of - seconds) > 1e-9:
        raise ScenarioError(f"{seconds:g} s is no multiple of {what} {of:g} s", place)
    return found


def _with_start_values(step: Step, remote: Collection[str], start: Vector) -> Step:
    """With what inputs from other nodes hold at the start."""
    given = {
        s.port: tuple(start[s.start : s.start + s.size].tolist())
        for s in step.inputs
        if s.name in remote
    }
    return replace(step, start={**step.start, **given})


def _steps(here: Sequence[Step], ticks: int) -> tuple[list[Step], dict[str, int]]:
    """The components on the node's tick, and where each port begins in its signal vector."""
    moved: dict[str, int] = {}
    start = 0
    steps = []
    for c in here:
        places: list[Slot] = []
        for slot in (*c.inputs, *c.outputs):
            moved[slot.name] = start - slot.start
            places.append(replace(slot, start=start))
            start += slot.size
        n = len(c.inputs)
        steps.append(
            replace(
                c, inputs=tuple(places[:n]), outputs=tuple(places[n:]), period=c.period // ticks
            )
        )
    return steps, moved


def _move(slot: Slot, moved: Mapping[str, int]) -> Slot:
    return replace(slot, start=slot.start + moved[_whole(slot)])


def _moved_wire(w: Wire, moved: Mapping[str, int]) -> Wire:
    return replace(w, source=_move(w.source, moved), target=_move(w.target, moved))


def _moved_link(x: Link, moved: Mapping[str, int]) -> Link:
    age = None if x.age is None else _move(x.age, moved)
    return replace(x, source=_move(x.source, moved), target=_move(x.target, moved), age=age)


def _outlet(
    key: str, m: MessageSpec, plan: Plan, d: Deployment, moved: Mapping[str, int], ticks: int
) -> Outlet:
    component = m.carries[0].partition(".")[0]
    step = plan.component(component)
    parts = carried_signals(plan, m, d.place("messages", key, "carries"))
    every = 1
    if m.period is not None:
        place = ("messages", key, "period")
        seconds, of = d.seconds(m.period, *place), step.period * plan.h
        every = _multiple(seconds, of, f"{component}'s period", d.place(*place))
    return Outlet(
        gate=f"out {key}",
        message=key,
        bus=m.bus,
        component=component,
        carries=m.carries,
        parts=tuple(_move(part, moved) for part in parts),
        period=every,
        ticks=every * step.period,
    )


def _inlet(x: Crossing, plan: Plan, moved: Mapping[str, int]) -> Inlet:
    e = x.edge
    link = e if isinstance(e, Link) else None
    return Inlet(
        gate=f"in {e.target.name}",
        message=x.message,
        sender=e.source.component,
        component=e.target.component,
        target=_move(e.target, moved),
        source=e.source,
        first=x.first,
        gain=e.gain,
        offset=e.offset,
        link=link,
        age=None if link is None or link.age is None else _move(link.age, moved),
        ticks=plan.component(e.target.component).period,
    )
