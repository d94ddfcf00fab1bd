"""States in which the robots of a scenario rest: the points about which its loop is linearized."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from cosim.base.convert import Struct
from cosim.engine.memory_run import Change, changed
from cosim.linear.loop import OperatingPoint, operating_point
from cosim.predict.facts import DynamicFeedback
from cosim.predict.system import AnalyzedSystem
from cosim.schedule.parts import Link, Wire
from cosim.schedule.plan import Plan

#: Depth to which an arm is pressed into its wall, rad.
PRESSED = 0.02
Starts = Mapping[str, Mapping[str, Sequence[float]]]


class RestState(Struct, frozen=True):
    """Robots at rest: the plan that starts so, and its operating point there."""

    plan: Plan
    point: OperatingPoint


def rest(system: AnalyzedSystem, plan: Plan, postures: Starts, *, exact: bool = False) -> RestState:
    """The robots of `plan` at rest in `postures`, start values by arm.

    `exact`: with the inertia as estimate, else with the estimates of the start. Raises CosimError.
    """
    values: dict[str, dict[str, Sequence[float]]] = {}
    for arm, facts in system.arms.items():
        given = {facts.position: facts.q, facts.rate: (0.0,), **postures.get(arm, {})}
        values[arm] = _settable(plan, arm, given)
        control = system.controls.get(arm, "")
        law = system.facts.get(control)
        if isinstance(law, DynamicFeedback):
            still: dict[str, Sequence[float]] = {"z": (0.0,)}
            if exact and law.estimate:
                size = len(law.theta_hat)
                still[law.estimate] = (*facts.parameters, *law.theta_hat[len(facts.parameters) :])
                if len(still[law.estimate]) != size:
                    del still[law.estimate]
            values.setdefault(control, {}).update(_settable(plan, control, still))
    there = changed(plan, Change(plan.ticks * plan.h, values))
    return RestState(there, operating_point(there, there.start))


def _settable(
    plan: Plan, name: str, given: Mapping[str, Sequence[float]]
) -> dict[str, Sequence[float]]:
    step = plan.component(name)
    known = {p.name for p in step.component.parameters}
    known |= {p.name for p in step.component.inputs}
    return {key: value for key, value in given.items() if key in known and len(value)}


def goals(system: AnalyzedSystem) -> dict[str, dict[str, Sequence[float]]]:
    """The posture in which each arm will rest, rad: where a hand wants it or one coupled to it.

    Without a hand it is the mean of the starts of the arms that are coupled.
    """
    found: dict[str, dict[str, Sequence[float]]] = {}
    for group in groups(system):
        places = [hand.place for name in group if (hand := system.hand(name)) is not None]
        starts = [system.arms[name].q for name in group]
        alike = len({len(q) for q in starts}) == 1
        mean = tuple(np.mean(starts, axis=0).tolist()) if alike else ()
        if any(_has_task(system, name) for name in group):
            continue
        for name in group:
            arm = system.arms[name]
            place = places[0] if places else mean
            if len(place) == len(arm.q):
                found[name] = {arm.position: place}
    return found


def heaviest(system: AnalyzedSystem) -> dict[str, dict[str, Sequence[float]]]:
    """The heaviest posture of the first arm of a group, rad, for all of it; none with tasks."""
    found: dict[str, dict[str, Sequence[float]]] = {}
    for group in groups(system):
        if any(_has_task(system, name) for name in group):
            continue
        posture = system.arms[group[0]].heaviest
        for name in group:
            arm = system.arms[name]
            if len(posture) == len(arm.q):
                hand = {arm.grip.names[2]: posture} if arm.grip.is_present else {}
                found[name] = {arm.position: posture, **hand}
    return found


def against_walls(system: AnalyzedSystem) -> dict[str, dict[str, Sequence[float]]]:
    """The goals, rad, with arms pressed into their walls by :data:`PRESSED`; none without walls."""
    found = goals(system)
    walls = {name: arm for name, arm in system.arms.items() if arm.wall.is_present}
    for name, arm in walls.items():
        if name not in found:
            return {}
        beyond = np.asarray(arm.wall.place) + PRESSED
        stiff = np.broadcast_to(np.asarray(arm.wall.stiffness) > 0, beyond.shape)
        q = np.where(stiff, beyond, found[name][arm.position])
        found[name] = {arm.position: tuple(q.tolist())}
    return found if walls else {}


def _has_task(system: AnalyzedSystem, arm: str) -> bool:
    law = system.facts.get(system.controls.get(arm, ""))
    return isinstance(law, DynamicFeedback) and law.task is not None


def groups(system: AnalyzedSystem) -> list[list[str]]:
    """Arms in groups that are connected by links or wires between their controllers."""
    owner = {c: arm for arm, c in system.controls.items()} | {arm: arm for arm in system.arms}
    return system.once("arms together", "", partial(_groups, system, owner))


def _groups(system: AnalyzedSystem, owner: Mapping[str, str]) -> list[list[str]]:
    leader = {s.name: s.name for s in system.plan.components}

    def top(name: str) -> str:
        while leader[name] != name:
            name = leader[name]
        return name

    edges: tuple[Wire | Link, ...] = (*system.plan.wires, *system.plan.links)
    for edge in edges:
        leader[top(edge.source.component)] = top(edge.target.component)
    found: dict[str, list[str]] = {}
    for arm in system.arms:
        found.setdefault(top(arm), []).append(arm)
    return list(found.values())
