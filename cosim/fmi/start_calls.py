"""The calls that start FMUs of one kind, as C does them: see ``start.h``.

Parameters and start values are set after ``fmi2SetupExperiment`` and before Initialization Mode is
entered (FMI 2.0.5 §2.1.6, 3.0.2 §2.3.2), where both "exact" and "approx" ones may be set. Some
exporters set their parameters to the defaults in ``fmi2SetupExperiment``. Others may do so on
entering Initialization Mode, so exact values are set there once more: FMI 2.0 allows this, but not
to read a parameter there. What an FMU computes with in the end is read back, and compared to the
bit: start values just before Initialization Mode is left, since an event may change them
afterwards, parameters after it.
"""

from __future__ import annotations

import ctypes as c
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from cosim.fmi.file.description import Description
from cosim.fmi.file.ports import REAL, VariableGroup, together
from cosim.fmi.file.values import UNLIMITED, limits
from cosim.fmi.file.variables import TEXTS
from cosim.fmi.library import Instance, NativeCall, Setup, uint32
from cosim.fmi.start_values import is_exact, is_parameter
from cosim.native.enums import Form, Number, Stage, ValuePlace
from cosim.native.structs import StartCallStruct, StartKindStruct

#: The function of an instance that calls with values need.
_ACCESS = {"set": "set", "put": "set", "check": "get", "get": "get"}
_NUMBERS = {c.c_double: Number.DOUBLE, c.c_float: Number.FLOAT}
Groups = tuple[VariableGroup, ...]


class StartedFmu(Protocol):
    """The members that the calls need of :class:`cosim.fmi.component.FmuComponent`."""

    @property
    def description(self) -> Description:
        """Its model description."""

    @property
    def groups(self) -> Mapping[str, VariableGroup]:
        """Its variables by name, arrays as one."""

    def carried(self, role: str) -> Sequence[VariableGroup]:
        """Inputs or outputs that are signals, in the order of its ports."""

    @property
    def observes(self) -> bool:
        """True if variables are outputs that are none in the description."""

    @property
    def clocked(self) -> bool:
        """True if its clocks are ticked."""

    @property
    def sizes(self) -> Mapping[str, int]:
        """Sizes of arrays that are set."""

    @property
    def start_texts(self) -> Sequence[tuple[VariableGroup, tuple[str, ...]]]:
        """String and Binary variables with the values they start from."""

    @property
    def instance(self) -> Instance:
        """The FMU that starts. Raises FmuError where there is none."""


class Call(NamedTuple):
    """One call: `verb` is the member of an instance or of :class:`StartedFmu` that does it.

    "put" and "get" move signals, from scalar `place` of the component's inputs or outputs on; "set"
    and "check" values that are given. `groups`: the variables; `whole`: all that are checked then.
    """

    verb: str
    groups: Groups = ()
    whole: Groups = ()
    place: int = 0


