"""Scenario -> plan: who steps when, in which order, and what every input samples.

A plan is data: components with their place in one signal vector, wires, links, and a flat tuple of
operations (see ``docs/design.md``, idea 2, for the stages of a tick). It does not depend on the
order in which anything was listed; ties are broken by name.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Protocol

from cosim.component import Component, Kind
from cosim.errors import PlanError
from cosim.links.table import TableSpec
from cosim.native import Code

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Slot:
    """A stretch of the signal vector: a port, or a row of one. `name` is ``component.port``."""

    name: str
    component: str
    port: str
    start: int
    shape: tuple[int, ...]
    unit: str

    @property
    def size(self) -> int:
        """Number of scalars."""
        size = 1
        for n in self.shape:
            size *= n
        return size

    def scalars(self) -> tuple[str, ...]:
        """Names of the scalars: ``master.q[0]``, ``control.xi_in[0,1]``."""
        indices: list[tuple[int, ...]] = [()]
        for n in self.shape:
            indices = [(*i, j) for i in indices for j in range(n)]
        head = f"{self.name[:-1]}," if self.name.endswith("]") else f"{self.name}["
        return tuple(f"{head}{','.join(map(str, i))}]" if i else self.name for i in indices)


@dataclass(frozen=True, slots=True)
class Step:
    """A component in the plan: `period` in ticks, `values` flattened, its slots in port order."""

    name: str
    component: Component
    kind: Kind
    period: int
    values: Mapping[str, tuple[float, ...]]
    inputs: tuple[Slot, ...]
    outputs: tuple[Slot, ...]
    start: Mapping[str, tuple[float, ...]]  # inputs at the start, where nothing feeds them


@dataclass(frozen=True, slots=True)
class Wire:
    """`target = gain * source + offset`, in the same tick."""

    source: Slot
    target: Slot
    gain: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class Link:
    """A wire through a table of sent samples; `initial` is the pre-history, None: the start.

    `age`: a scalar input that gets the age (s) of what the link holds.
    """

    name: str
    source: Slot
    target: Slot
    table: TableSpec
    gain: float = 1.0
    offset: float = 0.0
    initial: tuple[float, ...] | None = None
    age: Slot | None = None


class Rows(Protocol):
    """Values in order, in chunks whose sizes do not change them."""

    def rows(self, n: int) -> NDArray[np.float64]:
        """The next `n` values."""


class Source(Protocol):
    """What a player plays: one value a hit of its receiver."""

    def stream(self) -> Rows:
        """The values from the first on."""

    def facts(self) -> dict[str, Any]:
        """What is written down with a run."""


@dataclass(frozen=True, slots=True)
class Player:
    """A table of values that feeds a scalar input: the weight of an edge over time."""

    target: Slot
    source: Source


@dataclass(frozen=True, slots=True)
class Operation:
    """One operation, due at ticks `first`, `first + period`, ...; `index`: of component or link."""

    code: Code
    index: int = 0
    period: int = 1
    first: int = 0
    source: int = 0
    target: int = 0
    count: int = 0
    gain: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class Plan:
    """Everything the engine needs; `order` is that of the sampled components."""

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

    def component(self, name: str) -> Step:
        """The component of that name."""
        return next(c for c in self.components if c.name == name)

    def slots(self) -> dict[str, Slot]:
        """Every port's slot by ``component.port``."""
        return {s.name: s for c in self.components for s in (*c.inputs, *c.outputs)}


def compile_plan(
    h: float,
    ticks: int,
    components: Iterable[Step],
    wires: Iterable[Wire],
    links: Iterable[Link],
    algorithm: str = "sampled",
    players: Iterable[Player] = (),
) -> Plan:
    """Order the components and lay out the operations of a tick.

    Raises PlanError with the loop printed when sampled components wait for each other.
    """
    steps = tuple(sorted(components, key=lambda c: c.name))
    wires_ = tuple(sorted(wires, key=lambda w: w.target.start))
    links_ = tuple(sorted(links, key=lambda x: x.name))
    sampled = {c.name for c in steps if c.kind == "sampled" and algorithm == "sampled"}
    order = _order(sampled, wires_, links_)
    players_ = tuple(sorted(players, key=lambda p: p.target.start))
    operations = _operations(steps, wires_, links_, players_, order)
    n_signals = sum(s.size for c in steps for s in (*c.inputs, *c.outputs))
    return Plan(
        h=h,
        ticks=ticks,
        algorithm=algorithm,
        n_signals=n_signals,
        components=steps,
        wires=wires_,
        links=links_,
        players=players_,
        operations=operations,
        order=order,
    )


