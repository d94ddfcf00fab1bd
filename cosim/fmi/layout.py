"""The order and places of the variables of an FMU: plain data, then the structs C steps by.

A :class:`StepLayout` is plain data and can be sent to another process; :func:`bind` turns it into
the engine's structs for an instance there is.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Sequence
from itertools import chain, pairwise
from typing import Any

from cosim.base.convert import Struct
from cosim.base.errors import FmuError
from cosim.fmi.exchange import ExchangeLayout, bind_exchange
from cosim.fmi.file.intervals import Interval, NextTick
from cosim.fmi.file.variables import TEXTS
from cosim.fmi.library import ERROR, NEVER, OK, Clocked, Instance, TriggeredClock
from cosim.native import enums, shared, structs

#: Clocks whose next tick the FMU says.
ASKED = (enums.ClockKind.CHANGING, enums.ClockKind.COUNTDOWN)
#: FMI type -> (FMI function's name, how engine.c carries it, the C type).
_CARRIED2 = {
    "Real": ("Real", 0, c.c_double),
    "Integer": ("Integer", 6, c.c_int32),
    "Enumeration": ("Integer", 6, c.c_int32),
    "Boolean": ("Boolean", 10, c.c_int32),
}
_CARRIED1 = {**_CARRIED2, "Boolean": ("Boolean", 11, c.c_bool)}
_CARRIED3 = {
    "Float64": ("Float64", 0, c.c_double),
    "Float32": ("Float32", 1, c.c_float),
    "Int8": ("Int8", 2, c.c_int8),
    "UInt8": ("UInt8", 3, c.c_uint8),
    "Int16": ("Int16", 4, c.c_int16),
    "UInt16": ("UInt16", 5, c.c_uint16),
    "Int32": ("Int32", 6, c.c_int32),
    "UInt32": ("UInt32", 7, c.c_uint32),
    "Int64": ("Int64", 8, c.c_int64),
    "UInt64": ("UInt64", 9, c.c_uint64),
    "Enumeration": ("Int64", 8, c.c_int64),
    "Boolean": ("Boolean", 11, c.c_bool),
}

_CARRIED = {"1.0": _CARRIED1, "2.0": _CARRIED2, "3.0": _CARRIED3}


def _signatures(fmi: str) -> int:
    """The version whose functions have the parameters of this one's: FMI 1.0 has those of 2.0."""
    return 3 if fmi == "3.0" else 2


class Move(Struct, frozen=True):
    """Variables of one FMI type: their value references, and the place of every scalar."""

    type: str
    references: tuple[int, ...]
    places: tuple[int, ...]


class Ticker(Struct, frozen=True):
    """An input clock: `period` and first tick `shift` of a periodic one in steps of its FMU, or in
    scheduled execution its `interval`; `place` in the signals of one that is wired; `exact`: the
    FMU is asked for fractions.
    """

    reference: int
    kind: enums.ClockKind
    period: int = 1
    shift: int = 0
    place: int = 0
    interval: Interval | None = None
    exact: bool = False


class Partition(Struct, frozen=True):
    """Variables that are set and got while one of `clocks` (value references) is active."""

    clocks: tuple[int, ...]
    inputs: tuple[Move, ...]
    outputs: tuple[Move, ...]
    texts: tuple[Clocked, ...] = ()


class StepLayout(Struct, frozen=True):
    """The steps of an FMU: `h` s, every `period` ticks, `lag` ticks after its interval began.

    `discrete` inputs are set in Event Mode when they change, `partitions` when a clock ticks.
    `counts`: the signal that counts the ticks of each of `triggered`. `slopes`: inputs whose slope
    is set as well, with the position of the slope in the signals; `starts`: those of the inputs.
    (`input`, `input_count`), (`output`, `output_count`): its ranges of the signal vector.
    `exchange`: how an FMU for model exchange is integrated; all its inputs are `discrete`, since
    what is held jumps. `scheduled`: it is activated by its clocks, from `begin` (s) on.
    """

    h: float
    lag: int
    period: int
    input: int
    input_count: int
    output: int
    output_count: int
    inputs: tuple[Move, ...]
    outputs: tuple[Move, ...]
    discrete: tuple[Move, ...] = ()
    partitions: tuple[Partition, ...] = ()
    clocks: tuple[Ticker, ...] = ()
    triggered: tuple[TriggeredClock, ...] = ()
    counts: tuple[int, ...] = ()
    slopes: Move | None = None
    starts: tuple[int, ...] = ()
    fmi: str = "2.0"
    events: bool = False
    variable: bool = False
    plain: bool = True
    exchange: ExchangeLayout | None = None
    scheduled: bool = False
    begin: float = 0.0


