"""An instance of an FMU, and the checked functions of its shared library.

There is one class per standard, :class:`cosim.fmi.fmi2.Instance2` (FMI 2.0.5) and
:class:`cosim.fmi.fmi3.Instance3` (FMI 3.0.2), and one for an FMU in a separate process
(:mod:`cosim.fmi.isolation`), with the same members. :mod:`cosim.fmi.instances` selects the class.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Callable, Mapping, Sequence
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, Protocol

from cosim.base.convert import Struct
from cosim.base.errors import FmuError
from cosim.fmi.file.binaries import is_sandboxed, missing_bytes
from cosim.fmi.file.intervals import Interval, Intervals, NextTick
from cosim.fmi.file.values import NumberedTexts
from cosim.fmi.options import PATIENCE
from cosim.native import fmu_log, shared
from cosim.native.enums import Form

#: Rounds of an event iteration before it is given up.
EVENTS_AT_MOST = 100_000
#: A time event that never comes (s).
NEVER = float("inf")
OK, WARNING, DISCARD, ERROR, FATAL, PENDING = range(6)
_STATUS = {2: "discard", 3: "error", 4: "fatal", 5: "pending"}


def status_name(status: int) -> str:
    """A status in words; one that FMI does not define counts as an error."""
    return _STATUS.get(status, f"the unknown status {status}")


class Instance(Protocol):
    """One instance of an FMU; `next_event` (s): the time event it announced; `numbered`: the texts
    that signals carry.
    """

    log: fmu_log.Log
    handle: int
    next_event: float
    numbered: NumberedTexts

    @property
    def broken(self) -> int:
        """ERROR or FATAL where one was returned: what may still be called; else OK."""

    def trapped(self) -> str:
        """Tell what it did in the call that ended it, in WebAssembly; "": nothing."""

    @property
    def sandboxed(self) -> bool:
        """True if its binary is WebAssembly: what C calls is Python."""

    def watch(self, stop: int) -> None:
        """Let calls in WebAssembly end soon once the number at an address (int32) is not 0."""

    def returned(self, status: int) -> None:
        """Take note of a status that the engine got."""

    def refuse(self, suffix: str, status: int) -> None:
        """Raise FmuError for a bad status of a function, its name without the prefix."""

    def native(self, verb: str, kind: str = "") -> NativeCall | None:
        """The C call that does the same as a member of this, for an FMI type; None: none."""

    def left(self) -> None:
        """Take note that C has left Initialization Mode."""

    @property
    def next_ticks(self) -> Mapping[int, NextTick]:
        """The next ticks of the clocks that the FMU is asked for, by value reference."""

    def setup(self, t0: float) -> None:
        """Set up the experiment from `t0` (s), with the tolerance and no stop time (FMI 2.0)."""

    def enter_initialization(self, t0: float) -> None:
        """Enter Initialization Mode at `t0` (s)."""

    def intervals(self, clocks: Mapping[int, bool]) -> dict[int, Interval]:
        """Interval and shift of periodic clocks, in Initialization Mode; true: as fractions."""

    def set_intervals(self, given: Intervals) -> None:
        """Set the interval of fixed and tunable clocks, in Initialization Mode."""

    def exit_initialization(self, clocks: Clocks | None = None) -> dict[str, list[float]]:
        """Leave Initialization Mode for Step Mode; values of clocks that ticked then, by name."""

    def has_ended(self) -> bool:
        """True if it ended the simulation in the events of its start."""

    def terminated(self) -> float | None:
        """After a step that was discarded: the time (s) it came to if it ends the simulation."""

    def clocked_texts(self) -> dict[str, list[str]]:
        """Texts of clocks as they were when these last ticked, by name."""

    def set_clocked_texts(self, found: dict[str, list[str]]) -> None:
        """Go back to such texts of an earlier time."""

    def take_texts(self, found: Clocked) -> None:
        """Get such a text, now that its clock ticks."""

    def get(self, kind: str, references: Sequence[int], count: int) -> list[float]:
        """Values of variables of an FMI type, `count` scalars in all."""

    def set(self, kind: str, references: Sequence[int], values: Sequence[float]) -> None:
        """Set variables of an FMI type, all scalars in order."""

    def get_texts(self, kind: str, references: Sequence[int], count: int) -> list[str]:
        """Values of String variables, or of Binary ones as hexadecimal text."""

    def set_texts(self, kind: str, references: Sequence[int], values: Sequence[str]) -> None:
        """Set String variables, or Binary ones from hexadecimal text."""

    def enter_configuration(self) -> None:
        """Enter Configuration Mode, where structural parameters are set before anything else."""

    def exit_configuration(self) -> None:
        """Leave Configuration Mode."""

    def address(self, suffix: str) -> int:
        """The address of an FMI function, its name without the prefix."""

    def do_step(self, t: float, h: float) -> None:
        """One communication step."""

    def get_state(self) -> int:
        """Save the state; returns the handle of it."""

    def reset(self) -> None:
        """Go back to as it was after its instantiation, with nothing logged."""

    def set_state(self, state: int) -> None:
        """Go back to a saved state."""

    def free_state(self, state: int) -> None:
        """Give a saved state back."""

    def serialized(self) -> bytes:
        """The state as bytes, for :meth:`set_serialized` of another instance."""

    def set_serialized(self, data: bytes) -> None:
        """Go to a state that was serialized."""

    def directional(
        self, unknowns: Sequence[int], knowns: Sequence[int], seed: Sequence[float], count: int
    ) -> list[float]:
        """Derivatives of variables, `count` scalars, along `seed`, a direction of others; in their
        units.
        """

    def state_functions(self) -> tuple[int, int]:
        """Addresses of the functions that save the state, and that restore it."""

    def free(self) -> None:
        """Terminate and free the instance; may be called twice."""

    def functions(self) -> dict[int, str]:
        """Names of the functions that were asked for, by address."""

    def loop_functions(self) -> tuple[int, int, int]:
        """Addresses of the functions that set, step and get in the loop."""

    def steps_function(self) -> int:
        """Address of a function that steps several instances at once; 0: there is none."""

    def values_address(self) -> int:
        """The address at which values can be written and read between steps; 0: they cannot."""

    def places(self, reference: int) -> range:
        """The entries of a variable among these values."""


class NativeCall(NamedTuple):
    """A call that C does: its form, the function's name without the prefix, and how values are
    passed.
    """

    form: Form
    suffix: str = ""
    value: Any = c.c_double


class TriggeredClock(Struct, frozen=True):
    """A clock that the FMU ticks; `clocks`: it can do so only while one of these is active."""

    reference: int
    clocks: tuple[int, ...]


class Clocked(Struct, frozen=True):
    """An output of `count` scalars that can be got while one of `clocks` is active; or a clock."""

    name: str
    type: str
    references: tuple[int, ...]
    count: int
    clocks: tuple[int, ...]


class Clocks(Struct, frozen=True):
    """The questions to clocks: when those tick next that are changing or count down (by value
    reference), which of `triggered` tick, and what then belongs to them. `fractions`: of which
    intervals are asked for as fractions.
    """

    changing: tuple[int, ...] = ()
    countdown: tuple[int, ...] = ()
    triggered: tuple[TriggeredClock, ...] = ()
    clocked: tuple[Clocked, ...] = ()
    texts: tuple[Clocked, ...] = ()
    fractions: tuple[int, ...] = ()


class Setup(NamedTuple):
    """The settings of a new instance. `early_return`, `event_mode`: FMI 3.0 only.

    `tolerance`: relative tolerance of the FMU's own solver; None: it is left to the FMU.
    `interface`: one of :data:`cosim.fmi.file.description.INTERFACES`. `intermediate`: inputs (value
    references) that are set within a step; None: without intermediate update. `patience` (s) of a
    call, `memory` (MB; 0: 1024): limits of a WebAssembly component.
    """

    fmi: str
    path: Path
    name: str
    token: str
    resources: Path
    logging: bool = False
    event_mode: bool = False
    early_return: bool = False
    tolerance: float | None = None
    interface: str = "CoSimulation"
    intermediate: tuple[int, ...] | None = None
    patience: float = PATIENCE
    memory: int = 0


@cache
def _loaded(path: str, limits: tuple[float, int]) -> tuple[Any, dict[tuple[Any, ...], Any]]:
    """A library, which stays loaded, and its functions by name and types. Raises OSError.

    `limits`: of a WebAssembly component, see :class:`Setup`.
    """
    if is_sandboxed(Path(path)):
        from cosim.sandbox.library import SandboxLibrary  # few runs need it
        from cosim.sandbox.runtime import Limits

        return SandboxLibrary(Path(path), Limits(*limits)), {}
    lacks = missing_bytes(Path(path))
    if lacks:
        raise OSError(f"the file is {lacks} bytes too short")
    return c.CDLL(path), {}


class Calls:
    """A library's functions, each checked: absent ones and bad statuses become FmuError."""

    __slots__ = (
        *("library", "_functions", "prefix", "name", "log", "_checked", "broken", "started"),
        *("_called", "_close", "_at", "_stem", "sandboxed"),
    )

    def __init__(self, setup: Setup, prefix: str, log: fmu_log.Log) -> None:
        try:
            limits = (setup.patience, setup.memory)
            self.library, self._functions = _loaded(str(setup.path), limits)
        except OSError as error:
            raise FmuError(f"{setup.name}: cannot load {setup.path.name}: {error}") from error
        self.prefix, self.name, self.log = prefix, setup.name, log
        self._stem, self.sandboxed = setup.path.stem, is_sandboxed(setup.path)
        engine = shared.library()
        self._called, self._close = setup.name.encode(), engine.engine_log_close
        self._at = c.byref(log)
        engine.engine_log_open(self._called, self._at)
        self._checked: dict[str, Callable[..., None]] = {}
        #: OK, ERROR or FATAL: the worst that was returned.
        self.broken = OK
        #: Whether initialization is over: only then may an instance be terminated.
        self.started = False

    def __del__(self) -> None:
        """Let what the FMU still says be lost."""
        if hasattr(self, "_close"):
            self._close(self._at)

    def function(self, suffix: str, *types: Any, result: Any = c.c_int) -> Any:
        """A function by its name without the prefix. Raises FmuError where it is missing."""
        known = self._functions.get((self.prefix + suffix, types, result))
        if known is not None:
            return known
        for name in (self.prefix + suffix, f"{self._stem}_{self.prefix}{suffix}"):
            try:  # the second: compiled as a static library would be
                function = self.library[name]
                break
            except AttributeError:
                continue
        else:
            raise FmuError(f"{self.name}: the binary lacks {self.prefix}{suffix}")
        function.argtypes, function.restype = types, result
        self._functions[self.prefix + suffix, types, result] = function
        return function

    def addresses(self) -> dict[int, str]:
        """Names of the functions of the library that were asked for, by address."""
        return {shared.address(f): name for (name, *_), f in self._functions.items()}

    def checked(self, suffix: str, *types: Any) -> Callable[..., None]:
        """The same, raising FmuError for every status but OK and warning.

        After an error or a fatal one nothing is called any more, and FmuError says so.
        """
        if suffix in self._checked:
            return self._checked[suffix]
        function, name = self.function(suffix, *types), f"{self.prefix}{suffix}"

        def call(*arguments: Any) -> None:
            if self.broken:
                raise FmuError(f"{self.name}: {name} must not be called after an error of the FMU")
            status = function(*arguments)
            if status not in (OK, WARNING):
                self.refuse(suffix, status, arguments[0])

        self._checked[suffix] = call
        return call

    def refuse(self, suffix: str, status: int, handle: int) -> NoReturn:
        """Raise FmuError for a status that a function returned, its name without the prefix."""
        self.returned(status)
        said, name = self.log.said(), f"{self.prefix}{suffix}"
        if self.sandboxed and (did := self.trapped(handle)):
            raise FmuError(f"{self.name}: {name} {did} ({said})")
        raise FmuError(f"{self.name}: {name} returned {status_name(status)}: {said}")

    def returned(self, status: int) -> None:
        """Take note of a status: it decides what may be called (FMI 2.0.5 §2.1.3, 3.0.2 §2.2.3).

        A pending step could only be asked about, so nothing is called after it either.
        """
        if status not in (OK, WARNING, DISCARD):
            pending = status == PENDING and self.prefix == "fmi2"
            worst = FATAL if status == FATAL or pending else ERROR
            self.broken = max(self.broken, worst)

    def free(self, handle: int) -> None:
        """Terminate unless there was an error, free unless one was fatal."""
        if self.started and not self.broken:
            self.returned(self.function("Terminate", c.c_void_p)(handle))
        if self.broken < FATAL or self.sandboxed:
            self.function("FreeInstance", c.c_void_p, result=None)(handle)

    def trapped(self, handle: int) -> str:
        """Tell what an instance in WebAssembly did in the call that ended it; "": nothing."""
        if not self.sandboxed:
            return ""
        from cosim.sandbox.library import trapped

        return trapped(handle)

    def watch(self, handle: int, stop: int) -> None:
        """Let calls in WebAssembly end soon once the number at an address (int32) is not 0."""
        if self.sandboxed and stop:
            from cosim.sandbox.library import watch

            watch(handle, stop)


def uint32(values: Sequence[int]) -> Any:
    """A C array of value references, which is not to be changed: many calls have the same."""
    return _references(tuple(values))


@lru_cache(maxsize=1024)
def _references(values: tuple[int, ...]) -> Any:
    return (c.c_uint32 * len(values))(*values)


def array_of(kind: Any, values: Sequence[Any]) -> Any:
    """A C array of `kind` with these values."""
    return (kind * len(values))(*values)


def texts_of(values: Any) -> list[str]:
    """Texts of an array of C strings; invalid UTF-8 is marked."""
    return [(v or b"").decode("utf-8", "replace") for v in values]