def _order(sampled: set[str], wires: Sequence[Wire], links: Sequence[Link]) -> tuple[str, ...]:
    """Topological order of the sampled components, ties broken by name."""
    edges = same_tick(sampled, wires, links)
    waiting = {
        name: {e.source.component for e in edges if e.target.component == name} for name in sampled
    }
    ready = [name for name, sources in waiting.items() if not sources]
    heapq.heapify(ready)
    order: list[str] = []
    while ready:
        name = heapq.heappop(ready)
        order.append(name)
        del waiting[name]
        for other, sources in waiting.items():
            if name in sources:
                sources.discard(name)
                if not sources:
                    heapq.heappush(ready, other)
    if waiting:
        raise PlanError(_loop(waiting, edges))
    return tuple(order)


def same_tick(
    sampled: set[str], wires: Sequence[Wire], links: Sequence[Link]
) -> tuple[Wire | Link, ...]:
    """Connections between sampled components that carry a value within one tick."""
    edges: list[Wire | Link] = [*wires, *(x for x in links if x.table.minimum_delay_ticks == 0)]
    return tuple(
        e for e in edges if e.source.component in sampled and e.target.component in sampled
    )


def _loop(waiting: Mapping[str, set[str]], edges: Sequence[Wire | Link]) -> str:
    """Walk backwards from the first waiting component until one repeats, and print the walk."""
    name = min(waiting)
    walk = [name]
    while name not in walk[:-1]:
        name = min(s for s in waiting[name] if s in waiting)
        walk.append(name)
    cycle = walk[walk.index(name) :][::-1]
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


def _operations(
    steps: Sequence[Step],
    wires: Sequence[Wire],
    links: Sequence[Link],
    players: Sequence[Player],
    order: Sequence[str],
) -> tuple[Operation, ...]:
    periods = {c.name: c.period for c in steps}
    index = {c.name: i for i, c in enumerate(steps)}
    held = [c for c in steps if c.name not in order]
    operations = [op for c in held for op in _pushes(c, links)]
    for name in order:
        c = steps[index[name]]
        operations += _gather(c, wires, links, players, periods)
        operations.append(Operation(Code.STEP, index[name], c.period))
        operations += _pushes(c, links)
    operations.append(Operation(Code.RECORD))
    operations += [op for c in held for op in _gather(c, wires, links, players, periods)]
    operations += [Operation(Code.STEP, index[c.name], c.period, first=c.period - 1) for c in held]
    return tuple(operations)


def _pushes(c: Step, links: Sequence[Link]) -> list[Operation]:
    return [
        Operation(
            Code.PUSH,
            i,
            c.period,
            source=x.source.start,
            count=x.source.size,
            gain=x.gain,
            offset=x.offset,
        )
        for i, x in enumerate(links)
        if x.source.component == c.name
    ]


def _gather(
    c: Step,
    wires: Sequence[Wire],
    links: Sequence[Link],
    players: Sequence[Player],
    periods: Mapping[str, int],
) -> list[Operation]:
    received: list[Operation] = []
    for i, x in enumerate(links):
        if x.target.component == c.name:
            received.append(
                Operation(Code.PULL, i, c.period, target=x.target.start, count=x.target.size)
            )
            if x.age is not None:
                sent = periods[x.source.component]
                received.append(Operation(Code.AGE, i, c.period, source=sent, target=x.age.start))
    received += [
        Operation(Code.PLAY, i, c.period, target=p.target.start)
        for i, p in enumerate(players)
        if p.target.component == c.name
    ]
    copies: list[Operation] = []
    for w in (w for w in wires if w.target.component == c.name):
        plain = w.gain == 1.0 and w.offset == 0.0
        copy = Operation(
            Code.COPY if plain else Code.SCALE,
            0,
            c.period,
            source=w.source.start,
            target=w.target.start,
            count=w.target.size,
            gain=w.gain,
            offset=w.offset,
        )
        if copies and _continues(copies[-1], copy):
            copies[-1] = replace(copies[-1], count=copies[-1].count + copy.count)
        else:
            copies.append(copy)
    return received + copies


def _continues(a: Operation, b: Operation) -> bool:
    return (
        a.code == b.code == Code.COPY
        and a.source + a.count == b.source
        and a.target + a.count == b.target
    )
