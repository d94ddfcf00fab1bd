"""The FMI functions of a shared library through ctypes: the cold calls, and the hot addresses.

One class a standard, :class:`Instance2` (FMI 2.0.5) and :class:`Instance3` (FMI 3.0.2), with the
same members; which one an FMU needs is decided once, in :func:`instantiate`.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from cosim import native
from cosim.errors import FmuError

_STATUS = {0: "OK", 1: "warning", 2: "discard", 3: "error", 4: "fatal", 5: "pending"}


class Instance(Protocol):
    """One instance of an FMU, FMI 2.0 or 3.0."""

    log: native.Log
    handle: int

    def enter_initialization(self, t0: float) -> None:
        """Set up the experiment from `t0` (s), without a stop time, and enter initialisation."""

    def exit_initialization(self) -> None:
        """Leave Initialization Mode for Step Mode."""

    def get(self, kind: str, references: Sequence[int], count: int) -> list[float]:
        """Values of variables of an FMI type, `count` scalars in all."""

    def set(self, kind: str, references: Sequence[int], values: Sequence[float]) -> None:
        """Set variables of an FMI type, all scalars in order."""

    def do_step(self, t: float, h: float) -> None:
        """One communication step."""

    def get_state(self) -> int:
        """Save the state; returns the handle of it."""

    def set_state(self, state: int) -> None:
        """Go back to a saved state."""

    def free_state(self, state: int) -> None:
        """Give a saved state back."""

    def free(self) -> None:
        """Terminate and free the instance; may be called twice."""

    def hot(self) -> tuple[int, int, int]:
        """Addresses of the functions that set, step and get in the loop."""


_TYPES2: Mapping[str, Any] = {
    "Real": c.c_double, "Integer": c.c_int, "Boolean": c.c_int, "Enumeration": c.c_int,
}  # fmt: skip
_TYPES3: Mapping[str, Any] = {
    "Float64": c.c_double, "Float32": c.c_float, "Boolean": c.c_bool,
    "Int8": c.c_int8, "Int16": c.c_int16, "Int32": c.c_int32, "Int64": c.c_int64,
    "UInt8": c.c_uint8, "UInt16": c.c_uint16, "UInt32": c.c_uint32, "UInt64": c.c_uint64,
    "Enumeration": c.c_int64,
}  # fmt: skip


class _Calls:
    """A library's functions, each checked: absent ones and bad statuses become FmuError."""

    def __init__(self, path: Path, prefix: str, name: str) -> None:
        try:
            self.library = c.CDLL(str(path))
        except OSError as error:
            raise FmuError(f"{name}: cannot load {path.name}: {error}") from error
        self.prefix, self.name, self.log = prefix, name, native.Log()

    def function(self, suffix: str, *types: Any, result: Any = c.c_int) -> Any:
        try:
            function = getattr(self.library, self.prefix + suffix)
        except AttributeError:
            raise FmuError(f"{self.name}: the binary lacks {self.prefix}{suffix}") from None
        function.argtypes, function.restype = types, result
        return function

    def checked(self, suffix: str, *types: Any) -> Callable[..., None]:
        function = self.function(suffix, *types)

        def call(*arguments: Any) -> None:
            status = function(*arguments)
            if status > 1:
                lines = "; ".join(self.log.tail()) or "the FMU logged nothing"
                meaning = _STATUS.get(status, str(status))
                raise FmuError(f"{self.name}: {self.prefix}{suffix} returned {meaning}: {lines}")

        return call


def _uint32(values: Sequence[int]) -> Any:
    return (c.c_uint32 * len(values))(*values)


class _Callbacks2(c.Structure):
    _fields_ = (
        ("logger", c.c_void_p),
        ("allocate", c.c_void_p),
        ("free", c.c_void_p),
        ("finished", c.c_void_p),
        ("environment", c.c_void_p),
    )


