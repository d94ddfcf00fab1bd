"""The functions of an FMI 2.0 library through ctypes: the cold calls, and the hot addresses."""

from __future__ import annotations

import ctypes as c
from collections.abc import Callable, Mapping, Sequence
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, ClassVar

from cosim.base.errors import FmuError
from cosim.fmi.alike import CommonInstance
from cosim.fmi.file.intervals import Interval, Intervals, NextTick
from cosim.fmi.library import (
    EVENTS_AT_MOST,
    NEVER,
    Calls,
    Clocked,
    Clocks,
    NativeCall,
    Setup,
    array_of,
    texts_of,
    uint32,
)
from cosim.native import fmu_log, shared
from cosim.native.enums import Form

_NATIVE = {
    "setup": NativeCall(Form.SETUP2, "SetupExperiment"),
    "enter_initialization": NativeCall(Form.MODE, "EnterInitializationMode"),
    "exit_initialization": NativeCall(Form.MODE, "ExitInitializationMode"),
}
_LAST_SUCCESSFUL_TIME, _TERMINATED = 2, 3  # of fmi2StatusKind


class _Callbacks2(c.Structure):
    _fields_ = (
        ("logger", c.c_void_p),
        ("allocate", c.c_void_p),
        ("free", c.c_void_p),
        ("finished", c.c_void_p),
        ("environment", c.c_void_p),
    )


@cache
def _callbacks() -> tuple[int, int, int]:
    """Addresses of the logger and of the memory functions."""
    libc, address = c.CDLL(None), shared.address
    return address(shared.library().engine_log2), address(libc.calloc), address(libc.free)


@lru_cache(maxsize=64)
def _uri(folder: Path) -> bytes:
    return folder.as_uri().encode()


class _EventInfo(c.Structure):
    _fields_ = (
        *((n, c.c_int) for n in ("again", "terminate", "nominals", "values", "defined")),
        ("next", c.c_double),
    )


