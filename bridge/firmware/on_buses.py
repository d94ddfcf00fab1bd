"""An image on the wall clock: its frames are copied between its serial line and its buses."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from select import select
from typing import final

from bridge.firmware.emulator import LOOK, Emulator
from bridge.firmware.records import FirmwareError, Kind, Reader, pack, pack_frame, unpack_frame
from bridge.native.bus import Bus
from bridge.native.frame import Frame
from bridge.native.safety import Command


@final
class FrameCopy:
    """Copying of frames between an image and its `buses`, by number.

    `note` receives what the image says. `received`, `sent`: frames to and from the image.
    """

    def __init__(
        self, emulator: Emulator, buses: Sequence[Bus], note: Callable[[str], None]
    ) -> None:
        self.received = self.sent = 0
        self._emulator, self._buses, self._note = emulator, buses, note
        self._reader, self._frame = Reader(), Frame()
        rings = [int(b.rx.struct.bell) for b in buses if b.rx is not None]
        self._bells = [bell for bell in rings if bell > 0]
        self._sockets = [int(b.struct.fd) for b in buses if b.rx is None]

    @property
    def damaged(self) -> int:
        """Bytes from the image that belong to no record."""
        return self._reader.damaged

    def tell(self, command: Command) -> None:
        """Give the image a command, as NMT on its buses does."""
        self._emulator.send(pack(Kind.TELL, bytes([command])))

    def turn(self) -> None:
        """Wait for frames, and copy what has come. Raises FirmwareError if the image has ended."""
        ready, _, _ = select([self._emulator.fileno(), *self._bells, *self._sockets], [], [], LOOK)
        for bell in self._bells:
            if bell in ready:
                os.read(bell, 8)
        for number, bus in enumerate(self._buses):
            while bus.receive(self._frame):
                self._frame.bus = number
                self._emulator.send(pack_frame(self._frame))
                self.received += 1
        for kind, payload in self._reader.feed(self._emulator.receive(0)):
            if kind is Kind.FRAME:
                self._send(unpack_frame(payload))
            elif kind is Kind.LOG:
                self._note(payload.decode(errors="replace"))

    def _send(self, frame: Frame) -> None:
        if frame.bus >= len(self._buses):
            text = f"{self._emulator.name} has sent a frame on bus {frame.bus}, which it has not"
            raise FirmwareError(text)
        self._buses[frame.bus].send(frame)
        self.sent += 1