def bind(
    instance: Instance, layout: StepLayout, alive: list[Any], stop: int = 0
) -> structs.UnitStruct:
    """The engine's unit for an instance; its memory is added to `alive`. Raises FmuError.

    `stop`: address of a number (int32) that is not 0 when a step shall return early.
    """
    x = layout
    instance.watch(stop)
    unit = structs.UnitStruct(lag=x.lag, h=x.h, period=x.period, instance=instance.handle)
    unit.input, unit.input_count = x.input, x.input_count
    unit.output, unit.output_count = x.output, x.output_count
    if x.exchange is not None:
        unit.kind = enums.UnitKind.EXCHANGE
        unit.typed = c.addressof(_typed(instance, x, alive))
        unit.exchange = bind_exchange(instance, x.exchange, alive)
        return unit
    if x.scheduled:
        unit.kind, unit.typed = enums.UnitKind.TYPED, c.addressof(_typed(instance, x, alive))
        return unit
    unit.set, unit.step, unit.get = instance.loop_functions()
    unit.direct = _is_direct(x)
    if x.plain:
        unit.kind = enums.UnitKind.FMI3 if x.fmi == "3.0" else enums.UnitKind.FMI2
        unit.values = instance.values_address()
        unit.steps = instance.steps_function() if unit.values else 0
    if x.plain or unit.direct:
        unit.in_rows = 1
        for name, moves in (("inputs", x.inputs), ("outputs", x.outputs)):
            references = list(chain.from_iterable(m.references for m in moves))
            if unit.values:
                references = [i for r in references for i in instance.places(r)]
            unit.in_rows &= all(b == a + 1 for a, b in pairwise(references))
            setattr(unit, name, _array_address(c.c_uint32, references, alive))
            setattr(unit, f"n_{name}", len(references))
    if x.plain:
        return unit
    unit.kind = enums.UnitKind.TYPED
    typed = _typed(instance, x, alive)
    typed.stop = stop or None
    unit.typed = c.addressof(typed)
    return unit


def _is_direct(x: StepLayout) -> bool:
    """True if only events and early return set an FMU of FMI 3.0 apart from a plain one."""
    more = (x.discrete, x.partitions, x.clocks, x.triggered, x.slopes)
    moves = (*x.inputs, *x.outputs)
    if x.plain or x.fmi != "3.0" or any(more) or any(m.type != "Float64" for m in moves):
        return False
    all_of = range(x.input, x.input + x.input_count), range(x.output, x.output + x.output_count)
    return [i for m in moves for i in m.places] == [*all_of[0], *all_of[1]]


def bind_alike(
    instance: Instance, alike: structs.UnitStruct, place: structs.UnitStruct
) -> structs.UnitStruct:
    """The unit of another instance of a plain FMU: as `alike`, with the signals of `place`."""
    unit = structs.UnitStruct.from_buffer_copy(alike)
    unit.instance = instance.handle
    if alike.values:
        unit.values = instance.values_address()
    for name in ("input", "input_count", "output", "output_count"):
        setattr(unit, name, getattr(place, name))
    return unit


def _typed(instance: Instance, x: StepLayout, alive: list[Any]) -> structs.TypedStruct:
    typed = structs.TypedStruct(
        fmi=_signatures(x.fmi), variable=x.variable, next_event=instance.next_event
    )
    for name, verb in (("inputs", "Set"), ("outputs", "Get"), ("discrete", "Set")):
        _move(typed, name, instance, verb, getattr(x, name), x.fmi, alive)
    if x.slopes is not None:
        slopes = _access(instance, "Set", x.slopes, x.fmi, held=False, alive=alive)
        typed.starts = _array_address(c.c_int64, x.starts, alive)
        if x.fmi == "2.0":
            slopes.call = instance.address("SetRealInputDerivatives")
            typed.orders = _array_address(c.c_int32, [1] * len(x.slopes.places), alive)
        typed.slopes = _array_address(structs.AccessStruct, [slopes], alive)
    if x.events:
        typed.enter_event = instance.address("EnterEventMode")
        typed.update = instance.address("UpdateDiscreteStates")
        typed.enter_step = instance.address("EnterStepMode")
    typed.log = c.addressof(instance.log)
    if x.scheduled:
        typed.activate = instance.address("ActivateModelPartition")
    if x.events or x.scheduled:
        _clocked(typed, instance, x, alive)
    alive.append(typed)
    return typed


