"""Groups of components that exchange values several times in a period (``macro_steps.c``).

With ``algorithm = "adaptive"``, continuous components of one period that wires connect are a group.
Its period is divided into macro steps, each of them the period over a power of two, so that every
tick is the end of one. What is not in a group is stepped as with ``"sampled"``.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from cosim.base.errors import PlanError
from cosim.native.enums import MACRO_LEVELS
from cosim.schedule.parts import Slot, Step, Wire

#: How often a period is halved at most, if no smallest step is given.
HALVINGS = 10


@dataclass(frozen=True, slots=True)
class PowerBond:
    """Two wires between two components whose signals are effort and flow: their product is power.

    `effort` and `flow` are inputs, ``component.port``: each of the component that the other's wire
    comes from.
    """

    effort: str
    flow: str


@dataclass(frozen=True, slots=True)
class AdaptiveSettings:
    """The choice of macro steps.

    The error of an output is at most ``absolute + tolerance * (its largest value so far)`` a step;
    `smallest`: of a step, s, 0: the period over 2^10; `iterations`: sweeps after the first one at
    most; `fixed`: components that are stepped once in their period; `bonds`: whose energy is
    watched.
    """

    tolerance: float = 1e-4
    absolute: float = 1e-6
    smallest: float = 0.0
    iterations: int = 1
    fixed: tuple[str, ...] = ()
    bonds: tuple[PowerBond, ...] = ()


@dataclass(frozen=True, slots=True)
class BondWires:
    """A bond of a group: its wires, and the signal of the energy (J) that the coupling has made."""

    name: str
    effort: Wire
    flow: Wire
    residual: Slot


@dataclass(frozen=True, slots=True)
class MacroGroup:
    """Components (their numbers) with a common macro step, and the `wires` among them.

    The period is `period` ticks, and can be halved `halvings` times. `steps`, `rejections`, `size`:
    signals of what was done in the last period: steps that were kept, steps that were done again,
    and the length of the smallest (s).
    """

    components: tuple[int, ...]
    wires: tuple[Wire, ...]
    period: int
    halvings: int
    steps: Slot
    rejections: Slot
    size: Slot
    bonds: tuple[BondWires, ...] = ()

    @property
    def slots(self) -> tuple[Slot, ...]:
        """The signals of the group itself."""
        return (self.steps, self.rejections, self.size, *(b.residual for b in self.bonds))


def macro_groups(
    steps: Sequence[Step],
    wires: Sequence[Wire],
    sampled: frozenset[str],
    settings: AdaptiveSettings,
    h: float,
    start: int,
) -> tuple[MacroGroup, ...]:
    """The groups, in the order of their first components; their signals are kept from `start` on.

    `h`: base step, s; `sampled`: components that compute at t_k. Raises PlanError for an unknown
    name among those that are fixed, a component that extrapolates, a smallest step beyond the
    period, and a bond that is not one.
    """
    number = {step.name: i for i, step in enumerate(steps)}
    for name in settings.fixed:
        if name not in number:
            raise PlanError(f"run.adaptive.fixed: there is no component {name!r}")
    free = {s.name for s in steps if s.name not in sampled and s.name not in settings.fixed}
    inner = [
        w
        for w in wires
        if {w.source.component, w.target.component} <= free
        and steps[number[w.source.component]].period == steps[number[w.target.component]].period
    ]
    groups = []
    bonds = dict.fromkeys(settings.bonds)
    for names in _connected(inner):
        members = [steps[i] for i in sorted(number[name] for name in names)]
        own = tuple(w for w in inner if w.target.component in names)
        found = [b for b in bonds if any(w.target.name == b.effort for w in own)]
        group = _group(members, number, own, found, settings, h, start)
        for bond in found:
            del bonds[bond]
        start += len(group.slots)
        groups.append(group)
    if bonds:
        first = next(iter(bonds))
        raise PlanError(
            f"run.adaptive.bonds: no wire between continuous components of one period ends at "
            f"{first.effort!r}; expected an input"
        )
    return tuple(groups)


def _connected(wires: Sequence[Wire]) -> list[frozenset[str]]:
    """The names that wires connect, each set once, in the order of their first names."""
    together: dict[str, set[str]] = {}
    for w in wires:
        a, b = w.source.component, w.target.component
        one = together.get(a, {a}) | together.get(b, {b})
        together |= dict.fromkeys(one, one)
    return sorted({frozenset(names) for names in together.values()}, key=sorted)


def _group(
    members: Sequence[Step],
    number: Mapping[str, int],
    wires: tuple[Wire, ...],
    bonds: Sequence[PowerBond],
    settings: AdaptiveSettings,
    h: float,
    start: int,
) -> MacroGroup:
    first = members[0]
    for step in members:
        if step.extrapolate:
            raise PlanError(
                f'components.{step.name}.extrapolate: found "linear" with algorithm = "adaptive", '
                'which has lines of its own; expected "hold"'
            )
    slots = [
        Slot(f"{first.name}.{port}", first.name, port, start + i, (), unit)
        for i, (port, unit) in enumerate((
            ("macro_steps", "1"), ("macro_rejections", "1"), ("macro_size", "s"),
            *((f"macro_energy_{i}", "J") for i in range(len(bonds))),
        ))
    ]  # fmt: skip
    taken = {s.port for s in (*first.inputs, *first.outputs)}
    clash = next((s.name for s in slots if s.port in taken), None)
    if clash is not None:
        raise PlanError(f'{clash} is a name of the macro steps of algorithm = "adaptive"')
    return MacroGroup(
        components=tuple(number[s.name] for s in members),
        wires=wires,
        period=first.period,
        halvings=_halvings(settings.smallest, first.period * h, first.name),
        steps=slots[0],
        rejections=slots[1],
        size=slots[2],
        bonds=tuple(_bond(bond, wires, s) for bond, s in zip(bonds, slots[3:], strict=True)),
    )


def _halvings(smallest: float, period: float, name: str) -> int:
    """The number of times a period may be halved: no step is below `smallest`, both in s."""
    if not smallest:
        return HALVINGS
    if smallest > period * (1.0 + 1e-12):
        raise PlanError(
            f"run.adaptive.smallest: found {smallest:g} s; expected at most the period of {name}, "
            f"{period:g} s"
        )
    halvings = 0
    while halvings < MACRO_LEVELS - 1 and period / 2 ** (halvings + 1) >= smallest * (1.0 - 1e-12):
        halvings += 1
    return halvings


def _bond(bond: PowerBond, wires: Sequence[Wire], residual: Slot) -> BondWires:
    found: defaultdict[str, list[Wire]] = defaultdict(list)
    for w in wires:
        found[w.target.name].append(w)
    for name in (bond.effort, bond.flow):
        if len(found[name]) != 1:
            raise PlanError(
                f"run.adaptive.bonds: {len(found[name])} wires end at {name!r} from continuous "
                "components of its period; expected one"
            )
    effort, flow = found[bond.effort][0], found[bond.flow][0]
    ends = {
        (effort.source.component, flow.target.component),
        (flow.source.component, effort.target.component),
    }
    if any(a != b for a, b in ends) or effort.target.size != flow.target.size:
        raise PlanError(
            f"run.adaptive.bonds: {effort.source.name} -> {bond.effort} and {flow.source.name} -> "
            f"{bond.flow} are no bond; expected wires of one size in both directions between two "
            "components"
        )
    if effort.gain == 0.0 or flow.gain == 0.0:
        raise PlanError(f"run.adaptive.bonds: the wire to {bond.effort} or {bond.flow} has gain 0")
    return BondWires(f"{bond.effort}, {bond.flow}", effort, flow, residual)
