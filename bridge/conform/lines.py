"""The ends of the kit on the buses of a participant: frames out, and all frames of others in."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Protocol, final

from bridge.can.interface import CanBusSpec
from bridge.can.plain import PlainBus
from bridge.can.socket import BusError
from bridge.conform.lateness import KitLateness
from bridge.native.frame import Flags, Frame
from cosim.base.clock import monotonic_ns

#: Called with each frame of the participant and the time of its arrival (monotonic, ns).
Arrived = Callable[[Frame, int], None]
_LOOK_NS, _LOST_NS = 50_000_000, 5_000_000_000
_KEY_FLAGS = Flags.FD | Flags.REMOTE | Flags.EXTENDED


class BusLine(Protocol):
    """One bus."""

    def send(self, frame: Frame) -> None:
        """Send a frame. Raises BusError if the driver refuses it."""

    def close(self) -> None:
        """Leave the bus."""


def frame_key(frame: Frame) -> tuple[int, int, int, bytes]:
    """A key that is equal for two frames that are equal on a bus."""
    remote = bool(frame.flags & Flags.REMOTE)
    return (
        int(frame.id),
        int(frame.flags & _KEY_FLAGS),
        int(frame.length),
        b"" if remote else frame.payload,
    )


@final
class CanLine:
    """A CAN bus: one node that speaks, and one that hears all, also the first one.

    So the time that a frame of the kit takes to another node is measured. Raises BusError.
    """

    def __init__(self, spec: CanBusSpec, arrived: Arrived, lateness: KitLateness) -> None:
        self._ear, self._arrived, self._lateness = PlainBus(spec), arrived, lateness
        self._mouth = PlainBus(spec)
        self._lock = threading.Lock()
        self._own: dict[tuple[int, int, int, bytes], deque[int]] = {}
        self._stop = threading.Event()
        self.fault = ""
        """The first error of the driver."""
        self._threads = [
            threading.Thread(target=self._hear, name=f"conform {spec.name}", daemon=True),
            threading.Thread(target=self._drain, name=f"conform {spec.name} own", daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def send(self, frame: Frame) -> None:
        """Send a frame. Raises BusError if the driver refuses it."""
        with self._lock:
            self._own.setdefault(frame_key(frame), deque(maxlen=64)).append(monotonic_ns())
        self._mouth.send(frame)

    def close(self) -> None:
        """End the threads, leave the bus."""
        self._stop.set()
        for thread in self._threads:
            thread.join()
        self._ear.close()
        self._mouth.close()

    def _hear(self) -> None:
        while not self._stop.is_set():
            try:
                came = self._ear.receive(monotonic_ns() + _LOOK_NS)
            except BusError as error:
                self.fault = self.fault or str(error)
                self._stop.wait(0.05)
                continue
            if came is None or came.frame.flags & Flags.ERROR:
                continue
            sent_ns = self._sent(came.frame)
            if sent_ns is None:
                self._arrived(came.frame, came.t_ns)
            else:
                self._lateness.add(came.t_ns, came.t_ns - sent_ns)

    def _sent(self, frame: Frame) -> int | None:
        """The time at which the kit itself sent it; None: it did not."""
        with self._lock:
            times = self._own.get(frame_key(frame), deque())
            oldest_ns = monotonic_ns() - _LOST_NS
            while len(times) > 1 and times[0] < oldest_ns:  # the bus has lost it
                times.popleft()
            return times.popleft() if times else None

    def _drain(self) -> None:
        """Empty the queue of the speaking node: the other one hears the same."""
        while not self._stop.is_set():
            try:
                self._mouth.receive(monotonic_ns() + _LOOK_NS)
            except BusError:
                self._stop.wait(0.05)
