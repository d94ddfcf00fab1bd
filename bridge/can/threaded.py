"""A python-can bus between two threads and two rings, so that a tick never waits for it."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Callable, Sequence
from typing import final

import can

from bridge.can.health import BusHealth, bus_health
from bridge.can.multicast import MulticastBus
from bridge.native import pace
from bridge.native.bus import Accept, Bus, BusState
from bridge.native.frame import Flags, Frame, Ring
from bridge.native.journal import Journal
from cosim.base.clock import stopwatch
from cosim.base.copies import replace

_LOOK = 0.1
"""s between two looks at whether to stop."""
_PATIENCE = 0.1
"""s a driver may take to accept a frame."""
_CLOSING = 2.0
"""s that what waits may take when the bus is closed: alone on a bus, no frame is acknowledged."""


@final
class RingedInterface:
    """Two threads around `device`, which is theirs from now on."""

    def __init__(
        self, device: can.BusABC, number: int, log: Journal | None,
        accepts: Sequence[Accept] | None, capacity: int,
    ) -> None:  # fmt: skip
        self._device = device
        self._rx, self._tx = Ring(capacity), Ring(capacity)
        self._stop = threading.Event()
        self._wake_out, self._wake_in = _descriptors()
        self.bus = Bus.from_rings(
            self._rx, self._tx, number, log, wake=self._wake_in, accepts=accepts
        )
        self._refused, self._fault, self._down = 0, "", False
        self._closing: Callable[[], float] | None = None  # s since the bus was closed
        self._threads = [
            threading.Thread(target=work, name=f"can {name} {number}", daemon=True)
            for name, work in (("receive", self._receive), ("send", self._send))
        ]
        for thread in self._threads:
            thread.start()

    def health(self, name: str, now_ns: int) -> BusHealth:
        """Health with the number of frames that the driver refused, and its last message."""
        health = bus_health(self.bus, name, now_ns)
        failed = health.send_failed + self._refused
        return replace(health, send_failed=failed, last_error=self._fault or health.last_error)

    def close(self) -> None:
        """Send what waits as far as 2 s suffice, end the threads, shut the bus down.

        What is not sent then counts as refused.
        """
        if self._stop.is_set():
            return
        self._closing = stopwatch()
        self._stop.set()
        os.write(self._wake_in, (1).to_bytes(8, sys.byteorder))
        for thread in self._threads:
            thread.join()
        self.bus.struct.fd = -1
        for descriptor in {self._wake_out, self._wake_in}:
            os.close(descriptor)
        self._device.shutdown()

    def _receive(self) -> None:
        """Frames that arrive, into the ring; what the kernel dropped counts as not fitting."""
        lost = 0
        while not self._stop.is_set():
            try:
                message = self._device.recv(timeout=_LOOK)
            except (can.CanError, OSError, ValueError) as error:
                self._failed(error)
                self._stop.wait(_LOOK)
                continue
            self._works()
            if isinstance(self._device, MulticastBus) and self._device.lost != lost:
                self._rx.struct.dropped += self._device.lost - lost
                lost = self._device.lost
            if message is not None:
                self._rx.put(to_frame(message, pace.now()))

    def _send(self) -> None:
        """Frames of the ring, to the device; sleeps until `bus_send` writes to the descriptor."""
        frame = Frame()
        while True:
            os.read(self._wake_out, 65536)
            last = self._stop.is_set()  # what was sent before it was set is in the ring by now
            while self._tx.get(frame):
                if self._closing is not None and self._closing() > _CLOSING:
                    self._refused += 1
                    self._fault = "the bus did not take all frames when it was closed"
                    continue
                try:
                    self._device.send(to_message(frame), timeout=_PATIENCE)
                except (can.CanError, OSError, ValueError) as error:
                    self._refused += 1
                    self._fault = str(error)
            if last:
                return

    def _failed(self, error: Exception) -> None:
        self._fault = str(error)
        self._down = True
        self.bus.struct.state = BusState.DOWN

    def _works(self) -> None:
        """Receiving did not fail: what was down is not any more."""
        if self._down:
            self._down, self._fault = False, ""
            self.bus.struct.state = BusState.ACTIVE
            self.bus.struct.restarts += 1


def to_frame(message: can.Message, t_ns: int) -> Frame:
    """A python-can message that arrived at `t_ns` (monotonic)."""
    remote = message.is_remote_frame and not message.is_fd  # CAN FD has none
    flags = (
        (Flags.FD if message.is_fd else 0)
        | (Flags.BRS if message.bitrate_switch else 0)
        | (Flags.ESI if message.error_state_indicator else 0)
        | (Flags.REMOTE if remote else 0)
        | (Flags.EXTENDED if message.is_extended_id and not message.is_error_frame else 0)
        | (Flags.ERROR if message.is_error_frame else 0)
    )
    frame = Frame.of(message.arbitration_id, bytes(message.data), flags, t_ns)
    if remote:
        frame.length = message.dlc
    return frame


def to_message(
    frame: Frame, timestamp: float = 0.0, channel: int | str | None = None
) -> can.Message:
    """The python-can message of a frame; the bit rate switch is taken from its flags.

    Raises ValueError for an invalid CAN frame (length, identifier).
    """
    remote = bool(frame.flags & Flags.REMOTE)
    return can.Message(
        timestamp=timestamp,
        arbitration_id=frame.id,
        is_extended_id=bool(frame.flags & Flags.EXTENDED),
        is_fd=bool(frame.flags & Flags.FD),
        bitrate_switch=bool(frame.flags & Flags.BRS),
        error_state_indicator=bool(frame.flags & Flags.ESI),
        is_remote_frame=remote,
        is_error_frame=bool(frame.flags & Flags.ERROR),
        is_rx=not frame.flags & Flags.SENT,
        dlc=frame.length,
        data=None if remote else frame.payload,
        channel=channel,
        check=True,
    )


def _descriptors() -> tuple[int, int]:
    """The descriptors at which the sender sleeps, and by which it is woken."""
    if sys.platform == "linux":
        descriptor = os.eventfd(0, os.EFD_CLOEXEC)
        return descriptor, descriptor
    else:
        out, inn = os.pipe()
        with contextlib.suppress(OSError):
            os.set_blocking(inn, False)
        return out, inn