def _clocked(
    typed: structs.TypedStruct, instance: Instance, x: StepLayout, alive: list[Any]
) -> None:
    """Clocks, and what they move; `active` has a place for each clock."""
    references = [t.reference for t in x.clocks] + [t.reference for t in x.triggered]
    index = {r: i for i, r in enumerate(references)}
    typed.active = _array_address(c.c_bool, [False] * len(index), alive)
    never = NextTick(NEVER)
    tickers = [_ticker(t, x.begin, instance.next_ticks.get(t.reference, never)) for t in x.clocks]
    typed.clocks, typed.n_clocks = (
        _array_address(structs.TickerStruct, tickers, alive),
        len(tickers),
    )
    triggered = []
    for t, count in zip(x.triggered, x.counts, strict=True):
        places = _array_address(c.c_int32, [index[r] for r in t.clocks], alive)
        triggered.append(structs.TriggeredStruct(t.reference, len(t.clocks), places, count))
    typed.triggered = _array_address(structs.TriggeredStruct, triggered, alive)
    typed.n_triggered = len(triggered)
    partitions = []
    for p in x.partitions:
        places = _array_address(c.c_int32, [index[r] for r in p.clocks], alive)
        partition = structs.PartitionStruct(clocks=places, n_clocks=len(p.clocks))
        if p.texts:
            partition.texts = _taking(instance, p.texts, alive)
        for name, verb, moves in (("inputs", "Set", p.inputs), ("outputs", "Get", p.outputs)):
            _move(partition, name, instance, verb, moves, x.fmi, alive)
        partitions.append(partition)
    typed.partitions = _array_address(structs.PartitionStruct, partitions, alive)
    typed.n_partitions = len(partitions)
    if x.clocks and x.events:
        typed.set_clock = instance.address("SetClock")
    if x.triggered:
        typed.get_clock = instance.address("GetClock")
    asked = [t.exact for t in x.clocks if t.kind in ASKED]
    if not all(asked):
        typed.get_interval = instance.address("GetIntervalDecimal")
    if any(asked):
        typed.get_fraction = instance.address("GetIntervalFraction")
    typed.asks = bool(asked)


def _ticker(t: Ticker, begin: float, first: NextTick) -> structs.TickerStruct:
    """A clock before its first tick; `begin` (s): when the FMU starts."""
    found = structs.TickerStruct(
        reference=t.reference, kind=t.kind, period=t.period, shift=t.shift, next=begin + first.time,
        place=t.place, origin=begin, due=begin, count=first.count, resolution=first.resolution,
        exact=t.exact, last=float("-inf"),
    )  # fmt: skip
    if t.interval is not None:
        found.interval, found.offset = t.interval.seconds, t.interval.shift_seconds
        found.counter, found.count = t.interval.counter, t.interval.shift
        found.resolution, found.next = t.interval.resolution, begin + t.interval.shift_seconds
    return found


def _taking(instance: Instance, texts: Sequence[Clocked], alive: list[Any]) -> int:
    """The address of a function that gets these texts of clocks: 0, or 1 where it fails."""

    def take() -> int:
        try:
            for found in texts:
                instance.take_texts(found)
        except FmuError:  # the FMU's log says it as well
            return 1
        return 0

    call = shared.TEXTS(take)
    alive.append(call)
    return shared.address(call)


def late_clock_ticks(unit: structs.UnitStruct) -> tuple[int, float]:
    """Number of late clock ticks of an FMU, and their greatest delay (s)."""
    if not unit.typed:
        return 0, 0.0
    typed = structs.TypedStruct.from_address(unit.typed)
    return typed.late, typed.latest


def _move(
    struct: structs.TypedStruct | structs.PartitionStruct, name: str, instance: Instance, verb: str,
    moves: Sequence[Move], fmi: str, alive: list[Any],
) -> None:  # fmt: skip
    held = name == "discrete"
    accesses = [_access(instance, verb, m, fmi, held=held, alive=alive) for m in moves]
    setattr(struct, name, _array_address(structs.AccessStruct, accesses, alive))
    setattr(struct, f"n_{name}", len(accesses))


def _access(
    instance: Instance, verb: str, move: Move, fmi: str, *, held: bool, alive: list[Any]
) -> structs.AccessStruct:
    count = len(move.places)
    nothing = [float("nan")] * count
    kind: Any = c.c_double
    if move.type in TEXTS:
        call, code, signature = _text_call(instance, verb, move, alive), 0, 2
    else:
        suffix, code, kind = _CARRIED[fmi][move.type]
        call, signature = instance.address(verb + suffix), _signatures(fmi)
    return structs.AccessStruct(
        call=call,
        references=_array_address(c.c_uint32, move.references, alive),
        places=_array_address(c.c_int64, move.places, alive),
        buffer=_array_address(kind, [0] * count, alive),
        held=_array_address(c.c_double, nothing, alive) if held else None,
        n_references=len(move.references),
        count=count,
        type=code,
        fmi=signature,
    )


def _text_call(instance: Instance, verb: str, move: Move, alive: list[Any]) -> int:
    """The address of a function that gets or sets texts by their numbers, as one for reals does."""
    count = len(move.places)

    def call(_: int, __: int, ___: int, numbers: Any) -> int:
        try:
            if verb == "Get":
                for i, text in enumerate(instance.get_texts(move.type, move.references, count)):
                    numbers[i] = instance.numbered.number(text)
            else:
                texts = [instance.numbered.text(number) for number in numbers[:count]]
                instance.set_texts(move.type, move.references, texts)
        except FmuError:  # the FMU's log says it as well
            return ERROR
        return OK

    function = shared.TEXT_ACCESS(call)
    alive.append(function)
    return shared.address(function)


def _array_address(kind: Any, values: Sequence[Any], alive: list[Any]) -> int:
    """The address of a C array of `values`, which is valid as long as `alive` exists."""
    array = (kind * max(1, len(values)))(*values)
    alive.append(array)
    return c.addressof(array)
