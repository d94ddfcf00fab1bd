"""The start of components together: C does the calls of FMUs that it knows, Python the others."""

from __future__ import annotations

import ctypes as c
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from cosim.base.component import Outputs, Values
from cosim.base.errors import FmuError
from cosim.fmi.file.values import check_range
from cosim.fmi.library import Setup
from cosim.fmi.start_calls import StartedFmu, StartKind
from cosim.fmi.start_values import StartValue, check, set_all
from cosim.native import fmu_log
from cosim.native.enums import Stage, StartResult
from cosim.native.shared import library
from cosim.native.structs import (
    StartCallStruct,
    StartingStruct,
    StartKindStruct,
    StartStruct,
)

Ints = NDArray[np.int64]
Given = Mapping[str, Sequence[float]]
#: A number of calls that no component has.
LAST = 1 << 30


class StartingFmu(StartedFmu, Protocol):
    """The members that a start needs of :class:`cosim.fmi.component.FmuComponent`."""

    @property
    def name(self) -> str:
        """The name used in errors."""

    @property
    def begin(self) -> float:
        """Time at which it is initialised, s."""

    @property
    def start_sort(self) -> object:
        """Equal for FMUs whose start has the same calls if the same values are set."""

    def begin_start(self, logs: Iterator[fmu_log.Log]) -> Setup:
        """Have a new instance, which may log to the next of these; raises FmuError."""

    def start_kind(self, setup: Setup, names: tuple[str, ...]) -> StartKind:
        """The calls of its start with numbers of these names. Raises FmuError."""

    def set_intervals(self, values: Values) -> None:
        """Set the intervals of clocks, s. Raises FmuError."""

    def ask_intervals(self) -> None:
        """Take the intervals of clocks that the FMU defines. Raises FmuError."""

    def leave_initialization(self) -> None:
        """Leave Initialization Mode, with the events at the start. Raises FmuError."""

    def first_outputs(self) -> Outputs:
        """The outputs then, each of its declared shape. Raises FmuError."""


class Member(NamedTuple):
    """A component that starts: an FMU with the values it is `given`, flattened; None: another.

    `input`, `output`: where its signals begin.
    """

    fmu: StartingFmu | None
    given: Given
    input: int
    n_inputs: int
    output: int
    n_outputs: int


class InputSources(NamedTuple):
    """The sources of inputs before the first tick, and the components that each one feeds.

    `bringing` (edges,): rows of :class:`cosim.native.structs.BringingStruct`, those of component i
    from fed[i] on; `alive`: what they point to. Component i feeds feeds[first_fed[i]], ...
    """

    bringing: NDArray[np.void]
    fed: Ints
    feeds: Ints
    first_fed: Ints
    alive: Any = None


class Turns(NamedTuple):
    """The calls left to Python, for the component of a number."""

    #: Start one that is no FMU of the engine.
    enter: Callable[[int], None]
    #: Put its outputs for its inputs into the signals.
    say: Callable[[int], None]
    #: Let one leave Initialization Mode that is no FMU of the engine.
    leave: Callable[[int], None]
    #: Take outputs that are new.
    take: Callable[[int, Outputs], None]