class Instance2:
    """An instance of an FMI 2.0 co-simulation FMU."""

    def __init__(self, path: Path, name: str, token: str, resources: Path) -> None:
        self._calls = calls = _Calls(path, "fmi2", name)
        self.log = calls.log
        libc = c.CDLL(None)
        self._callbacks = _Callbacks2(
            native.address(native.library().engine_log2),
            native.address(libc.calloc),
            native.address(libc.free),
            None,
            c.addressof(self.log),
        )
        instantiate = calls.function(
            "Instantiate",
            *(c.c_char_p, c.c_int, c.c_char_p, c.c_char_p, c.c_void_p, c.c_int, c.c_int),
            result=c.c_void_p,
        )
        self.handle: int = instantiate(
            name.encode(), 1, token.encode(), resources.as_uri().encode(),
            c.byref(self._callbacks), 0, 0,
        )  # fmt: skip
        if not self.handle:
            raise FmuError(f"{name}: fmi2Instantiate failed: {'; '.join(self.log.tail())}")

    def enter_initialization(self, t0: float) -> None:
        """Set up the experiment (§2.1.6 of FMI 2.0.5) and enter Initialization Mode."""
        setup = self._calls.checked(
            "SetupExperiment", c.c_void_p, c.c_int, c.c_double, c.c_double, c.c_int, c.c_double
        )
        setup(self.handle, 0, 0.0, t0, 0, 0.0)
        self._calls.checked("EnterInitializationMode", c.c_void_p)(self.handle)

    def exit_initialization(self) -> None:
        """Leave Initialization Mode."""
        self._calls.checked("ExitInitializationMode", c.c_void_p)(self.handle)

    def _access(self, verb: str, kind: str) -> Callable[..., None]:
        suffix = "Integer" if kind == "Enumeration" else kind
        return self._calls.checked(verb + suffix, c.c_void_p, c.c_void_p, c.c_size_t, c.c_void_p)

    def get(self, kind: str, references: Sequence[int], count: int) -> list[float]:
        """``fmi2GetReal`` and its sisters."""
        values = (_TYPES2[kind] * count)()
        self._access("Get", kind)(self.handle, _uint32(references), len(references), values)
        return [float(v) for v in values]

    def set(self, kind: str, references: Sequence[int], values: Sequence[float]) -> None:
        """``fmi2SetReal`` and its sisters."""
        convert = float if kind == "Real" else int
        array = (_TYPES2[kind] * len(values))(*(convert(v) for v in values))
        self._access("Set", kind)(self.handle, _uint32(references), len(references), array)

    def do_step(self, t: float, h: float) -> None:
        """``fmi2DoStep``."""
        step = self._calls.checked("DoStep", c.c_void_p, c.c_double, c.c_double, c.c_int)
        step(self.handle, t, h, 0)

    def get_state(self) -> int:
        """``fmi2GetFMUstate``."""
        state = c.c_void_p()
        self._calls.checked("GetFMUstate", c.c_void_p, c.c_void_p)(self.handle, c.byref(state))
        return state.value or 0

    def set_state(self, state: int) -> None:
        """``fmi2SetFMUstate``."""
        self._calls.checked("SetFMUstate", c.c_void_p, c.c_void_p)(self.handle, state)

    def free_state(self, state: int) -> None:
        """``fmi2FreeFMUstate``."""
        free = self._calls.checked("FreeFMUstate", c.c_void_p, c.c_void_p)
        free(self.handle, c.byref(c.c_void_p(state)))

    def free(self) -> None:
        """``fmi2Terminate`` (its status does not matter any more) and ``fmi2FreeInstance``."""
        if self.handle:
            self._calls.function("Terminate", c.c_void_p)(self.handle)
            self._calls.function("FreeInstance", c.c_void_p, result=None)(self.handle)
            self.handle = 0

    def hot(self) -> tuple[int, int, int]:
        """Addresses of ``fmi2SetReal``, ``fmi2DoStep``, ``fmi2GetReal``."""
        names = ("SetReal", "DoStep", "GetReal")
        set_, step, get = (native.address(self._calls.function(n)) for n in names)
        return set_, step, get


