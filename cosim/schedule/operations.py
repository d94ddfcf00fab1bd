"""The operations of a tick, laid out for the engine (``docs/design.md``, idea 2; ``engine.c``)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, TypeVar

from cosim.base.convert import Struct
from cosim.base.copies import replace
from cosim.native.enums import Code
from cosim.schedule.parts import Gate, Link, Player, Step, Wire

if TYPE_CHECKING:
    from cosim.schedule.macro import MacroGroup

T = TypeVar("T")


class Operation(Struct, frozen=True, gc=False):
    """One operation, due at ticks `first`, `first + period`, ...

    `index`: of component or link; of the last values of what is extrapolated, in the signals.
    `count`: signals; of RECORD: 1, a row is complete with it.
    """

    code: Code
    index: int = 0
    period: int = 1
    first: int = 0
    source: int = 0
    target: int = 0
    count: int = 0
    gain: float = 1.0
    offset: float = 0.0


class Line(Struct, frozen=True):
    """A wire whose values are taken as lines over a step: their means, or value and `slope`."""

    wire: Wire
    slope: bool

    @property
    def room(self) -> int:
        """The number of signals kept of it behind those of the components."""
        return self.wire.target.size * (2 if self.slope else 1)


class Connections(Struct, frozen=True):
    """Wires, links and players by the component they end at; links also by where they begin.

    Links, players and gates come with their number in the plan. `last`: a wire that is
    extrapolated, and where the signal vector keeps its last value, by the wire's target.
    """

    sent: Mapping[str, Sequence[tuple[int, Link]]]
    links: Mapping[str, Sequence[tuple[int, Link]]]
    players: Mapping[str, Sequence[tuple[int, Player]]]
    wires: Mapping[str, Sequence[Wire]]
    last: Mapping[int, tuple[Line, int]]
    gates: Mapping[str, Sequence[tuple[int, Gate]]]

    @classmethod
    def of(
        cls,
        wires: Iterable[Wire],
        links: Sequence[Link],
        players: Sequence[Player],
        lines: Iterable[Line] = (),
        end: int = 0,
        gates: Sequence[Gate] = (),
    ) -> Connections:
        """Sorted by component, once: looking each component's up must not cost all of them.

        `lines`: the wires that are extrapolated; their last values are kept from `end` on.
        """
        last: dict[int, tuple[Line, int]] = {}
        for line in lines:
            last[line.wire.target.start] = line, end
            end += line.room
        return cls(
            _grouped((x.source.component, (i, x)) for i, x in enumerate(links)),
            _grouped((x.target.component, (i, x)) for i, x in enumerate(links)),
            _grouped((p.target.component, (i, p)) for i, p in enumerate(players)),
            _grouped((w.target.component, w) for w in wires),
            last,
            _grouped((g.component, (i, g)) for i, g in enumerate(gates)),
        )


def _grouped(entries: Iterable[tuple[str, T]]) -> Mapping[str, Sequence[T]]:
    groups: defaultdict[str, list[T]] = defaultdict(list)
    for name, entry in entries:
        groups[name].append(entry)
    return groups


def compile_operations(
    steps: Sequence[Step],
    found: Connections,
    order: Sequence[str],
    later: Sequence[str],
    groups: Sequence[MacroGroup] = (),
    *,
    newest: bool,
) -> tuple[Operation, ...]:
    """The operations of a tick.

    `order`: sampled components, in their order; `later`: components that step over an interval, in
    their order, each with the inputs at its start. `newest`: but wires from components earlier in
    `later` are copied right before the step, with the values just computed (Gauss-Seidel).
    `groups`: components of `later` that are stepped together.
    """
    index = {c.name: i for i, c in enumerate(steps)}
    held = [steps[index[name]] for name in later]
    periods = {c.name: c.period for c in steps}
    operations = [op for c in held for op in _pushes(c, found)]
    for name in order:
        c = steps[index[name]]
        operations += [
            *_received(c, found, periods),
            *_copies(found, found.wires.get(name, ()), c.period),
        ]
        operations.append(Operation(Code.STEP, index[name], c.period))
        operations += _pushes(c, found)
    operations.append(Operation(Code.RECORD, count=1))
    place = {name: i for i, name in enumerate(later)} if newest else {}
    late: list[Operation] = []
    together = {i for group in groups for i in group.components}
    for i, c in enumerate(held):
        wires = found.wires.get(c.name, ())
        before = [place.get(w.source.component, i) < i for w in wires]
        now = [w for w, b in zip(wires, before, strict=True) if not b]
        last = [w for w, b in zip(wires, before, strict=True) if b]
        operations += [*_received(c, found, periods), *_copies(found, now, c.period)]
        late += _copies(found, last, c.period, c.period - 1)
        if index[c.name] not in together:
            late.append(Operation(Code.STEP, index[c.name], c.period, first=c.period - 1))
    late += [
        Operation(Code.MACRO, i, group.period, first=group.period - 1)
        for i, group in enumerate(groups)
    ]
    return (*operations, *late)


def group_copies(group: MacroGroup, discrete: Mapping[str, frozenset[str]]) -> list[Operation]:
    """The wires among a group as copies; `index` 1: the value is held over a macro step.

    `discrete`: inputs of each component that change in jumps.
    """
    return [
        Operation(
            Code.SCALE,
            int(w.target.port in discrete[w.target.component]),
            source=w.source.start,
            target=w.target.start,
            count=w.target.size,
            gain=w.gain,
            offset=w.offset,
        )
        for w in group.wires
    ]


def _pushes(c: Step, found: Connections) -> list[Operation]:
    """Operations for samples that leave by gates, which may change them, and then by links."""
    pushes = [
        Operation(
            Code.PUSH,
            i,
            c.period,
            source=x.source.start,
            count=x.source.size,
            gain=x.gain,
            offset=x.offset,
        )
        for i, x in found.sent.get(c.name, ())
    ]
    return _gates(c, found, out=True) + pushes


def _gates(c: Step, found: Connections, *, out: bool) -> list[Operation]:
    gates = found.gates.get(c.name) if found.gates else None
    return [Operation(Code.GATE, i, c.period) for i, g in gates or () if g.out == out]


def _received(c: Step, found: Connections, periods: Mapping[str, int]) -> list[Operation]:
    """Operations for samples that come by gates and over links, their ages, and weights."""
    received = _gates(c, found, out=False)
    for i, x in found.links.get(c.name, ()):
        received.append(
            Operation(Code.PULL, i, c.period, target=x.target.start, count=x.target.size)
        )
        if x.age is not None:
            sent = periods[x.source.component]
            received.append(Operation(Code.AGE, i, c.period, source=sent, target=x.age.start))
    received += [
        Operation(Code.PLAY, i, c.period, target=p.target.start)
        for i, p in found.players.get(c.name, ())
    ]
    return received


def _copies(
    found: Connections, wires: Iterable[Wire], period: int, first: int | None = None
) -> list[Operation]:
    """Wires as copies; copies to adjacent targets are merged.

    `first`: at the end of an interval, which started at the previous step; None: at its start.
    """
    copies: list[Operation] = []
    for w in wires:
        code, last = _way(found, w, late=first is not None)
        copy = Operation(
            code,
            last,
            period,
            first or 0,
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
    return copies


def _way(found: Connections, w: Wire, *, late: bool) -> tuple[Code, int]:
    """The code of a wire, and the place of its last values (0: nowhere)."""
    if w.target.start not in found.last:
        return (Code.COPY if w.gain == 1.0 and w.offset == 0.0 else Code.SCALE), 0
    line, last = found.last[w.target.start]
    if line.slope:
        return (Code.SLOPE_BETWEEN if late else Code.SLOPE_AHEAD), last
    return (Code.BETWEEN if late else Code.AHEAD), last


def _continues(a: Operation, b: Operation) -> bool:
    """True if `b` continues where `a` ends, with the same factor."""
    return (
        a.code == b.code
        and (a.gain, a.offset) == (b.gain, b.offset)
        and b.index == (a.index + a.count if a.index else 0)  # never where slopes are in between
        and a.source + a.count == b.source
        and a.target + a.count == b.target
    )