class Starts:
    """The start of `members`, whose `signals` (n_signals,) are in the units of their ports.

    `number`: the component at hand, also when an exception is raised. `begin`: s. `kinds`: the
    calls of each component that C does; `state`: what C sees of it all.
    """

    def __init__(
        self,
        members: Sequence[Member],
        signals: NDArray[np.float64],
        turns: Turns,
        sources: InputSources | None = None,
        begin: float = 0.0,
    ) -> None:
        n = len(members)
        self.number = 0
        self._members, self._turns = members, turns
        self.kinds: list[StartKind | None] = [None] * n
        self._numbers: dict[int, NDArray[np.float64]] = {}
        self._rows = np.zeros(n, np.int64)  # of each, among those of its kind
        self.sources = sources
        self._alive: list[Any] = [signals]
        self._components = np.zeros(n, np.dtype(StartingStruct))
        self._flags = np.zeros((4, max(1, n)), np.uint8)
        self.stale, _, self.asked, self.unsettled = self._flags
        self.state = state = StartStruct(n=n, begin=begin)
        state.components, state.signals = self._components.ctypes.data, signals.ctypes.data
        names = ("stale", "waiting", "asked", "unsettled")
        for name, flags in zip(names, self._flags, strict=True):
            setattr(state, name, flags.ctypes.data)
        for name in ("known", "before"):
            self._point(name, np.zeros(len(signals)))
        if sources is not None:
            for name in ("bringing", "fed", "feeds", "first_fed"):
                self._point(name, getattr(sources, name))
        else:
            nothing = np.zeros(n + 1, np.int64)
            self._point("fed", nothing)
            self._point("first_fed", nothing)
        self.unsettled[:] = self.stale[:] = 1

    def _point(self, name: str, array: NDArray[Any]) -> None:
        self._alive.append(array)
        setattr(self.state, name, array.ctypes.data)

    # ---- stages ------------------------------------------------------------------------------

    def enter(self) -> None:
        """Instantiate, set values, and enter Initialization Mode. Raises CosimError."""
        self._instantiate()
        self.state.at = self.state.call = 0
        self._do(Stage.ENTER)

    def settle(self) -> bool:
        """Let components say their outputs until none changes; whether they come to rest."""
        state = self.state
        state.n, state.at, state.call, state.passes = len(self._members), -1, 0, 0
        return self._do(Stage.SAY) is StartResult.DONE

    def leave(self, order: Sequence[int]) -> Iterator[int]:
        """Let FMUs leave Initialization Mode, in this order. Raises CosimError.

        Whenever outputs of one have changed by this, it yields how many have left.
        """
        state, done = self.state, 0
        self._point("order", np.array(order, dtype=np.int64))
        while done < len(order):
            state.n, state.at, state.call, first = len(order), done, 0, done
            try:
                result = self._do(Stage.LEAVE, order)
            finally:
                done = state.at
                self._note(order[first:done], order[done : done + 1], state.call)
            if result is StartResult.CHANGED:
                yield done

    def _note(self, left: Sequence[int], last: Sequence[int], calls: int) -> None:
        """Take note of the FMUs that have left by calls of C; `calls`: those done of the last."""
        last = [i for i in last if (kind := self.kinds[i]) is not None and calls > kind.exit]
        for i in (*left, *last):
            kind, fmu = self.kinds[i], self._members[i].fmu
            if fmu is not None and kind is not None and kind.exits_in_c:
                fmu.instance.left()

    # ---- instances and their values ----------------------------------------------------------

    def _instantiate(self) -> None:
        logs = self._logs()
        kinds: dict[Any, tuple[StartKind, list[int], list[list[float]]]] = {}
        self._others()
        for i, member in enumerate(self._members):
            fmu = member.fmu
            if fmu is None:
                continue
            self.number = i
            setup = fmu.begin_start(logs)
            key = fmu.start_sort, tuple(member.given)
            found = kinds.get(key)
            if found is None:
                kind = fmu.start_kind(setup, tuple(member.given))
                kinds[key] = found = kind, [], []
            parts = [*member.given.values(), *((n,) for n in fmu.sizes.values())]
            if [len(some) for some in parts] != found[0].lengths:
                raise FmuError(self._misfit(member, fmu))
            self.kinds[i] = found[0]
            found[1].append(i)
            found[2].append([v for some in parts for v in some])
        for kind, places, rows in kinds.values():
            self._give(kind, places, np.array(rows, np.float64).reshape(len(rows), kind.width))
        room = max((kind.room for kind, *_ in kinds.values()), default=8)
        self._point("room", np.zeros(room, np.uint8))
        for name in ("input", "n_inputs", "output", "n_outputs"):
            self._components[name] = [getattr(member, name) for member in self._members]

    def _logs(self) -> Iterator[fmu_log.Log]:
        """Logs for new instances, which are made once there is one."""
        yield from fmu_log.logs(sum(member.fmu is not None for member in self._members))

    def _others(self) -> None:
        """Components without a kind have one call a stage, which is Python's."""
        calls = (StartCallStruct * len(Stage))()
        kind = StartKindStruct(c.addressof(calls), tuple(range(len(Stage) + 1)))
        self._alive += [calls, kind]
        self._components["kind"] = c.addressof(kind)

    def _give(self, kind: StartKind, places: list[int], numbers: NDArray[np.float64]) -> None:
        """The values of all FMUs of a kind: `numbers` (FMUs, values), in their units."""
        for k in kind.refused(numbers):
            self.number = places[k]
            for group in kind.limited:
                check_range(group, numbers[k, kind.columns[group.name]].tolist())
        rows = kind.rows(numbers)
        self._numbers[id(kind)] = numbers
        self._alive += [rows, kind]
        self._rows[places] = range(len(places))
        self._components["kind"][places] = kind.address
        instances = [self._fmu(i).instance.handle for i in places]
        self._components["instance"][places] = instances
        first = rows.ctypes.data
        self._components["row"][places] = range(first, first + rows.nbytes, rows.shape[1])

    @staticmethod
    def _misfit(member: Member, fmu: StartingFmu) -> str:
        for name, values in member.given.items():
            if len(values) != fmu.groups[name].size:
                break
        return f"{fmu.name}: {name} has {fmu.groups[name].size} entries, found {len(values)}"

    # ---- turns -------------------------------------------------------------------------------

    def _fmu(self, i: int) -> StartingFmu:
        fmu = self._members[i].fmu
        assert fmu is not None
        return fmu

    def _do(self, stage: Stage, order: Sequence[int] | None = None) -> StartResult:
        """Let C go on, and Python do what C leaves to it."""
        engine, state = library(), self.state
        while True:
            if stage is Stage.SAY:
                result = StartResult(engine.engine_settle(c.byref(state)))
            else:
                result = StartResult(engine.engine_start(c.byref(state), stage))
            if result in (StartResult.DONE, StartResult.CHANGED, StartResult.RESTLESS):
                return result
            self.number = i = state.at if order is None else order[state.at]
            kind = self.kinds[i]
            if result is StartResult.REFUSED and kind is not None:
                suffix = kind.suffixes[stage][state.call]
                self._fmu(i).instance.refuse(suffix, state.status)
            elif stage is Stage.SAY:
                self._turns.say(i)
                state.call = LAST
                continue
            elif kind is None:
                (self._turns.enter if stage is Stage.ENTER else self._turns.leave)(i)
            else:
                self._perform(i, kind, stage)
            state.call += 1

    def _perform(self, i: int, kind: StartKind, stage: Stage) -> None:
        """Do the call at hand of an FMU."""
        call, fmu = kind.stages[stage][self.state.call], self._fmu(i)
        given = list(self._given(i, kind, call.whole or call.groups))
        match call.verb:
            case "set":
                set_all(fmu.instance, given)
            case "set_texts":
                given[0].set_text(fmu.instance)
            case "check":
                check(fmu.name, fmu.instance, given)
            case "setup" | "enter_initialization":
                getattr(fmu.instance, call.verb)(fmu.begin)
            case "enter_configuration" | "exit_configuration":
                getattr(fmu.instance, call.verb)()
            case "set_intervals":
                fmu.set_intervals({one.group.name: np.array(one.values) for one in given})
            case "ask_intervals":
                fmu.ask_intervals()
            case "exit_initialization":
                fmu.leave_initialization()
            case _:
                self._turns.take(i, fmu.first_outputs())

    def _given(self, i: int, kind: StartKind, groups: Sequence[Any]) -> Iterator[StartValue]:
        texts = {group.name: values for group, values in self._fmu(i).start_texts}
        for group in groups:
            if group.name in texts:
                yield StartValue(group, texts[group.name])
            elif group.name in kind.columns:
                row = self._numbers[id(kind)][self._rows[i]]
                yield StartValue(group, row[kind.columns[group.name]].tolist())


