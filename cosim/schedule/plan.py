"""The way from a scenario to a plan: steps, their order, and the source of every input.

A plan is data: components with their place in one signal vector, wires, links, and a flat tuple of
operations (see ``docs/design.md``, idea 2, for the stages of a tick). It does not depend on the
order in which anything was listed; ties are broken by name.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

from cosim.base.convert import Struct
from cosim.base.errors import PlanError
from cosim.schedule.operations import Connections, Line, Operation, compile_operations
from cosim.schedule.order import CycleError, sequence, topological
from cosim.schedule.parts import Gate, Link, Player, Slot, Step, SteppedBus, Wire

if TYPE_CHECKING:
    from cosim.schedule.macro import AdaptiveSettings, MacroGroup

Feeder = Wire | Link | Player


class Plan(Struct, frozen=True, dict=True):
    """Everything the engine needs.

    `order`: the sampled components, as they compute at t_k; `later`: the others, as they step over
    their intervals (only with Gauss-Seidel does that order show). `start`: the time of tick 0, s.
    """

    h: float
    ticks: int
    algorithm: str
    n_signals: int
    components: tuple[Step, ...]
    wires: tuple[Wire, ...]
    links: tuple[Link, ...]
    players: tuple[Player, ...]
    operations: tuple[Operation, ...]
    order: tuple[str, ...]
    later: tuple[str, ...] = ()
    gates: tuple[Gate, ...] = ()
    buses: tuple[SteppedBus, ...] = ()
    adaptive: AdaptiveSettings | None = None
    groups: tuple[MacroGroup, ...] = ()
    start: float = 0.0

    def time(self, tick: int) -> float:
        """The time of a tick, s."""
        return self.start + tick * self.h

    @property
    def end(self) -> float:
        """The time after the last tick, s."""
        return self.time(self.ticks)

    def component(self, name: str) -> Step:
        """The component of that name, which must be there."""
        return self._by_name[name]

    def slots(self) -> Mapping[str, Slot]:
        """Every port's slot by ``component.port``."""
        return self._slots

    def feeders(self, start: int, size: int = 1) -> tuple[Feeder, ...]:
        """The wires, links and players that feed entries of the signal vector, in this order."""
        starts, feeders = self._feeders
        first = max(0, bisect_right(starts, start) - 1)
        found = []
        for number, feeder in feeders[first : bisect_left(starts, start + size)]:
            if feeder.target.start + feeder.target.size > start:
                found.append((number, feeder))
        return tuple(feeder for _, feeder in sorted(found, key=lambda pair: pair[0]))

    @cached_property
    def _by_name(self) -> Mapping[str, Step]:
        return {c.name: c for c in self.components}

    @cached_property
    def _slots(self) -> Mapping[str, Slot]:
        own = {s.name: s for group in self.groups for s in group.slots}
        return {s.name: s for c in self.components for s in (*c.inputs, *c.outputs)} | own

    @cached_property
    def _feeders(self) -> tuple[list[int], list[tuple[int, Feeder]]]:
        """(where targets start, sorted; the feeders with their numbers). No two targets overlap."""
        every: tuple[Feeder, ...] = (*self.wires, *self.links, *self.players)
        feeders = sorted(enumerate(every), key=lambda pair: pair[1].target.start)
        return [feeder.target.start for _, feeder in feeders], feeders


def compile_plan(
    h: float,
    ticks: int,
    components: Iterable[Step],
    wires: Iterable[Wire],
    links: Iterable[Link],
    algorithm: str = "sampled",
    players: Iterable[Player] = (),
    order: Sequence[str] = (),
    gates: Iterable[Gate] = (),
    buses: Sequence[SteppedBus] = (),
    adaptive: AdaptiveSettings | None = None,
    start: float = 0.0,
) -> Plan:
    """Order the components and lay out the operations of a tick.

    `order`: all components, for ``"gauss-seidel"``; by default it follows from the wires. Raises
    PlanError with the loop if sampled components wait for each other, for an `order` that does not
    list all components, and for an invalid extrapolation. After the slots of the components, the
    signal vector contains the last values of extrapolated signals, and slopes. `buses`: those
    simulated inside the ticks, which fill the tables of their links; their gates are added to
    `gates`. `adaptive`: for ``"adaptive"``; the signals of its groups come last. `start`: the
    time of tick 0, s.
    """
    steps = tuple(sorted(components, key=lambda c: c.name))
    wires_ = tuple(sorted(wires, key=lambda w: w.target.start))
    links_ = tuple(sorted(links, key=lambda x: x.name))
    players_ = tuple(sorted(players, key=lambda p: p.target.start))
    computes = algorithm in ("sampled", "adaptive")
    sampled = {c.name for c in steps if c.kind == "sampled" and computes}
    now = _order(sampled, wires_, links_)
    later = _later([c.name for c in steps if c.name not in sampled], wires_, algorithm, order)
    n_signals = sum(s.size for c in steps for s in (*c.inputs, *c.outputs))
    lines = _lines({c.name: c for c in steps}, wires_)
    every_gate = [*gates, *(gate for bus in buses for gate in bus.gates)]
    gates_ = tuple(sorted(every_gate, key=lambda g: g.name))
    connections = Connections.of(wires_, links_, players_, lines, n_signals, gates_)
    newest = algorithm == "gauss-seidel"
    end = n_signals + sum(line.room for line in lines)
    groups: tuple[MacroGroup, ...] = ()
    if adaptive is not None or algorithm == "adaptive":
        from cosim.schedule.macro import AdaptiveSettings, macro_groups

        adaptive = adaptive or AdaptiveSettings()
        groups = macro_groups(steps, wires_, frozenset(sampled), adaptive, h, end)
    return Plan(
        h=h,
        ticks=ticks,
        algorithm=algorithm,
        n_signals=end + sum(len(group.slots) for group in groups),
        components=steps,
        wires=wires_,
        links=links_,
        players=players_,
        operations=compile_operations(steps, connections, now, later, groups, newest=newest),
        order=now,
        later=later,
        gates=gates_,
        buses=tuple(buses),
        adaptive=adaptive,
        groups=groups,
        start=start,
    )


