"""Roles in a plan: arms, the laws that control them, and the delayed edges between them.

The roles follow from the wires and links and from the facts of the models, without a run. An edge
(i, k) is row k of the signal that law i receives. Its sender is the law whose arm, or whose own
output, is the source of the row, also through other components.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping
from functools import cached_property, lru_cache
from math import nan
from typing import Any, TypeVar

from cosim.base.convert import Struct, field
from cosim.base.copies import replace
from cosim.predict.ages import LOOKS, Age, age, kind_of
from cosim.predict.facts import (
    Arm,
    DynamicFeedback,
    Facts,
    Hand,
    Servo,
    ServoCommand,
    SpringDamper,
    combined_hand,
    facts_function,
)
from cosim.predict.inputs import feeders, is_driven, start_value
from cosim.scenario.connect import EdgeWeight
from cosim.scenario.spec import Scenario
from cosim.schedule.parts import Link, Player, Slot, Step, Wire
from cosim.schedule.plan import Feeder, Plan

T = TypeVar("T")
F = TypeVar("F", Arm, DynamicFeedback, SpringDamper, Hand, Servo, ServoCommand)


class Edge(Struct, frozen=True):
    """Row `row` of the input of the law `receiver`; `sender`: a law, "" if it is unknown.

    `weight`: mean over time, that of the mean graph if graphs switch; `recurrent`: whether it is
    present again and again; `link`: None for a wire; `fed`: whether the row is connected at all.
    """

    receiver: str
    row: int
    sender: str
    weight: float
    recurrent: bool
    link: Link | None = None
    fed: bool = True


class CommandPath(Struct, frozen=True):
    """The path by which a law moves an arm that takes no torque: through the component `servo`.

    `by`: the component whose output is the servo's command, the law itself or one that turns its
    torque into a command; `link`: on the way from it to the servo, None for a wire.
    """

    law: str
    servo: str
    by: str
    link: Link | None = None

    @property
    def direct(self) -> bool:
        """True if the law itself commands positions or velocities."""
        return self.by == self.law


class AnalyzedSystem(Struct, frozen=True, dict=True):
    """A plan with the facts of its components, by component; `silent`: why facts are missing."""

    scenario: Scenario
    plan: Plan
    facts: Mapping[str, Facts]
    silent: Mapping[str, str]
    edges: tuple[Edge, ...] = ()
    controls: Mapping[str, str] = field(default_factory=dict)  # law or controller by its arm
    commands: Mapping[str, CommandPath] = field(default_factory=dict)  # by arm without torques

    def once(self, what: str, of: Hashable, compute: Callable[[], T]) -> T:
        """The result of `compute` for an arm or another key, computed at the first request."""
        if (what, of) not in self._computed:
            self._computed[what, of] = compute()
        found: T = self._computed[what, of]
        return found

    def age(self, link: Link) -> Age:
        """The age of what a link holds: that of the first link that is asked for of its kind."""
        return self.once("age", kind_of(link.table), lambda: age(link.table))

    def with_facts(self, kind: type[F]) -> dict[str, F]:
        """Components with facts of one kind."""
        return self.once(
            "facts",
            kind.__name__,
            lambda: {n: f for n, f in self.facts.items() if isinstance(f, kind)},
        )

    @property
    def arms(self) -> dict[str, Arm]:
        """All arms."""
        return self.with_facts(Arm)

    def arm_of(self, controller: str) -> str | None:
        """The arm that a component controls."""
        return self._arms_by_controller.get(controller)

    @cached_property
    def _computed(self) -> dict[tuple[str, Hashable], Any]:
        return {}

    @cached_property
    def _arms_by_controller(self) -> Mapping[str, str]:
        return {name: arm for arm, name in reversed(tuple(self.controls.items()))}

    @cached_property
    def edges_to(self) -> Mapping[str, list[Edge]]:
        """The edges by their receiver."""
        found: dict[str, list[Edge]] = {}
        for edge in self.edges:
            found.setdefault(edge.receiver, []).append(edge)
        return found

    def received_weight(self, law: str) -> float:
        """The sum of the mean weights of the rows that a law receives again and again; no unit."""
        return sum(e.weight for e in self.edges_to.get(law, ()) if e.recurrent)

    def is_position(self, signal: str) -> bool:
        """True if a signal is the position of an arm, which closed forms are about."""
        return any(signal == f"{name}.{arm.position}" for name, arm in self.arms.items())

    def period(self, name: str) -> float:
        """The period of a component, s."""
        return self.plan.component(name).period * self.plan.h

    def feedback_period(self, name: str) -> float:
        """The period at which the velocity that a law feeds back is read, s: its servo's if any."""
        command = self.commands.get(self.arm_of(name) or "")
        return self.period(command.servo if command and command.direct else name)

    def held(self) -> tuple[str, ...]:
        """The arms that an operator holds or pushes, by a grip or the external torque."""
        return self.once("held", "", lambda: tuple(
            name
            for name, arm in sorted(self.arms.items())
            if arm.grip.is_present or is_driven(self.plan, f"{name}.{arm.external}")
        ))  # fmt: skip

    def hand(self, name: str) -> Hand | None:
        """The impedance that holds an arm: its grip, operators wired to it, or the sum of both.

        None without one, or if something other than a spring and a damper to a constant position
        acts as well.
        """
        arm = self.arms[name]
        external, place = (self.plan.slots().get(f"{name}.{port}") for port in
                           (arm.external, arm.grip.names[2]))  # fmt: skip
        grip = arm.grip
        hands = [Hand(stiffness=grip.stiffness, damping=grip.damping, place=grip.place)]
        if grip.is_present and place is not None and feeders(self.plan, place):
            return None
        if external is not None and any(start_value(self.plan.component(name), external)):
            return None
        for feeder in feeders(self.plan, external) if external is not None else ():
            wired = isinstance(feeder, Wire) and (feeder.gain, feeder.offset) == (1.0, 0.0)
            source = self.facts.get(feeder.source.component) if isinstance(feeder, Wire) else None
            if not wired or not isinstance(source, Hand):
                return None
            hands.append(source)
        return combined_hand(hands, len(arm.q))


