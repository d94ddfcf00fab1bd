"""The functions of an FMI 1.0 library: their names begin with the model's."""

from __future__ import annotations

import ctypes as c
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from cosim.base.errors import FmuError
from cosim.fmi.fmi2 import Instance2
from cosim.fmi.library import EVENTS_AT_MOST, FATAL, NEVER, Calls, Clocks, NativeCall, Setup
from cosim.native import fmu_log, shared


class _Callbacks1(c.Structure):
    _fields_ = tuple((n, c.c_void_p) for n in ("logger", "allocate", "free", "finished"))


class _ModelCallbacks1(c.Structure):
    _fields_ = tuple((n, c.c_void_p) for n in ("logger", "allocate", "free"))


class _EventInfo1(c.Structure):
    _fields_ = (
        *((n, c.c_char) for n in ("converged", "references", "values", "terminate", "defined")),
        ("next", c.c_double),
    )


class Instance1(Instance2):
    """A slave of FMI 1.0 for co-simulation (§3 there); values are got and set as in FMI 2.0.

    There is no Initialization Mode: parameters and start values are set before
    ``fmiInitializeSlave``, and only inputs after it.
    """

    VERSION = "1.0"
    TYPES: ClassVar[Mapping[str, Any]] = {**Instance2.TYPES, "Boolean": c.c_bool}

    #: Functions that make, end and free an instance, without prefix.
    LIFE: ClassVar[tuple[str, str, str]] = (
        "InstantiateSlave",
        "TerminateSlave",
        "FreeSlaveInstance",
    )

    def __init__(self, setup: Setup, log: fmu_log.Log) -> None:
        self._calls = calls = Calls(setup, f"{setup.path.stem}_fmi", log)
        self.log, self.next_event, self._ended = calls.log, NEVER, False
        engine, libc = shared.library(), c.CDLL(None)
        callbacks = [shared.address(f) for f in (engine.engine_log1, libc.calloc, libc.free)]
        arguments, name = self._arguments(setup, callbacks), self.LIFE[0]
        instantiate = calls.function(name, *map(type, arguments), result=c.c_void_p)
        self.handle: int = instantiate(*arguments)
        if not self.handle:
            raise FmuError(f"{setup.name}: fmi{name} failed: {self.log.said()}")

    def _arguments(self, setup: Setup, callbacks: Sequence[int]) -> list[Any]:
        texts = (setup.name, setup.token, setup.resources.parent.as_uri(), "application/x-fmu")
        return [
            *(c.c_char_p(text.encode()) for text in texts), c.c_double(0.0), c.c_bool(False),
            c.c_bool(False), _Callbacks1(*callbacks), c.c_bool(setup.logging),
        ]  # fmt: skip

    def native(self, verb: str, kind: str = "") -> NativeCall | None:
        """The C calls that get and set values; None: the other calls are Python's."""
        return super().native(verb, kind) if verb in ("get", "set") else None

    def setup(self, t0: float) -> None:
        """Do nothing: the start time, s, comes with the initialization."""

    def enter_initialization(self, t0: float) -> None:
        """``fmiInitializeSlave`` at `t0`, s, with no stop time."""
        types = (c.c_void_p, c.c_double, c.c_bool, c.c_double)
        self._calls.checked("InitializeSlave", *types)(self.handle, t0, False, 0.0)
        self._calls.started = True

    def exit_initialization(self, clocks: Clocks | None = None) -> dict[str, list[float]]:
        """Do nothing; no values of clocked variables, in any unit."""
        return {}

    def terminated(self) -> float | None:
        """FMI 1.0 has no wish to end the simulation: None, no time in s."""
        return None

    def do_step(self, t: float, h: float) -> None:
        """``fmiDoStep`` from `t` over `h`, s; each step is a new one."""
        types = (c.c_void_p, c.c_double, c.c_double, c.c_bool)
        self._calls.checked("DoStep", *types)(self.handle, t, h, True)

    def free(self) -> None:
        """End and free the instance by the functions of `LIFE`, as far as they may be called."""
        if not self.handle:
            return
        calls, (_, end, free) = self._calls, self.LIFE
        if calls.started and not calls.broken:
            calls.returned(calls.function(end, c.c_void_p)(self.handle))
        if calls.broken < FATAL:
            calls.function(free, c.c_void_p, result=None)(self.handle)
        self.handle = 0


class ModelInstance1(Instance1):
    """A model of FMI 1.0 for model exchange: there are no modes, and events are one function."""

    LIFE = ("InstantiateModel", "Terminate", "FreeModelInstance")

    def __init__(self, setup: Setup, log: fmu_log.Log) -> None:
        super().__init__(setup, log)
        self._tolerance, self._info = setup.tolerance, _EventInfo1()

    def _arguments(self, setup: Setup, callbacks: Sequence[int]) -> list[Any]:
        return [
            *(c.c_char_p(text.encode()) for text in (setup.name, setup.token)),
            _ModelCallbacks1(*callbacks),
            c.c_bool(setup.logging),
        ]

    def enter_initialization(self, t0: float) -> None:
        """``fmiSetTime`` and ``fmiInitialize`` at `t0`, s."""
        self._calls.checked("SetTime", c.c_void_p, c.c_double)(self.handle, t0)
        tolerance = self._tolerance
        types = (c.c_void_p, c.c_bool, c.c_double, c.c_void_p)
        self._calls.checked("Initialize", *types)(
            self.handle, tolerance is not None, tolerance or 0.0, c.byref(self._info)
        )
        self._calls.started = True

    def exit_initialization(self, clocks: Clocks | None = None) -> dict[str, list[float]]:
        """Do the events at the start; no values of clocked variables, in any unit.

        Raises FmuError if they do not end.
        """
        update = self._calls.checked("EventUpdate", c.c_void_p, c.c_bool, c.c_void_p)
        info, rounds = self._info, 0
        while not ord(info.converged) and not ord(info.terminate):
            update(self.handle, False, c.byref(info))
            rounds += 1
            if rounds == EVENTS_AT_MOST:
                raise FmuError(f"{self._calls.name}: its discrete states do not converge")
        self._ended = bool(ord(info.terminate))
        self.next_event = info.next if ord(info.defined) else NEVER
        return {}