def _lines(steps: Mapping[str, Step], wires: Sequence[Wire]) -> tuple[Line, ...]:
    """Wires that are extrapolated as lines over a step: those between continuous components."""
    found = [w for w in wires if steps[w.target.component].extrapolate]
    found = [w for w in found if w.target.port not in steps[w.target.component].discrete]
    found = [w for w in found if steps[w.source.component].kind == "continuous"]
    for step in steps.values():
        place = f'components.{step.name}.extrapolate = "linear"'
        if step.extrapolate and step.kind == "sampled":
            raise PlanError(f"{place}: it is sampled; expected a continuous component")
    for w in found:
        source, target = steps[w.source.component], steps[w.target.component]
        if target.period % source.period:
            raise PlanError(
                f'components.{target.name}.extrapolate = "linear": it steps every {target.period} '
                f"ticks and {source.name} every {source.period}; expected a multiple, so that "
                f"{w.source.name} is new every time"
            )
    fed = {w.target.component for w in found}
    for name in (s.name for s in steps.values() if s.extrapolate and s.name not in fed):
        raise PlanError(
            f'components.{name}.extrapolate = "linear": no wire comes from a continuous component '
            "to a continuous input; sampled signals and signals of links are held"
        )
    return tuple(Line(w, w.target.port in steps[w.target.component].sloped) for w in found)


def _later(
    names: Sequence[str], wires: Sequence[Wire], algorithm: str, given: Sequence[str]
) -> tuple[str, ...]:
    """The order in which components step over their intervals."""
    if algorithm != "gauss-seidel":
        if given:
            raise PlanError(
                f'run.order is for algorithm = "gauss-seidel"; the algorithm is "{algorithm}"'
            )
        return tuple(names)
    if not given:
        return sequence(names, ((w.source.component, w.target.component) for w in wires))
    if sorted(given) != sorted(names):
        wrong = [n for n in given if n not in names] or sorted(set(names) - set(given))
        wrong = wrong or [n for n in names if given.count(n) > 1]
        raise PlanError(
            f"run.order must name every component once; wrong: {', '.join(wrong)} "
            f"(there are: {', '.join(names)})"
        )
    return tuple(given)


def _order(sampled: set[str], wires: Sequence[Wire], links: Sequence[Link]) -> tuple[str, ...]:
    """Topological order of the sampled components, ties broken by name."""
    edges = _same_tick(sampled, wires, links)
    try:
        return topological(sampled, ((e.source.component, e.target.component) for e in edges))
    except CycleError as waiting:
        raise PlanError(_loop(waiting.cycle, edges)) from None


def _same_tick(
    sampled: set[str], wires: Sequence[Wire], links: Sequence[Link]
) -> tuple[Wire | Link, ...]:
    """Connections between sampled components that carry a value within one tick."""
    edges: list[Wire | Link] = [*wires, *(x for x in links if x.table.minimum_delay_ticks == 0)]
    return tuple(
        e for e in edges if e.source.component in sampled and e.target.component in sampled
    )


def _loop(cycle: Sequence[str], edges: Sequence[Wire | Link]) -> str:
    """The cycle as its connections, and what to do about it."""
    hops = [
        next(e for e in edges if (e.source.component, e.target.component) == pair)
        for pair in pairwise(cycle)
    ]
    text = ", ".join(f"{e.source.name} -> {e.target.name}" for e in hops)
    return (
        f"sampled components wait for each other in the same tick: {text}. Break the loop with a "
        "link whose delay is at least one tick, take the signal from a continuous component "
        '(ξ through the small component fmus.models.xi), or use algorithm = "jacobi"'
    )