class Instance3:
    """An instance of an FMI 3.0 co-simulation FMU."""

    def __init__(self, path: Path, name: str, token: str, resources: Path) -> None:
        self._calls = calls = _Calls(path, "fmi3", name)
        self.log = calls.log
        instantiate = calls.function(
            "InstantiateCoSimulation",
            *(c.c_char_p, c.c_char_p, c.c_char_p, c.c_bool, c.c_bool, c.c_bool, c.c_bool),
            *(c.c_void_p, c.c_size_t, c.c_void_p, c.c_void_p, c.c_void_p),
            result=c.c_void_p,
        )
        self.handle: int = instantiate(
            name.encode(), token.encode(), (str(resources) + "/").encode(),
            False, False, False, False, None, 0,
            c.addressof(self.log), native.address(native.library().engine_log3), None,
        )  # fmt: skip
        if not self.handle:
            lines = "; ".join(self.log.tail())
            raise FmuError(f"{name}: fmi3InstantiateCoSimulation failed: {lines}")

    def enter_initialization(self, t0: float) -> None:
        """Enter Initialization Mode (§2.3.2 of FMI 3.0.2)."""
        enter = self._calls.checked(
            "EnterInitializationMode",
            *(c.c_void_p, c.c_bool, c.c_double, c.c_double, c.c_bool, c.c_double),
        )
        enter(self.handle, False, 0.0, t0, False, 0.0)

    def exit_initialization(self) -> None:
        """Leave Initialization Mode."""
        self._calls.checked("ExitInitializationMode", c.c_void_p)(self.handle)

    def _access(self, verb: str, kind: str) -> Callable[..., None]:
        suffix = "Int64" if kind == "Enumeration" else kind
        return self._calls.checked(
            verb + suffix, c.c_void_p, c.c_void_p, c.c_size_t, c.c_void_p, c.c_size_t
        )

    def get(self, kind: str, references: Sequence[int], count: int) -> list[float]:
        """``fmi3GetFloat64`` and its sisters."""
        values = (_TYPES3[kind] * count)()
        get = self._access("Get", kind)
        get(self.handle, _uint32(references), len(references), values, count)
        return [float(v) for v in values]

    def set(self, kind: str, references: Sequence[int], values: Sequence[float]) -> None:
        """``fmi3SetFloat64`` and its sisters."""
        convert = float if kind.startswith("Float") else int
        array = (_TYPES3[kind] * len(values))(*(convert(v) for v in values))
        set_ = self._access("Set", kind)
        set_(self.handle, _uint32(references), len(references), array, len(values))

    def do_step(self, t: float, h: float) -> None:
        """``fmi3DoStep``."""
        step = self._calls.checked(
            "DoStep",
            *(c.c_void_p, c.c_double, c.c_double, c.c_bool),
            *(c.c_void_p, c.c_void_p, c.c_void_p, c.c_void_p),
        )
        flags = [c.c_bool() for _ in range(3)]
        reached = c.c_double()
        step(self.handle, t, h, False, *(c.byref(f) for f in flags), c.byref(reached))

    def get_state(self) -> int:
        """``fmi3GetFMUState``."""
        state = c.c_void_p()
        self._calls.checked("GetFMUState", c.c_void_p, c.c_void_p)(self.handle, c.byref(state))
        return state.value or 0

    def set_state(self, state: int) -> None:
        """``fmi3SetFMUState``."""
        self._calls.checked("SetFMUState", c.c_void_p, c.c_void_p)(self.handle, state)

    def free_state(self, state: int) -> None:
        """``fmi3FreeFMUState``."""
        free = self._calls.checked("FreeFMUState", c.c_void_p, c.c_void_p)
        free(self.handle, c.byref(c.c_void_p(state)))

    def free(self) -> None:
        """``fmi3Terminate`` (its status does not matter any more) and ``fmi3FreeInstance``."""
        if self.handle:
            self._calls.function("Terminate", c.c_void_p)(self.handle)
            self._calls.function("FreeInstance", c.c_void_p, result=None)(self.handle)
            self.handle = 0

    def hot(self) -> tuple[int, int, int]:
        """Addresses of ``fmi3SetFloat64``, ``fmi3DoStep``, ``fmi3GetFloat64``."""
        names = ("SetFloat64", "DoStep", "GetFloat64")
        set_, step, get = (native.address(self._calls.function(n)) for n in names)
        return set_, step, get


def instantiate(fmi: str, path: Path, name: str, token: str, resources: Path) -> Instance:
    """An instance called `name` of the FMU whose binary is `path`. Raises FmuError."""
    kind = Instance2 if fmi == "2.0" else Instance3
    return kind(path, name, token, resources)