def values_of(step: Step) -> dict[str, tuple[float, ...]]:
    """Every parameter, start value and input of a component, with defaults filled in.

    Values are flattened, each in the unit that the component declares for it.
    """
    component = step.component
    found = {p.name: step.values.get(p.name, p.default) for p in component.parameters}
    for port in component.inputs:
        found[port.name] = step.start.get(port.name) or port.default or (0.0,) * port.size
    return found


def system(scenario: Scenario, plan: Plan) -> AnalyzedSystem:
    """All that is known of a plan. A function of a model that fails is noted, not raised."""
    facts: dict[str, Facts] = {}
    silent: dict[str, str] = {}
    functions = lru_cache(maxsize=None)(facts_function)  # of a model, which many may have
    for step in plan.components:
        try:
            function = functions(scenario.components[step.name].model)
            found = None if function is None else function(values_of(step))
        except (Exception, SystemExit) as error:  # foreign code; that it fails is a finding
            silent[step.name] = f"{type(error).__name__}: {error}"
            continue
        if found is not None:
            facts[step.name] = found
    bare = AnalyzedSystem(scenario, plan, facts, silent)
    controls = dict(_controls(bare))
    commands = {arm: c for arm, name in controls.items() if (c := _command(plan, facts, name))}
    controls |= {arm: command.law for arm, command in commands.items()}
    facts |= _with_gains(facts, commands)
    known = AnalyzedSystem(scenario, plan, facts, silent, (), controls, commands)
    edges = tuple(e for name in known.with_facts(DynamicFeedback) for e in _edges(known, name))
    return AnalyzedSystem(scenario, plan, facts, silent, edges, controls, commands)


def _controls(system: AnalyzedSystem) -> Iterable[tuple[str, str]]:
    torques = {f"{name}.{arm.torque}": name for name, arm in system.arms.items()}
    for wire in system.plan.wires:
        if (name := torques.get(_port(wire.target))) is not None:
            yield name, wire.source.component


def _command(plan: Plan, facts: Mapping[str, Facts], servo: str) -> CommandPath | None:
    """The commands of the component `servo`; None if it is no servo, or has no commands."""
    what = facts.get(servo)
    source = _feeder(plan, servo, what.command) if isinstance(what, Servo) else None
    if source is None:
        return None
    by, link = source.source.component, source if isinstance(source, Link) else None
    turned = facts.get(by)
    wanted = _feeder(plan, by, turned.torque) if isinstance(turned, ServoCommand) else None
    law = wanted.source.component if wanted is not None else by
    return CommandPath(law, servo, by, link)


