"""Faults of a fault script that act on the emulator of a node, in the time of its slots."""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence
from typing import final

import numpy as np

from bridge.faults.script import FaultEvent
from bridge.firmware.emulator import Emulator
from cosim.base.copies import replace


@final
class ImageFaults:
    """Faults of an emulator, in the order of time; `note` is called with each when it happens.

    A kill is SIGKILL, or a reset where the script starts the node again; a freeze is SIGSTOP, which
    lasts, because the time of the run stands still with it; noise is bytes on the serial line.
    """

    def __init__(
        self,
        emulator: Emulator,
        events: Sequence[FaultEvent] = (),
        note: Callable[[FaultEvent], None] = lambda event: None,
    ) -> None:
        self._emulator, self._note = emulator, note
        self._restarted = {e.index for e in events if e.action == "start"}
        self._next = [e for e in events if e.action in ("kill", "freeze", "noise")]
        self._noise = b""

    def act(self, t: float) -> None:
        """Carry out the events that are due at `t` (s of the run)."""
        while self._next and self._next[0].t <= t:
            event = self._next.pop(0)
            self._note(replace(event, t=t))
            if event.action == "freeze":
                self._emulator.send_signal(signal.SIGSTOP)
            elif event.action == "noise":
                self._noise += np.random.default_rng(event.index).bytes(event.length)
            elif event.index in self._restarted:
                self._emulator.reset()
            else:
                self._emulator.send_signal(signal.SIGKILL)

    def damage(self, data: bytes) -> bytes:
        """Return the bytes from the image, behind the noise that was added to them."""
        noise, self._noise = self._noise, b""
        return noise + data
