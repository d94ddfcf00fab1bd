"""Roles in a plan: arms, the laws that control them, and the delayed edges between them.

The roles follow from the wires and links and from the facts of the models, without a run. An edge
(i, k) is row k of the signal that law i receives. Its sender is the law whose arm, or whose own
output, is the source of the row, also through other components.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf, nan
from typing import Any, TypeVar

import numpy as np

from cosim.analysis.facts import (
    Arm,
    Array,
    DynamicFeedback,
    Facts,
    Hand,
    Servo,
    ServoCommand,
    SpringDamper,
    facts_of,
)
from cosim.analysis.hands import combined_hand
from cosim.analysis.inputs import feeders, is_driven, start_value
from cosim.analysis.quantiles import quantiles
from cosim.base.errors import ScenarioError
from cosim.links.laws import Law
from cosim.links.losses import Lossy
from cosim.links.semantics import PlayoutSemantics, SignalSemantics
from cosim.links.table import DrawnTable, TableSpec
from cosim.scenario.connect import EdgeWeight
from cosim.scenario.spec import Scenario
from cosim.schedule.parts import Link, Player, Slot, Step, Wire
from cosim.schedule.plan import Plan

#: Looks over which the mean age of a link is taken where its law does not give it, and the mean
#: of a table of weights that is no switching graph.
LOOKS = 8000

#: Values that stand for the distribution of the ages of a link.
QUANTILES = 48

T = TypeVar("T")
F = TypeVar("F", Arm, DynamicFeedback, SpringDamper, Hand, Servo, ServoCommand)


@dataclass(frozen=True, slots=True)
class Age:
    """Age of the held sample, s: `mean`, and `bound` (inf: unbounded).

    `spread`: differences from the mean, s, equally likely; () if the age is constant.
    """

    mean: float = 0.0
    bound: float = 0.0
    spread: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Edge:
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
    age: Age = Age()
    fed: bool = True


@dataclass(frozen=True, slots=True)
class CommandPath:
    """How a law moves an arm that takes no torque: by the component `servo`.

    `by`: the component whose output is the servo's command, the law itself or one that turns its
    torque into a command; `link`: on the way from it to the servo, None for a wire.
    """

    law: str
    servo: str
    by: str
    link: Link | None = None

    @property
    def direct(self) -> bool:
        """Whether the law itself commands positions or velocities."""
        return self.by == self.law


@dataclass(frozen=True)
class AnalyzedSystem:
    """A plan with the facts of its components, by component; `silent`: why facts are missing."""

    scenario: Scenario
    plan: Plan
    facts: Mapping[str, Facts]
    silent: Mapping[str, str]
    edges: tuple[Edge, ...] = ()
    controls: Mapping[str, str] = field(default_factory=dict)  # law or controller by its arm
    commands: Mapping[str, CommandPath] = field(default_factory=dict)  # by arm without torques
    _by_kind: dict[type, dict[str, Any]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    _computed: dict[tuple[str, str], Any] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def once(self, what: str, arm: str, compute: Callable[[], T]) -> T:
        """What `compute` returns for an arm, computed when it is first asked for."""
        if (what, arm) not in self._computed:
            self._computed[what, arm] = compute()
        found: T = self._computed[what, arm]
        return found

    def with_facts(self, kind: type[F]) -> dict[str, F]:
        """Components with facts of one kind."""
        if kind not in self._by_kind:
            self._by_kind[kind] = {n: f for n, f in self.facts.items() if isinstance(f, kind)}
        found: dict[str, F] = self._by_kind[kind]
        return found

    @property
    def arms(self) -> dict[str, Arm]:
        """All arms."""
        return self.with_facts(Arm)

    def arm_of(self, controller: str) -> str | None:
        """The arm that a component controls."""
        return self._arms_by_controller.get(controller)

    @cached_property
    def _arms_by_controller(self) -> Mapping[str, str]:
        return {name: arm for arm, name in reversed(tuple(self.controls.items()))}

    def is_position(self, signal: str) -> bool:
        """Whether a signal is the position of an arm, which closed forms are about."""
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
        return tuple(
            name
            for name, arm in sorted(self.arms.items())
            if arm.grip.is_present or is_driven(self.plan, f"{name}.{arm.external}")
        )

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
    """What is known of a plan. A function of a model that fails is noted, not raised."""
    facts: dict[str, Facts] = {}
    silent: dict[str, str] = {}
    for step in plan.components:
        try:
            found = facts_of(scenario.components[step.name].model, values_of(step))
        except Exception as error:  # foreign code: that it fails is a finding of its own
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
    return _source(plan, slot.start) if slot is not None else None


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
    received = slots[law.received]
    width = received.size // received.shape[0]
    for row in range(received.shape[0]):
        first = received.start + row * width
        source = _source(system.plan, first)
        weight, lasting = _weight(system, slots.get(law.weights), row)
        if source is None:
            yield Edge(name, row, "", weight, lasting, fed=False)
            continue
        link = source if isinstance(source, Link) else None
        sender = _origin(system, source.source.component)
        yield Edge(name, row, sender, weight, lasting, link, age(link) if link else Age())


def _source(plan: Plan, at: int) -> Wire | Link | None:
    """The source of an entry of the signal vector."""
    return next((f for f in plan.feeders(at) if not isinstance(f, Player)), None)


def _weight(system: AnalyzedSystem, slot: Slot | None, row: int) -> tuple[float, bool]:
    """(mean weight, whether it is there again and again) of a row."""
    if slot is None:
        return 1.0, True
    at = slot.start + row
    for player in system.plan.feeders(at):
        if isinstance(player, Player) and player.target.start == at:
            return _played(player)
    if _source(system.plan, at) is not None:
        return nan, True  # computed by a component: not known beforehand
    value = values_of(system.plan.component(slot.component))[slot.port][row]
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


def age(link: Link) -> Age:
    """Mean age of what a link holds once it holds something, and the bound its law declares."""
    table = link.table
    ages = _ages(table)
    drawn = table if isinstance(table, DrawnTable) else None
    declared = drawn.law.mean if drawn and isinstance(drawn.rule, SignalSemantics) else None
    if not len(ages):
        return Age(nan if declared is None else declared, age_bound(table))
    middle = float(ages.mean())
    parts = quantiles(ages - middle, (np.arange(QUANTILES) + 0.5) / QUANTILES)
    spread = tuple((parts - parts.mean()).tolist()) if np.ptp(ages) > table.grid.h else ()
    return Age(middle if declared is None else declared, age_bound(table), spread)


def _ages(table: TableSpec) -> Array:
    """The ages of what a link holds at the looks of its receiver, (n,), s, once it has begun."""
    rows = LOOKS
    while rows:
        try:
            table.check(rows)
            break
        except ScenarioError:  # a stored table, or a trace, that is shorter
            rows //= 2
    held = table.stream().rows(rows) if rows else np.empty(0, np.int32)
    begun = held[np.argmax(held >= 0) :] if (held >= 0).any() else held[:0]
    if not len(begun):
        return np.empty(0)
    first = len(held) - len(begun)
    looks = table.grid.n_r * np.arange(first, len(held), dtype=np.int64)
    ages = (looks - table.grid.n_s * begun.astype(np.int64)) * table.grid.h
    return np.asarray(ages[min(len(ages) // 2, table.history * table.grid.n_s // table.grid.n_r) :])


def age_bound(table: TableSpec) -> float:
    """No sample that is held is older, s; inf where nothing may come for any time."""
    grid = table.grid
    slack = (grid.n_s + grid.n_r) * grid.h
    if not isinstance(table, DrawnTable):
        return table.history * grid.n_s * grid.h + slack
    law: Law = table.law
    longest = 0.0
    if isinstance(law, Lossy):
        longest, law = law.loss.longest, law.delay
    oldest = law.maximum
    if isinstance(table.rule, PlayoutSemantics):
        if law.maximum > table.rule.buffer:
            return inf  # what comes later than the buffer is never played
        oldest = table.rule.buffer
    return inf if law.loses_packets else oldest + longest + slack
