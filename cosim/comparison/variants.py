"""Replacements for a scenario's controllers, operator and links, as frozen data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.comparison.aligned import AlignedError
from cosim.comparison.requirement_margin import RequirementMargin
from cosim.comparison.spec import Picture, PortBench, PortMeasure, Stability
from cosim.measure.metrics import Metric
from cosim.scenario.connect import unknown


@dataclass(frozen=True, slots=True)
class Role:
    """A role: the components of the scenario that are its arm and its controller.

    `hears`: the roles from which it receives, unless a link law specifies others.
    """

    arm: str
    controller: str
    hears: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ControllerSide:
    """A controller on one side: its component's keys, and wires as input -> (owner, port).

    The owner is ``arm``, ``controller`` or one of the `parts`: of the own side in `inputs` and
    `drives`, of the other side in `receives`. `parts`: further components of the side by name, each
    with its keys and its wires; in the scenario they are called ``ARM_NAME``.
    """

    component: Mapping[str, Any]
    inputs: Mapping[str, tuple[str, str]]
    drives: Mapping[str, tuple[str, str]]
    receives: Mapping[str, tuple[str, str]]
    parts: Mapping[str, tuple[Mapping[str, Any], Mapping[str, tuple[str, str]]]] = field(
        default_factory=dict
    )


@dataclass(frozen=True, slots=True)
class Controller:
    """A pair of controllers; `constant_delay`: its law needs delays that do not vary."""

    name: str
    title: str
    condition: str
    constant_delay: bool
    sides: Mapping[str, ControllerSide]

    @property
    def sends(self) -> tuple[str, ...]:
        """The ports that go over the links, either way."""
        ports = [port for side in self.sides.values() for _, port in side.receives.values()]
        return tuple(dict.fromkeys(ports))


@dataclass(frozen=True, slots=True)
class Operator:
    """Values of the arms by role, and the columns that do not apply with this operator.

    `components`: further components by name, as in a scenario; `feeds`: inputs of the arms by role,
    and the output of a component connected to each; `control`: parameters of every controller, such
    as its torque limit.
    """

    name: str
    title: str
    values: Mapping[str, Mapping[str, Any]]
    without: tuple[str, ...]
    components: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    feeds: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    control: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class LinkLaw:
    """Settings of a link: delay, semantics, loss; `sides`: differences by receiver.

    `hears`: the roles from which each role receives, if they differ from the roles' own.
    """

    name: str
    title: str
    options: Mapping[str, Any]
    sides: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    hears: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def senders(self, name: str, role: Role) -> tuple[str, ...]:
        """The roles from which the role of that name receives."""
        return self.hears.get(name, role.hears)

    def received_by(self, role: str) -> dict[str, Any]:
        """The options of the way on which `role` receives."""
        return {**self.options, **self.sides.get(role, {})}


@dataclass(frozen=True, slots=True)
class MetricColumn:
    """A metric, or the number `part` of it, a measure of the port, or the margin of a requirement;
    `only` for some operators.

    An aligned error is a metric that takes the mean delay of a link besides.
    """

    name: str
    label: str
    part: str
    metric: Metric | AlignedError | PortMeasure | RequirementMargin
    only: tuple[str, ...]

    def applies(self, operator: Operator) -> bool:
        """True if the column applies with an operator."""
        return self.name not in operator.without and (not self.only or operator.name in self.only)


@dataclass(frozen=True, slots=True)
class ComparisonSelection:
    """Names of the selected variants, in order."""

    controllers: tuple[str, ...]
    operators: tuple[str, ...]
    links: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Variants:
    """A whole variants file, as read."""

    path: Path
    title: str
    settings: tuple[str, ...]
    roles: Mapping[str, Role]
    controllers: Mapping[str, Controller]
    operators: Mapping[str, Operator]
    links: Mapping[str, LinkLaw]
    columns: tuple[MetricColumn, ...]
    stability: Stability
    picture: Picture
    default: ComparisonSelection
    default_columns: tuple[str, ...] = ()
    port: PortBench | None = None

    def with_columns(self, names: Sequence[str]) -> Variants:
        """Only these columns, in their order; none: the default ones. Raises ScenarioError."""
        known = {column.name: column for column in self.columns}
        chosen = choose(names, known, self.default_columns or tuple(known), "column")
        return replace(self, columns=tuple(known[name] for name in chosen))

    def select(
        self, controllers: Sequence[str], operators: Sequence[str], links: Sequence[str]
    ) -> ComparisonSelection:
        """The requested variants: the default if empty, all with ``all``. Raises ScenarioError."""
        return ComparisonSelection(
            choose(controllers, self.controllers, self.default.controllers, "controller"),
            choose(operators, self.operators, self.default.operators, "operator"),
            choose(links, self.links, self.default.links, "link"),
        )


def choose(
    wanted: Sequence[str],
    known: Mapping[str, Any],
    default: tuple[str, ...],
    what: str,
    place: str = "",
) -> tuple[str, ...]:
    """Names in the order they are asked for, each once. Raises ScenarioError."""
    if list(wanted) == ["all"]:
        return tuple(known)
    for name in wanted:
        if name not in known:
            raise ScenarioError(unknown(name, known, what), place or f"--{what}s")
    return tuple(dict.fromkeys(wanted)) or default
