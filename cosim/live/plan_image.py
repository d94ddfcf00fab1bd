"""The image of a plan: its start, its tables and its ticks, as the page's engine reads them.

The plan is started here as for a run, in the native engine, whose structs are then copied; so there
is one place that knows what they contain. Values that the start computes are not taken over: the
page makes the same calls.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.base.component import NativeComponent
from cosim.base.random_numbers import entropy
from cosim.engine.arrays import row_type, rows_of
from cosim.engine.binding import ALONE, MEANS, SLOPES, Binding
from cosim.engine.engine import SignalViews
from cosim.engine.initialization import PlanStart, exits
from cosim.engine.plant_loops import possible_loops
from cosim.engine.simulate import columns
from cosim.fmi import components
from cosim.fmi.component import FmuComponent
from cosim.fmi.starting import Starts
from cosim.links.drawing import begun
from cosim.links.table import DrawnTable
from cosim.live.image import Image, LiveError
from cosim.live.layout import layout
from cosim.native import structs
from cosim.record import Column
from cosim.schedule.parts import Step
from cosim.schedule.plan import Plan

#: Bytes of a packet on its way.
_PACKET = layout(structs.PacketStruct).size
#: Rows of tables, and values of players, that a page may hold.
MOST_ROWS = 1 << 25
#: Rows of tables that take about the time in which a component starts (2 ms).
ROWS = 10_000


@dataclass
class PlanImage:
    """The image of a plan, and what is at which place of it.

    `places`: of structs by name. `copies`: (place, signal, count): what is taken from the signals
    after the start. `frozen`: rows of tables, by link; `played`: values, by player. `drawn`: links
    whose tables are drawn in the page. `capacity`: samples that each link can keep; `pending`:
    packets on their way.
    """

    plan: Plan
    columns: Sequence[Column]
    image: Image = field(default_factory=Image)
    places: dict[str, int] = field(default_factory=dict)
    copies: list[tuple[int, int, int]] = field(default_factory=list)
    frozen: dict[int, NDArray[np.int32]] = field(default_factory=dict)
    played: list[NDArray[np.float64]] = field(default_factory=list)
    drawn: list[int] = field(default_factory=list)
    capacity: list[int] = field(default_factory=list)
    pending: list[int] = field(default_factory=list)

    def hits(self, component: str) -> int:
        """The number of steps of a component."""
        return _hits(self.plan, component)


def plan_image(
    plan: Plan, recorded: Sequence[str], room: Mapping[str, tuple[int, int]] | None = None
) -> PlanImage:
    """Start `plan` and make its image; `recorded`: the signals, as in ``run.record``.

    `room`: by link, the least number of samples it keeps, and of packets on their way. Raises
    LiveError for what a page cannot compute, CosimError for what does not start.
    """
    refuse(plan)
    try:
        return _Making(plan, recorded, room or {}).made()
    finally:
        components.close([s.component for s in plan.components], 0, 0, {})


def refuse(plan: Plan) -> None:
    """Raise LiveError for a plan that a page cannot compute."""
    if plan.buses:
        raise LiveError(
            "a page cannot compute links over a simulated bus; expected [[links]] with a delay"
        )
    if plan.groups:
        raise LiveError('a page cannot compute algorithm = "adaptive"; expected another algorithm')
    if len(plan.components) >= ALONE:
        raise LiveError(
            f"found {len(plan.components)} components; a page computes fewer than {ALONE}"
        )
    for step in plan.components:
        if reason := _reason(step):
            raise LiveError(f"{step.name}: {reason}, which a page cannot compute")


def effort(plan: Plan) -> int:
    """The effort of an image: components to start, and one for each :data:`ROWS` table rows."""
    ends = [x.target.component for x in plan.links if not isinstance(x.table, DrawnTable)]
    ends += [player.target.component for player in plan.players]
    return len(plan.components) + sum(_hits(plan, end) for end in ends) // ROWS


def _hits(plan: Plan, component: str) -> int:
    return -(-plan.ticks // plan.component(component).period)


def _reason(step: Step) -> str:
    """The reason why a page cannot compute a component; "" if it can."""
    fmu = components.stepped_fmu(step.component)
    if fmu is None:
        native = isinstance(step.component, NativeComponent)
        return "is a scene of a simulator" if native else "is a Python component"
    if fmu.options.isolate:
        return "is an FMU in a process of its own"
    if fmu.description.states is not None:
        return "is an FMU for model exchange"
    if fmu.description.scheduled or fmu.events:
        return "is an FMU with clocks or events"
    if fmu.description.fmi == "1.0":
        return "is an FMU of FMI 1.0"
    return ""


def fmu_of(step: Step) -> FmuComponent:
    """The FMU that a component of a plan is."""
    fmu = components.stepped_fmu(step.component)
    assert fmu is not None
    return fmu


class _Making:
    def __init__(
        self, plan: Plan, recorded: Sequence[str], room: Mapping[str, tuple[int, int]]
    ) -> None:
        self._plan, self._room = plan, room
        self._made = PlanImage(plan, columns(plan, recorded))
        self._signals = np.zeros(plan.n_signals)

    def made(self) -> PlanImage:
        plan, signals, places = self._plan, self._signals, self._made.places
        inputs = SignalViews(signals, [s.inputs for s in plan.components], fixed=True)
        outputs = SignalViews(signals, [s.outputs for s in plan.components])
        components.share_texts(step.component for step in plan.components)
        for step in plan.components:
            components.begin_at(step.component, plan.time(0))
        start = PlanStart(plan, signals, inputs, outputs)
        start.enter()
        start.play()
        places["signals"] = self._made.image.place(signals)
        self._name()
        self._start(start.starts)
        start.settle()
        start.leave()
        if start.looped or possible_loops(plan):
            raise LiveError(
                "outputs depend on each other at once, an algebraic loop, which a page cannot solve"
            )
        taken = [column.index for column in self._made.columns]
        bound = Binding(plan, signals, inputs, outputs, {}, 1, taken)
        bound.bind()
        self._engine(bound)
        self._tables()
        return self._made

    def _name(self) -> None:
        """Note the addresses of functions, instances and logs."""
        image = self._made.image
        for i, fmu in enumerate(map(fmu_of, self._plan.components)):
            image.handles[fmu.instance.handle] = i
            image.log_numbers[c.addressof(fmu.instance.log)] = i
        self._functions()

    def _functions(self) -> None:
        for fmu in map(fmu_of, self._plan.components):
            for address, name in fmu.instance.functions().items():
                self._made.image.known[address] = fmu.description.token, name

    # ---- the start ---------------------------------------------------------------------------

    def _start(self, starts: Starts) -> None:
        image, state, n = self._made.image, starts.state, len(self._plan.components)
        at = self._struct(state, "start")
        members = (structs.StartingStruct * n).from_address(state.components)
        rows = rows_of(members)
        kinds = {kind.address: kind for kind in starts.kinds if kind is not None}
        found, first = layout(structs.StartingStruct), image.array(structs.StartingStruct, rows)
        image.point(at["components"], first)
        for i, member in enumerate(members):
            place, kind = first + i * found.size, kinds[member.kind]
            for stage, call in kind.left():
                raise LiveError(
                    f"{self._plan.components[i].name}: its start needs {call!r} ({stage}), which a"
                    " page cannot do"
                )
            image.members(member, place)
            image.point(place + found.fields["kind"].offset, self._kind(member.kind))
            row = image.place(c.string_at(member.row, kind.bytes))
            image.point(place + found.fields["row"].offset, row)
        signals = self._made.places["signals"]
        image.point(at["signals"], signals)
        size = 8 * max(1, self._plan.n_signals)
        for name in ("known", "before"):
            image.point(at[name], image.reserve(size))
        image.point(at["room"], image.reserve(max(kind.room for kind in kinds.values())))
        for name in ("stale", "unsettled"):
            image.point(at[name], image.place(b"\1" * n))
        for name in ("waiting", "asked"):
            image.point(at[name], image.reserve(n))
        sources = starts.sources
        assert sources is not None
        bringing = layout(structs.BringingStruct)
        first = image.array(structs.BringingStruct, sources.bringing)
        image.point(at["bringing"], first)
        for i, row in enumerate(sources.bringing):
            if row["initial"]:
                initial = image.copied(c.c_double, int(row["initial"]), int(row["count"]))
                image.point(first + i * bringing.size + bringing.fields["initial"].offset, initial)
        for name in ("fed", "feeds", "first_fed"):
            image.point(at[name], image.place(np.asarray(getattr(sources, name), "<i8")))
        image.point(at["order"], image.place(np.array(exits(self._plan), "<i8")))

    def _kind(self, address: int) -> int:
        """The calls of a kind, copied once."""
        image, struct = self._made.image, structs.StartKindStruct.from_address(address)
        known = image.shared.get(address)
        if known is None:
            found = layout(structs.StartKindStruct)
            row = np.frombuffer(memoryview(struct), row_type(structs.StartKindStruct))
            known = image.shared[address] = image.array(structs.StartKindStruct, row)
            calls = image.copied(structs.StartCallStruct, struct.calls, struct.first[-1])
            image.point(known + found.fields["calls"].offset, calls)
        return known

    def _struct(self, struct: Any, name: str) -> dict[str, int]:
        """Add a struct; the places of its members."""
        kind: Any = type(struct)
        row = np.frombuffer(memoryview(struct), row_type(kind))
        at = self._made.places[name] = self._made.image.array(kind, row)
        return {k: at + member.offset for k, member in layout(kind).fields.items()}

    # ---- ticks -------------------------------------------------------------------------------

    def _engine(self, bound: Binding) -> None:
        self._functions()  # those of steps
        image, places, plan = self._made.image, self._made.places, self._plan
        at = self._struct(bound.state, "engine")
        image.members(bound.state, places["engine"])
        for name, kind, rows in (
            ("operations", structs.OperationStruct, bound.operations),
            (
                "units",
                structs.UnitStruct,
                rows_of(bound.units),
            ),
        ):
            places[name] = image.array(kind, rows)
            image.point(at[name], places[name])
        size = layout(structs.UnitStruct).size
        for i, unit in enumerate(bound.units):
            image.members(unit, places["units"] + i * size)
        image.point(at["signals"], places["signals"])
        for place in image.stops:
            image.point(place, at["stop"])
        self._links(bound, at)
        found = layout(structs.PlayerStruct)
        if plan.players:
            places["players"] = image.reserve(found.size * len(plan.players))
            image.point(at["players"], places["players"])
        self._made.copies += [
            (places["signals"] + 8 * o.index, o.target, o.count)
            for o in plan.operations if o.code in MEANS | SLOPES
        ]  # fmt: skip

    def _links(self, bound: Binding, at: Mapping[str, int]) -> None:
        image, places, links = self._made.image, self._made.places, self._plan.links
        if not links:
            return
        senders, receivers = layout(structs.SenderStruct), layout(structs.LinkStruct)
        places["senders"] = image.array(structs.SenderStruct, rows_of(bound.senders))
        places["links"] = image.array(structs.LinkStruct, rows_of(bound.links))
        image.point(at["senders"], places["senders"])
        image.point(at["links"], places["links"])
        for i, link in enumerate(links):
            width = link.source.size
            needed = max(link.table.history, self._room.get(link.name, (0, 0))[0])
            capacity = 1 << (needed - 1).bit_length()
            self._made.capacity.append(link.table.history)
            sender = places["senders"] + i * senders.size
            image.point(
                sender + senders.fields["history"].offset, image.reserve(8 * width * capacity)
            )
            image.write(sender + senders.fields["capacity"].offset, np.array([capacity], "<i8"))
            receiver = places["links"] + i * receivers.size
            image.point(receiver + receivers.fields["sender"].offset, sender)
            initial = image.reserve(8 * width)
            image.point(receiver + receivers.fields["initial"].offset, initial)
            self._made.copies.append((initial, link.target.start, width))

    def _tables(self) -> None:
        """The tables of links: those that the page draws, and the rows of the others."""
        made, plan, image = self._made, self._plan, self._made.image
        tables = []
        for i, link in enumerate(plan.links):
            state = begun(link.table) if isinstance(link.table, DrawnTable) else None
            self._made.pending.append(0 if state is None else state.capacity)
            if state is not None and state.samples > 0:
                made.drawn.append(i)
                tables.append(state)
        rows = {i: made.hits(x.target.component) for i, x in enumerate(plan.links)}
        played = [made.hits(player.target.component) for player in plan.players]
        if sum(rows.values()) + sum(played) > MOST_ROWS:
            raise LiveError(
                f"found {sum(rows.values()) + sum(played)} rows of links and tables; a page holds"
                f" {MOST_ROWS}: expected a shorter run"
            )
        for i in rows.keys() - set(made.drawn):
            made.frozen[i] = plan.links[i].table.stream().rows(rows[i])
        made.played = [p.source.stream().rows(n) for p, n in zip(plan.players, played, strict=True)]
        if not tables:
            return
        array = (structs.TableStruct * len(tables))(*tables)
        found = layout(structs.TableStruct)
        at = made.places["tables"] = image.array(structs.TableStruct, rows_of(array))
        words, ends = [], []
        for n, i in enumerate(made.drawn):
            table = plan.links[i].table
            assert isinstance(table, DrawnTable)
            place = at + n * found.size
            room = max(made.pending[i], self._room.get(plan.links[i].name, (0, 0))[1])
            image.write(place + found.fields["capacity"].offset, np.array([room], "<i8"))
            image.point(
                place + found.fields["pending"].offset, image.reserve(_PACKET * max(1, room))
            )
            words.append(entropy(table.seed, table.name))
            ends.append(sum(map(len, words)) // 4)
        made.places["words"] = image.place(b"".join(words))
        made.places["ends"] = image.place(np.array(ends, "<i8"))