class LoneStart:
    """The start of one FMU by itself, which has entered Initialization Mode with these values.

    `values`: by name, each of its shape, in its unit. Raises FmuError.
    """

    def __init__(self, fmu: StartingFmu, values: Values) -> None:
        self._ports = fmu.carried("output")
        inputs, outputs = (sum(g.size for g in fmu.carried(role)) for role in ("input", "output"))
        signals = np.zeros(inputs + outputs)
        self._outputs = signals[inputs:]
        self._found: dict[str, Any] | None = None  # None: C has read the outputs
        given = {name: np.ravel(value).tolist() for name, value in values.items()}
        member = Member(fmu, given, 0, inputs, inputs, outputs)
        turns = Turns(_nothing, _nothing, _nothing, self._take)
        self._starts = Starts([member], signals, turns, begin=fmu.begin)
        self._starts.enter()

    def _take(self, _: int, outputs: Outputs) -> None:
        self._found = dict(outputs)

    def leave(self) -> dict[str, NDArray[Any]]:
        """Leave Initialization Mode; the outputs then, of clocked ones those that ticked."""
        for _ in self._starts.leave([0]):
            pass
        if self._found is not None:
            return self._found
        ends = np.cumsum([0, *(g.size for g in self._ports)]).tolist()
        return {
            g.name: self._outputs[first:end].reshape(g.shape)
            for g, (first, end) in zip(self._ports, pairwise(ends), strict=True)
        }


def _nothing(_: int) -> None:
    """Do nothing, as other components at the start of an FMU by itself."""
