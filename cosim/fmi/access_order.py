"""The order in which the standard lets the variables of an FMU be set and got."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from cosim.base.convert import Struct, field
from cosim.fmi import clocks
from cosim.fmi.exchange import ExchangeLayout, exchange_layout
from cosim.fmi.file.ports import REAL, VariableGroup
from cosim.fmi.file.variables import FmuVariable
from cosim.fmi.layout import Move, Partition, StepLayout
from cosim.fmi.library import Clocked

if TYPE_CHECKING:
    from cosim.fmi.component import FmuComponent

#: What variables have in common that move together: "input" or "output", how, and their clocks.
Key = tuple[str, str, tuple[int, ...]]


class Moves(Struct, frozen=True):
    """Variables by when they move; `events`: whether the FMU is run with event mode.

    `scheduled`: its clocks activate its partitions. `exchange`: it is integrated by the engine, and
    inputs are set in Event Mode only.
    """

    events: bool
    exchange: bool = False
    scheduled: bool = False
    _found: dict[Key, dict[str, Move]] = field(default_factory=dict)

    def add(self, role: str, group: VariableGroup, place: int) -> None:
        """Add an "input" or "output" whose scalars start at `place`."""
        found = self._found.setdefault(self._key(role, group.first), {})
        before = found.get(group.first.type, Move(group.first.type, (), ()))
        places = tuple(range(place, place + group.size))
        found[group.first.type] = Move(
            before.type, before.references + group.references, before.places + places
        )

    def _key(self, role: str, first: FmuVariable) -> Key:
        if (self.events or self.scheduled) and first.clocks:
            return role, "clocked", tuple(sorted(first.clocks))
        jumps = self.exchange or (self.events and first.variability != "continuous")
        discrete = jumps and role == "input"
        return role, "discrete" if discrete else "step", ()

    def of(
        self, causality: str, how: str = "step", clocks: tuple[int, ...] = ()
    ) -> tuple[Move, ...]:
        """The moves of one key, one a type."""
        return tuple(self._found.get((causality, how, clocks), {}).values())

    def partitions(self, texts: Sequence[Clocked]) -> tuple[Partition, ...]:
        """The clocked ones, and `texts`, by their clocks."""
        said: defaultdict[tuple[int, ...], list[Clocked]] = defaultdict(list)
        for x in texts:
            said[tuple(sorted(x.clocks))].append(x)
        found = {key[2] for key in self._found if key[1] == "clocked"}
        return tuple(
            Partition(
                c, self.of("input", "clocked", c), self.of("output", "clocked", c), tuple(said[c])
            )
            for c in sorted({*found, *said})
        )


def layout(
    x: FmuComponent,
    h: float,
    lag: int,
    period: int,
    inputs: int,
    outputs: int,
    slopes: Mapping[int, int],
) -> StepLayout:
    """The layout of steps of `x` every `h` s = `period` ticks; its signals start at these places.

    `slopes`: places of slopes by those of their inputs. Raises FmuError for a step or a clock that
    cannot be kept.
    """
    clocks.check_step(x.description, h, x.name)
    exchange = _exchange(x)
    moves = Moves(x.events, exchange is not None, x.description.scheduled)
    (found, starts), asked = _slopes(x, inputs, slopes), clocks.read_clocks(x)
    at: dict[int, int] = {}  # of clocks that are signals, by value reference
    for role, place in (("input", inputs), ("output", outputs)):
        for group in x.carried(role):
            if group.first.type == "Clock":
                at |= {r: place + i for i, r in enumerate(group.references)}
            else:
                moves.add(role, group, place)
            place += group.size
    real = all(g.first.type in REAL for r in ("input", "output") for g in x.carried(r))
    return StepLayout(
        h=h, lag=lag, period=period, input=inputs, output=outputs,
        input_count=sum(p.size for p in x.inputs),
        output_count=sum(p.size for p in x.outputs),
        inputs=moves.of("input"), outputs=moves.of("output"),
        discrete=moves.of("input", "discrete"), slopes=found, starts=starts,
        clocks=clocks.tickers(x.description, h, x.name, x.intervals, at) if x.clocked else (),
        triggered=asked.triggered, counts=tuple(at[t.reference] for t in asked.triggered),
        partitions=moves.partitions(asked.texts),
        fmi=x.description.fmi, events=x.events, scheduled=x.description.scheduled, begin=x.begin,
        variable=bool(x.description.flags.get("canHandleVariableCommunicationStepSize")),
        plain=real and found is None and not (x.clocked or x.returns_early or x.sandboxed),
        exchange=exchange,
    )  # fmt: skip


def _exchange(x: FmuComponent) -> ExchangeLayout | None:
    d = x.description
    if d.states is None:
        return None
    return exchange_layout(x.name, d.fmi, d.states, x.options, d.tolerance, d.default_step)


def _slopes(
    x: FmuComponent, inputs: int, slopes: Mapping[int, int]
) -> tuple[Move | None, tuple[int, ...]]:
    """The inputs that have a slope, with the places of these; and where the inputs are.

    `slopes`: places of slopes by those of the inputs, which start at `inputs`.
    """
    references: list[int] = []
    places: list[int] = []
    starts: list[int] = []
    place = inputs
    for group in x.carried("input"):
        for v in group.variables:
            scalars = range(place, place + v.size)
            place += v.size
            if scalars and all(i in slopes for i in scalars):
                references.append(v.reference)
                places += [slopes[i] for i in scalars]
                starts += scalars
    kind = "Real" if x.description.fmi == "2.0" else "Float64"
    found = Move(kind, tuple(references), tuple(places)) if references else None
    return found, tuple(starts)


def isolated(x: FmuComponent, here: StepLayout) -> StepLayout:
    """The same for a separate process, with inputs first, then outputs, then slopes."""
    first = here.input_count + here.output_count
    places = {start - here.input: first + i for i, start in enumerate(here.starts)}
    return layout(x, here.h, here.lag, here.period, 0, here.input_count, places)