def _feeder(plan: Plan, component: str, port: str) -> Wire | Link | None:
    slot = next((s for s in plan.component(component).inputs if s.port == port), None)
    source = _fed(plan, slot).get(slot.start) if slot is not None else None
    return None if isinstance(source, Player) else source


def _with_gains(
    facts: Mapping[str, Facts], commands: Mapping[str, CommandPath]
) -> Mapping[str, Facts]:
    """Laws that command velocities or positions, with the gains of their servos."""
    found: dict[str, Facts] = {}
    for command in commands.values():
        law, servo = facts.get(command.law), facts.get(command.servo)
        if isinstance(law, DynamicFeedback) and isinstance(servo, Servo) and not law.K:
            holds = any(servo.K_p) or servo.by_position
            beyond = law.beyond or ("the servo holds its position" if holds else "")
            found[command.law] = replace(law, K=servo.K_v, tau_max=servo.tau_max, beyond=beyond)
    return found


def _port(slot: Slot) -> str:
    return f"{slot.component}.{slot.port}"


# ---- edges --------------------------------------------------------------------------------------


def _edges(system: AnalyzedSystem, name: str) -> Iterable[Edge]:
    law, step = system.facts[name], system.plan.component(name)
    assert isinstance(law, DynamicFeedback)
    slots = {s.port: s for s in step.inputs}
    if law.received not in slots:
        return
    received, weights = slots[law.received], slots.get(law.weights)
    width = received.size // received.shape[0]
    sources = _fed(system.plan, received)
    weighed = _fed(system.plan, weights) if weights is not None else {}
    for row in range(received.shape[0]):
        source = sources.get(received.start + row * width)
        weight, lasting = _weight(step, weights, weighed, row)
        if source is None or isinstance(source, Player):
            yield Edge(name, row, "", weight, lasting, fed=False)
            continue
        link = source if isinstance(source, Link) else None
        sender = _origin(system, source.source.component)
        yield Edge(name, row, sender, weight, lasting, link)


def _fed(plan: Plan, slot: Slot) -> dict[int, Feeder]:
    """The source of each entry of an input, by the entry's place in the signal vector."""
    found: dict[int, Feeder] = {}
    for feeder in feeders(plan, slot):
        start = feeder.target.start
        found |= dict.fromkeys(range(start, start + feeder.target.size), feeder)
    return found


def _weight(
    step: Step, slot: Slot | None, fed: Mapping[int, Feeder], row: int
) -> tuple[float, bool]:
    """(mean weight, whether it is there again and again) of a row."""
    if slot is None:
        return 1.0, True
    feeder = fed.get(slot.start + row)
    if isinstance(feeder, Player):
        return _played(feeder)
    if feeder is not None:
        return nan, True  # computed by a component: not known beforehand
    value = start_value(step, slot)[row]
    return value, value > 0


def _played(player: Player) -> tuple[float, bool]:
    source = player.source
    if isinstance(source, EdgeWeight):
        i, j = source.edge
        mean = source.topology.mean_weight(i, j, period=source.period, h=source.h)
        return mean, source.topology.union.weight(i, j) > 0
    drawn = float(source.stream().rows(LOOKS).mean())
    return drawn, drawn > 0


def _origin(system: AnalyzedSystem, name: str) -> str:
    """The law that a component belongs to: itself, or that of the arm it listens to."""
    seen: set[str] = set()
    waiting = [name]
    while waiting:
        here = waiting.pop(0)
        if isinstance(system.facts.get(here), DynamicFeedback):
            return here
        if here in system.controls:
            return system.controls[here]
        if here not in seen:
            seen.add(here)
            waiting += sorted(_sources_of(system.plan, here))
    return ""


def _sources_of(plan: Plan, name: str) -> set[str]:
    """The components whose outputs are wired to one."""
    feeders = (
        f for slot in plan.component(name).inputs for f in plan.feeders(slot.start, slot.size)
    )
    return {f.source.component for f in feeders if isinstance(f, Wire)}
