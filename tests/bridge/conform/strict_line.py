"""A strict drive (``tests/strict_drives``) as the line of the kit, in simulated time."""

from __future__ import annotations

import io
from typing import final

from bridge.can.threaded import to_frame, to_message
from bridge.native.frame import Frame
from tests.strict_drives.core import StrictDrive

TICK = 500_000  # ns


@final
class StrictLine:
    """The bus of one strict drive; its clock is simulated, and begins at 1 s."""

    def __init__(self, drive: StrictDrive) -> None:
        self.drive, self.t, self.late_ns = drive, 1_000_000_000, 0

    def now(self) -> int:
        return self.t

    def send(self, frame: Frame) -> None:
        message, now = to_message(frame), self.t * 1e-9
        if self.drive.hears(message, now):
            self.drive.receive(message, now)

    def receive(self, until_ns: int) -> tuple[Frame, int] | None:
        while True:
            due = sorted(self.drive.out, key=lambda entry: entry[0])
            if due and due[0][0] <= self.t * 1e-9:
                self.drive.out.remove(due[0])
                return to_frame(due[0][1], self.t), self.t
            if self.t >= until_ns:
                return None
            self.t = min(until_ns, self.t + TICK)
            self.drive.tick(self.t * 1e-9)

    def close(self) -> None:
        pass


def nothing() -> io.StringIO:
    """A log that is not read."""
    return io.StringIO()