class StartKind:
    """The common part of the start of FMUs with one description and the same values set.

    `fmu`: one of them, instantiated as `setup` says. `names`: of the numbers that each is given.
    """

    def __init__(self, fmu: StartedFmu, setup: Setup, names: Sequence[str]) -> None:
        self._tolerance = setup.tolerance
        self.numbers = tuple(fmu.groups[name] for name in names)
        ends = np.cumsum([0, *(g.size for g in self.numbers)]).tolist()
        #: Where the values of each variable are among those of an FMU.
        self.columns = {
            g.name: slice(*ends_) for g, ends_ in zip(self.numbers, pairwise(ends), strict=True)
        }
        self.width: int = ends[-1]
        self.lengths = [g.size for g in self.numbers]
        #: Variables with limits: an FMU judges sizes itself, and what sets clocks their intervals.
        self.limited = tuple(
            g for g in self.numbers if g.name not in fmu.sizes and g.first.type != "Clock"
        )
        own = {g.name for g in self.limited}
        bounds = [
            limits(g) if g.name in own else UNLIMITED for g in self.numbers for _ in range(g.size)
        ]
        self._limits = np.array(bounds).reshape(-1, 3).T
        #: Parts of a row: first byte, columns and type of the values of one call.
        self._segments: dict[tuple[Any, ...], tuple[int, list[int], Any]] = {}
        #: Bytes of a row, and of the values of the longest call that compares.
        self.bytes = self.room = 8
        self.stages = [_enter(fmu, self.numbers), _say(fmu), _leave(fmu, self.numbers)]
        self.stages[Stage.LEAVE] = list(_one_by_one(fmu.instance, self.stages[Stage.LEAVE]))
        natives = [[_native(fmu.instance, call) for call in calls] for calls in self.stages]
        #: The functions of each stage, without the prefix.
        self.suffixes = [[x.suffix if x else "" for x in some] for some in natives]
        #: The forms of their calls.
        self.forms = [[x.form if x else Form.OTHER for x in some] for some in natives]
        #: The call that leaves Initialization Mode, and whether C does it.
        self.exit = [call.verb for call in self.stages[Stage.LEAVE]].index("exit_initialization")
        self.exits_in_c = natives[Stage.LEAVE][self.exit] is not None
        self._alive: list[Any] = []
        made = [
            self._struct(fmu.instance, call, native)
            for calls, some in zip(self.stages, natives, strict=True)
            for call, native in zip(calls, some, strict=True)
        ]
        self._calls = (StartCallStruct * max(1, len(made)))(*made)
        self._struct_ = StartKindStruct(c.addressof(self._calls))
        for stage in Stage:
            self._struct_.first[stage + 1] = self._struct_.first[stage] + len(self.stages[stage])
        self.address = c.addressof(self._struct_)

    def _struct(self, x: Instance, call: Call, native: NativeCall | None) -> StartCallStruct:
        if native is None:
            return StartCallStruct(form=Form.OTHER)
        found = StartCallStruct(
            form=native.form,
            function=x.address(native.suffix) if native.suffix else None,
            tolerance=self._tolerance or 0.0,
            has_tolerance=self._tolerance is not None,
        )
        if not call.groups:
            return found
        references = uint32([r for g in call.groups for r in g.references])
        self._alive.append(references)
        found.references, found.n_references = c.addressof(references), len(references)
        found.n_values = sum(g.size for g in call.groups)
        found.bytes = found.n_values * c.sizeof(native.value)
        if call.verb in ("put", "get"):
            found.values, found.output = ValuePlace.SIGNALS, call.verb == "get"
            found.place = call.place * c.sizeof(native.value)
            return found
        found.place = self._segment(call.groups, native.value, found.bytes)
        if call.verb == "check":
            found.values = ValuePlace.EQUAL
            found.number = _NUMBERS.get(native.value, Number.WHOLE)
            self.room = max(self.room, found.bytes)
        return found

    def _segment(self, groups: Groups, value: Any, size: int) -> int:
        key = value, *(g.name for g in groups)
        if key not in self._segments:
            places = [range(*self.columns[g.name].indices(self.width)) for g in groups]
            self._segments[key] = self.bytes, [i for some in places for i in some], value
            self.bytes += -(-size // 8) * 8
        return self._segments[key][0]

    def left(self) -> Iterator[tuple[Stage, str]]:
        """The calls that C leaves to Python: stage and verb."""
        for stage in Stage:
            for call, form in zip(self.stages[stage], self.forms[stage], strict=True):
                if form is Form.OTHER:
                    yield stage, call.verb

    def refused(self, numbers: NDArray[np.float64]) -> NDArray[np.int64]:
        """FMUs that may have values beyond their limits; `numbers` (FMUs, values), their units."""
        low, high, whole = self._limits
        fine = (numbers >= low) & (numbers <= high)
        fine &= (whole == 0.0) | (np.trunc(numbers) == numbers)
        return np.flatnonzero(~fine.all(axis=1))

    def rows(self, numbers: NDArray[np.float64]) -> NDArray[np.uint8]:
        """The values as the FMUs take them, (FMUs, bytes), of `numbers` (FMUs, values)."""
        found = np.zeros((len(numbers), self.bytes), np.uint8)
        for first, columns, value in self._segments.values():
            end = first + len(columns) * c.sizeof(value)
            found[:, first:end].view(np.dtype(value))[...] = numbers[:, columns]
        return found


def _native(x: Instance, call: Call) -> NativeCall | None:
    """The C function of a call; None: there is none."""
    if call.verb not in _ACCESS:
        return x.native(call.verb)
    kinds = {g.first.type for g in call.groups}
    if len(together(call.groups)) != 1 or kinds & set(TEXTS):
        return None
    return x.native(_ACCESS[call.verb], kinds.pop())


def _sets(groups: Iterable[VariableGroup]) -> list[Call]:
    found = []
    for kind, some in together(groups):
        if kind in TEXTS:
            found += [Call("set_texts", (g,)) for g in some]
        else:
            found.append(Call("set", tuple(some)))
    return found


def _given(fmu: StartedFmu, numbers: Groups) -> tuple[Groups, Groups, Groups]:
    """The given values: structural parameters, inputs, and everything else by causality."""
    by = defaultdict[str, list[VariableGroup]](list)
    sizes = [g for g in numbers if g.name in fmu.sizes]
    own = [g for g in numbers if g.first.type != "Clock" and g.name not in fmu.sizes]
    for g in (*own, *(g for g, _ in fmu.start_texts), *sizes):
        by[g.first.causality].append(g)
    structural, inputs = by.pop("structuralParameter", []), by.pop("input", [])
    return tuple(structural), tuple(inputs), tuple(g for some in by.values() for g in some)


def _enter(fmu: StartedFmu, numbers: Groups) -> list[Call]:
    """Into Initialization Mode, with everything set but numeric inputs, which others bring."""
    structural, inputs, given = _given(fmu, numbers)
    found = []
    if structural:
        found = [Call("enter_configuration"), *_sets(structural), Call("exit_configuration")]
    found += [Call("setup"), *_sets(given), Call("enter_initialization")]
    if fmu.description.fmi != "1.0":  # which has no Initialization Mode
        found += _sets(g for g in given if is_exact(g))
    found += [Call("set_texts", (g,)) for g in inputs if g.first.type in TEXTS]
    clocks = tuple(g for g in numbers if g.first.type == "Clock")
    return [*found, Call("set_intervals", clocks)] if clocks else found


def _say(fmu: StartedFmu) -> list[Call]:
    """Outputs for inputs, in Initialization Mode."""
    inputs, outputs = fmu.carried("input"), fmu.carried("output")
    free = all(limits(g) == UNLIMITED for g in inputs)
    moves = _moves("put", inputs), _moves("get", outputs)
    if fmu.observes or not free or moves[0] is None or moves[1] is None:
        return [Call("initial")]
    return [*moves[0], *moves[1]]


def _leave(fmu: StartedFmu, numbers: Groups) -> list[Call]:
    """Out of Initialization Mode, with the events at the start, and the outputs then."""
    structural, _, given = _given(fmu, numbers)
    exact = [g for g in given if is_exact(g)]
    before = tuple(g for g in exact if not is_parameter(g))
    after = (*structural, *(g for g in exact if is_parameter(g)))
    found = [Call("ask_intervals")] if fmu.clocked else []
    found += [Call("check", before)] if before else []
    leaves = Call("exit_initialization")
    found.append(leaves)
    found += [Call("check", after)] if after else []
    # if Python lets it leave, Python reads its outputs, and asks whether it has ended
    in_c = _native(fmu.instance, leaves) is not None
    outputs = _moves("get", fmu.carried("output")) if in_c else None
    return [*found, *([Call("outputs")] if outputs is None else outputs)]


def _moves(verb: str, groups: Sequence[VariableGroup]) -> list[Call] | None:
    """The calls that move signals; None: they are no reals, or do not follow each other."""
    ends = np.cumsum([0, *(g.size for g in groups)]).tolist()
    number = {g.name: i for i, g in enumerate(groups)}
    found = []
    for kind, some in together(groups):
        first = number[some[0].name]
        if kind not in REAL or list(groups[first : first + len(some)]) != some:
            return None
        found.append(Call(verb, tuple(some), place=ends[first]))
    return found


def _one_by_one(x: Instance, calls: Iterable[Call]) -> Iterable[Call]:
    """Values that C compares, type by type; all at once where Python must."""
    for call in calls:
        parts = [Call("check", tuple(some), call.groups) for _, some in together(call.groups)]
        if call.verb != "check":
            yield call
        elif all(_native(x, part) for part in parts):
            yield from parts
        else:
            yield call._replace(whole=call.groups)
