"""The functions of an FMI 3.0 library through ctypes: the cold calls, and the hot addresses."""

from __future__ import annotations

import ctypes as c
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from cosim.base.errors import FmuError
from cosim.fmi.alike import CommonInstance
from cosim.fmi.clock_start import Ticking, intervals, set_intervals
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
    "setup": NativeCall(Form.NOTHING),
    "enter_configuration": NativeCall(Form.MODE, "EnterConfigurationMode"),
    "exit_configuration": NativeCall(Form.MODE, "ExitConfigurationMode"),
    "enter_initialization": NativeCall(Form.ENTER3, "EnterInitializationMode"),
    "exit_initialization": NativeCall(Form.MODE, "ExitInitializationMode"),
}
TYPES: Mapping[str, Any] = {
    "Float64": c.c_double, "Float32": c.c_float, "Boolean": c.c_bool,
    "Int8": c.c_int8, "Int16": c.c_int16, "Int32": c.c_int32, "Int64": c.c_int64,
    "UInt8": c.c_uint8, "UInt16": c.c_uint16, "UInt32": c.c_uint32, "UInt64": c.c_uint64,
    "Enumeration": c.c_int64,
}  # fmt: skip


class Instance3(CommonInstance):
    """An instance of an FMI 3.0 FMU, for any of the three interfaces."""

    STATE, READ = "FMUState", "Deserialize"
    HOT = ("SetFloat64", "DoStep", "GetFloat64")
    ENUMERATION = "Int64"

    def __init__(self, setup: Setup, log: fmu_log.Log) -> None:
        self._calls = calls = Calls(setup, "fmi3", log)
        self.log = calls.log
        self._event_mode, self.next_event, self._ended = setup.event_mode, NEVER, False
        self._tolerance, self._exchange = setup.tolerance, setup.interface == "ModelExchange"
        self._scheduled = setup.interface == "ScheduledExecution"
        engine, what = shared.library(), f"Instantiate{setup.interface}"
        settings: list[Any] = [c.c_bool(False), c.c_bool(setup.logging)]
        after: list[Any] = [
            c.c_void_p(c.addressof(self.log)),
            c.c_void_p(shared.address(engine.engine_log3)),
        ]
        if setup.interface == "CoSimulation":
            settings += [c.c_bool(setup.event_mode), c.c_bool(setup.early_return)]
            asked = setup.intermediate or ()
            settings += [c.c_void_p(), c.c_size_t(len(asked))]
            if asked:
                settings[-2] = c.cast(uint32(asked), c.c_void_p)
            update = shared.address(engine.engine_intermediate)
            after.append(c.c_void_p(None if setup.intermediate is None else update))
        elif setup.interface == "ScheduledExecution":
            calls_back = (engine.engine_clock_update, engine.engine_lock, engine.engine_lock)
            after += [c.c_void_p(shared.address(f)) for f in calls_back]
        texts = (setup.name, setup.token, str(setup.resources) + "/")
        arguments = [*(c.c_char_p(text.encode()) for text in texts), *settings, *after]
        instantiate = calls.function(what, *map(type, arguments), result=c.c_void_p)
        self.handle: int = instantiate(*arguments)
        self._ticking = Ticking(calls, self.handle, Clocks())
        if not self.handle:
            raise FmuError(f"{setup.name}: fmi3{what} failed: {self.log.said()}")

    @property
    def calls(self) -> Calls:
        """Its functions, for uses that this class does not know."""
        return self._calls

    def native(self, verb: str, kind: str = "") -> NativeCall | None:
        """The C call that does the same as a member of this, for an FMI type; None: none."""
        if verb in ("get", "set"):
            return NativeCall(Form.VALUES3, self._suffix(verb, kind), TYPES[kind])
        if verb == "exit_initialization" and (self._event_mode or self._scheduled):
            return None
        return _NATIVE.get(verb)

    def setup(self, t0: float) -> None:
        """Do nothing: FMI 3.0 is given `t0`, s, when it enters Initialization Mode."""

    def enter_initialization(self, t0: float) -> None:
        """Enter Initialization Mode at `t0` s with the tolerance (§2.3.2 of FMI 3.0.2)."""
        enter = self._calls.checked(
            "EnterInitializationMode",
            *(c.c_void_p, c.c_bool, c.c_double, c.c_double, c.c_bool, c.c_double),
        )
        tolerance = self._tolerance
        enter(self.handle, tolerance is not None, tolerance or 0.0, t0, False, 0.0)

    def intervals(self, clocks: Mapping[int, bool]) -> dict[int, Interval]:
        """Interval and shift of periodic clocks, true: by ``fmi3GetIntervalFraction``."""
        return intervals(self._calls, self.handle, clocks)

    def set_intervals(self, given: Intervals) -> None:
        """Set intervals: ``fmi3SetIntervalDecimal``, ``fmi3SetIntervalFraction``."""
        set_intervals(self._calls, self.handle, given)

    def exit_initialization(self, clocks: Clocks | None = None) -> dict[str, list[float]]:
        """Leave Initialization Mode, and the Event Mode that follows if it is used.

        Returns the values of clocked variables that ticked then, by name, in the FMU's units.
        """
        asked = clocks or Clocks()
        self._ticking = ticking = Ticking(self._calls, self.handle, asked)
        ticking.ask((*asked.changing, *asked.countdown))
        self._calls.checked("ExitInitializationMode", c.c_void_p)(self.handle)
        self._calls.started = True
        if self._event_mode:
            self._leave_event_mode(
                lambda: ticking.instant(self.get, self.get_texts),
                lambda: ticking.ask(asked.countdown),
            )
        return ticking.values

    def has_ended(self) -> bool:
        """True if it ended the simulation in Event Mode."""
        return self._ended

    def terminated(self) -> float | None:
        """The end of the FMU, s: None, as ``fmi3DoStep`` of FMI 3.0 returns it itself."""
        return None

    @property
    def next_ticks(self) -> Mapping[int, NextTick]:
        """The next ticks of clocks that are changing or count down."""
        return self._ticking.next

    def clocked_texts(self) -> dict[str, list[str]]:
        """Texts of clocks as they were when these last ticked."""
        return self._ticking.texts

    def set_clocked_texts(self, found: dict[str, list[str]]) -> None:
        """Go back to the texts of clocks at an earlier time."""
        self._ticking.texts.update(found)

    def take_texts(self, found: Clocked) -> None:
        """Get such a text, now that its clock ticks."""
        self._ticking.texts[found.name] = self.get_texts(found.type, found.references, found.count)

    def _leave_event_mode(
        self, instant: Callable[[], None] = lambda: None, after: Callable[[], None] = lambda: None
    ) -> None:
        """Instants until nothing changes; `instant` is called in each, `after` after its update."""
        update = self._calls.checked("UpdateDiscreteStates", *(c.c_void_p,) * 7)
        again, stop, nominals, values, defined = (c.c_bool() for _ in range(5))
        time = c.c_double()
        flags = [c.byref(f) for f in (again, stop, nominals, values, defined)]
        for _ in range(EVENTS_AT_MOST):
            again.value = False
            instant()
            update(self.handle, *flags, c.byref(time))
            if stop.value:
                self._ended = True
                return
            after()
            if not again.value:
                break
        else:
            raise FmuError(f"{self._calls.name}: its discrete states do not converge")
        self.next_event = time.value if defined.value else NEVER
        mode = "EnterContinuousTimeMode" if self._exchange else "EnterStepMode"
        self._calls.checked(mode, c.c_void_p)(self.handle)

    def _access(self, verb: str, kind: str) -> Callable[..., None]:
        return self._calls.checked(
            self._suffix(verb, kind),
            *(c.c_void_p, c.c_void_p, c.c_size_t, c.c_void_p, c.c_size_t),
        )

    def get(self, kind: str, references: Sequence[int], count: int) -> list[float]:
        """Values, in the FMU's units, by ``fmi3GetFloat64`` or the function of another type."""
        values = (TYPES[kind] * count)()
        get = self._access("Get", kind)
        get(self.handle, uint32(references), len(references), values, count)
        return [float(v) for v in values]

    def set(self, kind: str, references: Sequence[int], values: Sequence[float]) -> None:
        """Set values, in the FMU's units, by ``fmi3SetFloat64`` or the function of another type."""
        convert = float if kind.startswith("Float") else int
        array = array_of(TYPES[kind], [convert(v) for v in values])
        set_ = self._access("Set", kind)
        set_(self.handle, uint32(references), len(references), array, len(values))

    def get_texts(self, kind: str, references: Sequence[int], count: int) -> list[str]:
        """``fmi3GetString``; ``fmi3GetBinary`` as hexadecimal text."""
        if kind == "Binary":
            return self._get_binary(references, count)
        values = (c.c_char_p * count)()
        get = self._access("Get", "String")
        get(self.handle, uint32(references), len(references), values, count)
        return texts_of(values)

    def _get_binary(self, references: Sequence[int], count: int) -> list[str]:
        sizes, values = (c.c_size_t * count)(), (c.c_void_p * count)()
        get = self._calls.checked(
            "GetBinary", c.c_void_p, c.c_void_p, c.c_size_t, c.c_void_p, c.c_void_p, c.c_size_t
        )
        get(self.handle, uint32(references), len(references), sizes, values, count)
        return [c.string_at(v, n).hex() if v else "" for v, n in zip(values, sizes, strict=True)]

    def set_texts(self, kind: str, references: Sequence[int], values: Sequence[str]) -> None:
        """``fmi3SetString``; ``fmi3SetBinary`` from hexadecimal text.

        Raises FmuError if a binary value is not hexadecimal text.
        """
        n, count = len(references), len(values)
        if kind == "Binary":
            try:
                raw = [bytes.fromhex(v) for v in values]
            except ValueError:
                raise FmuError(
                    f"{self._calls.name}: {values} is no binary value; expected hexadecimal text"
                ) from None
            sizes = array_of(c.c_size_t, [len(v) for v in raw])
            set_ = self._calls.checked(
                "SetBinary", c.c_void_p, c.c_void_p, c.c_size_t, c.c_void_p, c.c_void_p, c.c_size_t
            )
            set_(self.handle, uint32(references), n, sizes, array_of(c.c_char_p, raw), count)
            return
        array = array_of(c.c_char_p, [v.encode() for v in values])
        self._access("Set", "String")(self.handle, uint32(references), n, array, count)

    def enter_configuration(self) -> None:
        """Enter Configuration Mode, to set structural parameters (§2.3.3 of FMI 3.0.2)."""
        self._calls.checked("EnterConfigurationMode", c.c_void_p)(self.handle)

    def exit_configuration(self) -> None:
        """Leave Configuration Mode (§2.3.3 of FMI 3.0.2)."""
        self._calls.checked("ExitConfigurationMode", c.c_void_p)(self.handle)

    def address(self, suffix: str) -> int:
        """The address of ``fmi3<suffix>``. Raises FmuError where the binary lacks it."""
        return shared.address(self._calls.function(suffix))

    def do_step(self, t: float, h: float) -> None:
        """``fmi3DoStep`` from `t` over `h`, s, and the Event Mode that it may ask for.

        Raises FmuError if the FMU returns early: only the engine can continue such a step.
        """
        step = self._calls.checked(
            "DoStep",
            *(c.c_void_p, c.c_double, c.c_double, c.c_bool),
            *(c.c_void_p, c.c_void_p, c.c_void_p, c.c_void_p),
        )
        flags = [c.c_bool() for _ in range(3)]
        reached = c.c_double()
        step(self.handle, t, h, False, *(c.byref(f) for f in flags), c.byref(reached))
        event, ended, early = (flag.value for flag in flags)
        self._ended = ended
        if early and not ended:
            raise FmuError(
                f"{self._calls.name}: returned early; only the engine can continue such a step"
            )
        if event and self._event_mode and not ended:
            self._calls.checked("EnterEventMode", c.c_void_p)(self.handle)
            self._leave_event_mode()