class Instance2(CommonInstance):
    """An instance of an FMI 2.0 FMU, for co-simulation or for model exchange."""

    VERSION = "2.0"
    ENUMERATION = "Integer"
    #: How values are passed, by FMI type.
    TYPES: ClassVar[Mapping[str, Any]] = {
        "Real": c.c_double, "Integer": c.c_int, "Boolean": c.c_int, "Enumeration": c.c_int,
    }  # fmt: skip
    STATE, READ = "FMUstate", "DeSerialize"
    HOT = ("SetReal", "DoStep", "GetReal")
    next_ticks: Mapping[int, NextTick] = {}

    def __init__(self, setup: Setup, log: fmu_log.Log) -> None:
        self._calls = calls = Calls(setup, "fmi2", log)
        self._tolerance, self._exchange = setup.tolerance, setup.interface == "ModelExchange"
        self.next_event, self._ended = NEVER, False
        self.log = calls.log
        self._callbacks = _Callbacks2(*_callbacks(), None, c.addressof(self.log))
        instantiate = calls.function(
            "Instantiate",
            *(c.c_char_p, c.c_int, c.c_char_p, c.c_char_p, c.c_void_p, c.c_int, c.c_int),
            result=c.c_void_p,
        )
        self.handle: int = instantiate(
            setup.name.encode(), int(not self._exchange), setup.token.encode(),
            _uri(setup.resources), c.byref(self._callbacks), 0, int(setup.logging),
        )  # fmt: skip
        if not self.handle:
            raise FmuError(f"{setup.name}: fmi2Instantiate failed: {self.log.said()}")

    def native(self, verb: str, kind: str = "") -> NativeCall | None:
        """The C call that does the same as a member of this, for an FMI type; None: none."""
        if verb in ("get", "set"):
            return NativeCall(Form.VALUES2, self._suffix(verb, kind), self.TYPES[kind])
        if verb == "exit_initialization" and self._exchange:
            return None
        return _NATIVE.get(verb)

    def setup(self, t0: float) -> None:
        """Set up the experiment from `t0`, s (§2.1.6 of FMI 2.0.5), with no stop time."""
        setup = self._calls.checked(
            "SetupExperiment", c.c_void_p, c.c_int, c.c_double, c.c_double, c.c_int, c.c_double
        )
        tolerance = self._tolerance
        setup(self.handle, int(tolerance is not None), tolerance or 0.0, t0, 0, 0.0)

    def enter_initialization(self, t0: float) -> None:
        """Enter Initialization Mode (§2.1.6 of FMI 2.0.5); `t0`, s, was given to :meth:`setup`."""
        self._calls.checked("EnterInitializationMode", c.c_void_p)(self.handle)

    def intervals(self, clocks: Mapping[int, bool]) -> dict[int, Interval]:
        """Interval and shift of clocks: FMI 2.0 has no clocks. Raises FmuError."""
        raise FmuError(f"{self._calls.name}: FMI {self.VERSION} has no clocks")

    def set_intervals(self, given: Intervals) -> None:
        """Set intervals of clocks: FMI 2.0 has no clocks. Raises FmuError."""
        raise FmuError(f"{self._calls.name}: FMI {self.VERSION} has no clocks")

    def clocked_texts(self) -> dict[str, list[str]]:
        """FMI 2.0 has no clocks."""
        return {}

    def set_clocked_texts(self, found: dict[str, list[str]]) -> None:
        """There are none in FMI 2.0."""

    def take_texts(self, found: Clocked) -> None:
        """Take texts of clocked variables: FMI 2.0 has no clocks. Raises FmuError."""
        raise FmuError(f"{self._calls.name}: FMI {self.VERSION} has no clocks")

    def exit_initialization(self, clocks: Clocks | None = None) -> dict[str, list[float]]:
        """Leave Initialization Mode; no values of clocked variables, in any unit."""
        self._calls.checked("ExitInitializationMode", c.c_void_p)(self.handle)
        self._calls.started = True
        if self._exchange:
            self._leave_event_mode()
        return {}

    def _leave_event_mode(self) -> None:
        """Go from the events at the start to Continuous-Time Mode (§3.2 of FMI 2.0.5)."""
        update, info = self._calls.checked("NewDiscreteStates", *(c.c_void_p,) * 2), _EventInfo()
        for _ in range(EVENTS_AT_MOST):
            update(self.handle, c.byref(info))
            if info.terminate:
                self._ended = True
                return
            if not info.again:
                break
        else:
            raise FmuError(f"{self._calls.name}: its discrete states do not converge")
        self.next_event = info.next if info.defined else NEVER
        self._calls.checked("EnterContinuousTimeMode", c.c_void_p)(self.handle)

    def has_ended(self) -> bool:
        """True if it ended the simulation in the events at its start: for model exchange only."""
        return self._ended

    def terminated(self) -> float | None:
        """``fmi2Terminated``, and ``fmi2LastSuccessfulTime`` (s) if it is so (FMI 2.0.5 §4.2.2)."""
        types = (c.c_void_p, c.c_int)
        ended, time = c.c_int(), c.c_double()
        try:
            self._calls.checked("GetBooleanStatus", *types, c.c_void_p)(
                self.handle, _TERMINATED, c.byref(ended)
            )
            if ended.value:
                self._calls.checked("GetRealStatus", *types, c.c_void_p)(
                    self.handle, _LAST_SUCCESSFUL_TIME, c.byref(time)
                )
        except FmuError:  # it does not say, which is no wish to end
            return None
        return time.value if ended.value else None

    def _access(self, verb: str, kind: str) -> Callable[..., None]:
        suffix = self._suffix(verb, kind)
        return self._calls.checked(suffix, c.c_void_p, c.c_void_p, c.c_size_t, c.c_void_p)

    def get(self, kind: str, references: Sequence[int], count: int) -> list[float]:
        """Values, in the FMU's units, by ``fmi2GetReal`` or the function of another type."""
        values = (self.TYPES[kind] * count)()
        self._access("Get", kind)(self.handle, uint32(references), len(references), values)
        return [float(v) for v in values]

    def set(self, kind: str, references: Sequence[int], values: Sequence[float]) -> None:
        """Set values, in the FMU's units, by ``fmi2SetReal`` or the function of another type."""
        convert = float if kind == "Real" else int
        array = array_of(self.TYPES[kind], [convert(v) for v in values])
        self._access("Set", kind)(self.handle, uint32(references), len(references), array)

    def get_texts(self, kind: str, references: Sequence[int], count: int) -> list[str]:
        """``fmi2GetString``."""
        values = (c.c_char_p * count)()
        self._access("Get", "String")(self.handle, uint32(references), count, values)
        return texts_of(values)

    def set_texts(self, kind: str, references: Sequence[int], values: Sequence[str]) -> None:
        """``fmi2SetString``."""
        array = array_of(c.c_char_p, [v.encode() for v in values])
        self._access("Set", "String")(self.handle, uint32(references), len(values), array)

    def enter_configuration(self) -> None:
        """Enter Configuration Mode: FMI 2.0 has no structural parameters. Raises FmuError."""
        raise FmuError(f"{self._calls.name}: FMI {self.VERSION} has no structural parameters")

    def exit_configuration(self) -> None:
        """Leave Configuration Mode: FMI 2.0 has no structural parameters. Raises FmuError."""
        raise FmuError(f"{self._calls.name}: FMI {self.VERSION} has no structural parameters")

    def address(self, suffix: str) -> int:
        """The address of ``fmi2<suffix>``. Raises FmuError where the binary lacks it."""
        return shared.address(self._calls.function(suffix))

    def do_step(self, t: float, h: float) -> None:
        """``fmi2DoStep`` from `t` over `h`, s (§4.2.2 of FMI 2.0.5)."""
        step = self._calls.checked("DoStep", c.c_void_p, c.c_double, c.c_double, c.c_int)
        step(self.handle, t, h, 0)
