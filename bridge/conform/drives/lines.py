"""A drive at the other end of a bus: on a CAN bus in real time, or emulated in simulated time."""

from __future__ import annotations

import ctypes as c
from typing import Protocol, final

from bridge.can.interface import CanBusSpec
from bridge.can.plain import PlainBus
from bridge.native.frame import Flags, Frame
from bridge.native.vendor import VendorKind, VendorStruct, functions
from cosim.base.clock import monotonic_ns

MS = 1_000_000
#: ns between two looks at an emulated drive; what it sends has its own times.
_STEP = 100_000


class JudgedLine(Protocol):
    """The bus of the judged drive. Times in ns, of one clock."""

    late_ns: int
    """The largest lateness of the kit since it was set to 0, ns."""

    def now(self) -> int:
        """The time."""

    def send(self, frame: Frame) -> None:
        """Send a frame now. Raises BusError."""

    def receive(self, until_ns: int) -> tuple[Frame, int] | None:
        """The next frame of another node and its time; None: it is `until_ns`. Raises BusError."""

    def close(self) -> None:
        """Leave the bus."""


@final
class CanDriveLine:
    """A bus of python-can, on the wall clock. Raises BusError if it cannot be opened."""

    def __init__(self, spec: CanBusSpec) -> None:
        self._bus = PlainBus(spec)
        self.late_ns = 0

    def now(self) -> int:
        """The time, CLOCK_MONOTONIC."""
        return monotonic_ns()

    def send(self, frame: Frame) -> None:
        """Send a frame. Raises BusError."""
        self._bus.send(frame)

    def receive(self, until_ns: int) -> tuple[Frame, int] | None:
        """The next frame, and when it came. Raises BusError."""
        while True:
            came = self._bus.receive(until_ns)
            if came is None:
                self.late_ns = max(self.late_ns, monotonic_ns() - until_ns)
                return None
            self.late_ns = max(self.late_ns, came.wake_ns)
            if not came.frame.flags & Flags.ERROR:
                return came.frame, came.t_ns

    def close(self) -> None:
        """Leave the bus."""
        self._bus.close()


#: The feedback of an emulated drive in the middle of its ranges: part, identifier of node 0, bytes.
_FEEDBACK = {
    VendorKind.DAMIAO: ((0, 0x010, bytes.fromhex("007fff7ff7ff1919")),),
    VendorKind.ODRIVE: ((0, 0x009, bytes(8)), (1, 0x01C, bytes(8))),
    VendorKind.CIA402: ((0, 0x180, bytes(8)), (1, 0x280, bytes(4))),
}
_ESTIMATES_NS, _BEAT_NS = 10 * MS, 100 * MS


@final
class EmulatedDriveLine:
    """The drive that rehearsals have for hardware, alone, in simulated time.

    `watchdog`: its time-out as a tool has set it, s.
    """

    def __init__(self, kind: VendorKind, node: int, watchdog: float) -> None:
        beats = 0 if kind == VendorKind.DAMIAO else _BEAT_NS
        self._v = VendorStruct(
            kind=kind, node=node, host=1 if kind == VendorKind.CIA402 else 0,
            timeout_ns=round(watchdog * 1e9), cycle_ns=MS, boot_ns=50 * MS, beat_ns=beats,
            p_max=12.5, v_max=30.0, t_max=10.0, rated=1.0,
        )  # fmt: skip
        self._kind, self._node, self._t = kind, node, 0
        self.late_ns = 0
        functions().vendor_init(c.byref(self._v), 0)

    def now(self) -> int:
        """The simulated time."""
        return self._t

    def send(self, frame: Frame) -> None:
        """Give it a frame."""
        functions().vendor_take(c.byref(self._v), c.byref(frame), self._t)

    def receive(self, until_ns: int) -> tuple[Frame, int] | None:
        """Let it go on until it sends something."""
        while True:
            self._say()
            frame = Frame()
            if functions().vendor_next(c.byref(self._v), self._t, c.byref(frame)):
                return frame, int(frame.t_ns)
            if self._t >= until_ns:
                return None
            before, self._t = self._t, min(until_ns, self._t + _STEP)
            cyclic = before // _ESTIMATES_NS != self._t // _ESTIMATES_NS
            if self._kind == VendorKind.ODRIVE and cyclic and self._v.network:
                self._v.owed[0] += 1
            functions().vendor_step(c.byref(self._v), self._t)

    def _say(self) -> None:
        for part, identifier, data in _FEEDBACK[self._kind]:
            step = 32 if self._kind == VendorKind.ODRIVE else 1
            frame = Frame.of(identifier + step * self._node, data)
            for _ in range(self._v.owed[part]):
                functions().vendor_say(c.byref(self._v), part, c.byref(frame), self._t)

    def close(self) -> None:
        """Nothing is open."""
