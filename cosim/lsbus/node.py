"""An FMU with a CAN terminal as a node of a bus: its steps, its events, and what it sends."""

from __future__ import annotations

import ctypes as c
from typing import Any, NamedTuple, final

import numpy as np

from cosim.base.component import Values
from cosim.base.errors import FmuError
from cosim.fmi.component import FmuComponent
from cosim.fmi.file import intervals
from cosim.fmi.fmi3 import Instance3
from cosim.fmi.library import uint32
from cosim.fmi.start_values import StartValue
from cosim.lsbus.signals import NodeSignals, flat
from cosim.lsbus.terminals import terminal_of

PS = 1e-12
_NEVER = 1 << 62
_CHANGED = 2
_INSTANTS = 100_000
_REFERENCES = (c.c_void_p, c.c_void_p, c.c_size_t)


class StepEnd(NamedTuple):
    """The answer of an FMU at the end of a step."""

    event: bool
    ended: bool


@final
class NodeFmu:
    """One FMU of FMI 3.0 with one CAN terminal, which `terminal` names ("": the only one).

    `values`: parameters and start values by name, as of :class:`FmuComponent`. `BusNotifications`
    is set to true where the FMU has it and `values` do not say otherwise. Raises FmuError for an
    FMU without event mode, one that cannot handle steps of any length, one with clocks besides
    those of its terminal, and as FmuComponent does.
    """

    def __init__(self, fmu: FmuComponent, terminal: str = "", values: Values | None = None) -> None:
        self.fmu, self.name = fmu, fmu.name
        name = fmu.name
        flag = "canHandleVariableCommunicationStepSize"
        for found, what in (
            (self.fmu.events, "hasEventMode"),
            (self.fmu.description.flags.get(flag), flag),
        ):
            if not found:
                raise FmuError(
                    f"{name}: found an FMU without {what}, expected one with it: bus"
                    " operations are exchanged in events at any time"
                )
        if self.fmu.options.isolate:
            raise FmuError(f"{name}: found isolate = true, expected an FMU on a bus without it")
        self.terminal = terminal_of(self.fmu, terminal)
        self.signals = NodeSignals(self.fmu, self.terminal)
        self.set_values(values or {})
        self._variability = self.terminal.tx_clock.attributes["intervalVariability"]
        self._tick_ps = self._event_ps = _NEVER
        self._period_ps = 0
        self._now_ps = 0

    @property
    def next_ps(self) -> int:
        """The next time at which it wants Event Mode: its Tx clock or a time event, ps."""
        return min(self._tick_ps, self._event_ps)

    def set_values(self, values: Values) -> None:
        """Parameters and start values for the next :meth:`initialize`, which replace the others."""
        self.values = dict(values)
        asked = self.terminal.notifications
        if asked is not None:
            self.values.setdefault(asked.name, np.array(1.0))
        #: Whether it takes Confirm, Arbitration Lost and Bus Error.
        self.notified = asked is not None and bool(self.values[asked.name])

    def initialize(self) -> None:
        """Enter Initialization Mode at time 0. Raises FmuError."""
        self.fmu.initialize(self.values)
        self._tick_ps = self._event_ps = _NEVER
        self._period_ps = self._now_ps = 0

    def start(self) -> list[bytes]:
        """Leave Initialization Mode; returns what it sends in the Event Mode that follows."""
        instance = self.fmu.instance
        assert isinstance(instance, Instance3)
        self._calls, self._handle = instance.calls, instance.handle
        self._first_tick(instance)
        self._call("ExitInitializationMode")
        self._calls.started = True
        sent = self._instants([])
        self._check_values()
        return sent

    def step(self, until_ps: int) -> StepEnd:
        """``fmi3DoStep`` from where it is to `until_ps`. Raises FmuError for an early return."""
        t = self._now_ps * PS
        flags, reached = [c.c_bool() for _ in range(3)], c.c_double()
        step = self._calls.checked(
            "DoStep", c.c_void_p, c.c_double, c.c_double, c.c_bool, *(c.c_void_p,) * 4
        )
        step(self._handle, t, until_ps * PS - t, False, *map(c.byref, flags), c.byref(reached))
        event, ended, early = (bool(f.value) for f in flags)
        if early and not ended:
            raise FmuError(
                f"{self.name}: found an early return at {reached.value:.9g} s, expected a step to"
                f" {until_ps * PS:.9g} s: a node of a bus announces its events by its clocks"
            )
        self._now_ps = until_ps
        return StepEnd(event, ended)

    def event(self, received: bytes) -> list[bytes]:
        """Enter Event Mode, hand over operations (b"": none), and return what is sent in it."""
        self._call("EnterEventMode")
        return self._instants([received] if received else [])

    def close(self) -> None:
        """Free the FMU; may be called twice."""
        self.fmu.close()

    # ---- Event Mode --------------------------------------------------------------------------

    def _instants(self, received: list[bytes]) -> list[bytes]:
        """Instants until nothing changes, then Step Mode; what was sent in each."""
        sent: list[bytes] = []
        self.signals.set_jumps()
        for _ in range(_INSTANTS):
            if received:
                self._set_clock(self.terminal.rx_clock.reference)
                self._set_rx(received.pop())
            sent += filter(None, [self._tx()])
            again = self._update()
            self._ask()
            if not again and self.next_ps > self._now_ps:
                self._call("EnterStepMode")
                return sent
        raise FmuError(
            f"{self.name}: found {_INSTANTS} instants of one Event Mode at {self._now_ps * PS:g} s,"
            " expected an end"
        )

    def _tx(self) -> bytes:
        """The operations that it sends in this instant, if its Tx clock ticks."""
        reference = self.terminal.tx_clock.reference
        if self._variability == "triggered":
            ticks = c.c_bool()
            get = self._calls.checked("GetClock", *_REFERENCES, c.c_void_p)
            get(self._handle, uint32([reference]), 1, c.byref(ticks))
            return self._get_tx() if ticks.value else b""
        if self._tick_ps > self._now_ps:
            return b""
        self._set_clock(reference)
        self._tick_ps = self._tick_ps + self._period_ps if self._period_ps else _NEVER
        self._ticked = True
        return self._get_tx()

    def _update(self) -> bool:
        """``fmi3UpdateDiscreteStates``; whether it wants another instant."""
        flags, time = [c.c_bool() for _ in range(5)], c.c_double()
        update = self._calls.checked("UpdateDiscreteStates", *(c.c_void_p,) * 7)
        update(self._handle, *map(c.byref, flags), c.byref(time))
        if flags[1].value:
            raise FmuError(
                f"{self.name}: ended the simulation in an event at {self._now_ps * PS:.9g} s,"
                " expected it to do so in a step"
            )
        self._event_ps = round(time.value / PS) if flags[4].value else _NEVER
        if self._event_ps <= self._now_ps:
            self._event_ps = _NEVER
            return True
        return bool(flags[0].value)

    def _ask(self) -> None:
        """Ask for the next tick of clocks that count down, and of changed ones that ticked."""
        ticked, self._ticked = self._ticked, False
        if self._variability == "countdown" or (self._variability == "changing" and ticked):
            interval, qualifier = self._interval()
            if qualifier == _CHANGED:
                self._tick_ps = self._now_ps + self._in_ps(interval)
            elif self._variability == "changing":
                raise FmuError(f"{self.name}: Tx_Clock ticked, and no interval follows")

    def _first_tick(self, instance: Instance3) -> None:
        """Ask for the first tick of periodic or changing clocks; in Initialization Mode."""
        clock, self._ticked = self.terminal.tx_clock, False
        if self._variability == "changing":
            self._tick_ps = self._in_ps(self._interval()[0])
        elif self._variability in ("constant", "fixed", "tunable"):
            if {"intervalDecimal", "intervalCounter"} & clock.attributes.keys():
                found = intervals.written(clock, self.name)
            else:
                asked = {clock.reference: intervals.has_fractions(clock)}
                found = instance.intervals(asked)[clock.reference]
            self._period_ps = self._in_ps(found.seconds)
            self._tick_ps = self._in_ps(found.shift_seconds)
            if self._period_ps < 1:
                said = f"{found.seconds:g} s"
                raise FmuError(f"{self.name}: Tx_Clock has the interval {said}, expected > 0")

    # ---- calls -------------------------------------------------------------------------------

    def _call(self, function: str) -> None:
        self._calls.checked(function, c.c_void_p)(self._handle)

    def _set_clock(self, reference: int) -> None:
        set_ = self._calls.checked("SetClock", *_REFERENCES, c.c_void_p)
        set_(self._handle, uint32([reference]), 1, c.byref(c.c_bool(True)))

    def _set_rx(self, buffer: bytes) -> None:
        set_ = self._binary("SetBinary")
        text, size = c.c_char_p(buffer), c.c_size_t(len(buffer))
        reference = uint32([self.terminal.rx_data.reference])
        set_(self._handle, reference, 1, c.byref(size), c.byref(text), 1)

    def _get_tx(self) -> bytes:
        value, size = c.c_void_p(), c.c_size_t()
        reference = uint32([self.terminal.tx_data.reference])
        self._binary("GetBinary")(self._handle, reference, 1, c.byref(size), c.byref(value), 1)
        return c.string_at(value, size.value) if value.value else b""

    def _binary(self, function: str) -> Any:
        return self._calls.checked(function, *_REFERENCES, c.c_void_p, c.c_void_p, c.c_size_t)

    def _interval(self) -> tuple[float, int]:
        found, qualifier = c.c_double(), c.c_int()
        get = self._calls.checked("GetIntervalDecimal", *_REFERENCES, c.c_void_p, c.c_void_p)
        reference = uint32([self.terminal.tx_clock.reference])
        get(self._handle, reference, 1, c.byref(found), c.byref(qualifier))
        return found.value, qualifier.value

    def _in_ps(self, seconds: float) -> int:
        if not 0.0 <= seconds < 1e6:
            raise FmuError(f"{self.name}: Tx_Clock has the interval {seconds:g} s, expected >= 0 s")
        return round(seconds / PS)

    def _check_values(self) -> None:
        """Raises FmuError for parameters that the FMU did not take."""
        for key, value in self.values.items():
            group = self.fmu.groups[key]
            wanted = flat(value)
            found = StartValue(group, wanted).differs(self.fmu.instance)
            if group.first.causality == "parameter" and found is not None:
                raise FmuError(f"{self.name}: {key} was set to {wanted}, found {list(found)}")
