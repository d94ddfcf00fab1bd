"""Questions to a drive, and what came: frames with times, on a line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import final

from bridge.conform.drives.lines import JudgedLine
from bridge.native.frame import Flags, Frame


class DriveSilentError(Exception):
    """A rule cannot be judged: the drive is not in the state it begins with. The text tells it."""


@dataclass(frozen=True, slots=True)
class CameFrame:
    """A frame that came, and its time, ns."""

    id: int
    data: bytes
    flags: int
    t_ns: int

    def __str__(self) -> str:
        return f"{self.id:03X}#{self.data.hex(' ').upper()}"


@dataclass(frozen=True, slots=True)
class DriveSetup:
    """The drive as the user describes it.

    `node`: its number on the bus (ESC_ID, node ID, axis); `watchdog`: its time-out in s, 0: not
    known; `host`: the number of the kit, whose heartbeats a CiA 402 drive waits for; `fd`: frames
    to it are CAN FD with bit rate switch.
    """

    node: int
    watchdog: float = 0.0
    host: int = 1
    fd: bool = False


@final
class DriveBench:
    """The kit at the bus of a drive."""

    def __init__(self, line: JudgedLine, setup: DriveSetup) -> None:
        self.line, self.setup = line, setup
        self.node = setup.node

    def send(self, identifier: int, data: bytes = b"", *, remote: bool = False) -> None:
        """Send a frame; `remote`: without data. Raises BusError."""
        flags = Flags.FD | Flags.BRS if self.setup.fd else 0
        self.line.send(Frame.of(identifier, data, Flags.REMOTE if remote else flags))

    def listen(self, seconds: float) -> list[CameFrame]:
        """All frames of the next seconds."""
        until, found = self.line.now() + round(seconds * 1e9), []
        while (came := self.line.receive(until)) is not None:
            found.append(_frame(came))
        return found

    def find(
        self, wanted: Callable[[CameFrame], bool], seconds: float
    ) -> tuple[CameFrame | None, list[CameFrame]]:
        """The first frame that is `wanted` within the next seconds, and all frames up to it."""
        until, found = self.line.now() + round(seconds * 1e9), list[CameFrame]()
        while (came := self.line.receive(until)) is not None:
            found.append(_frame(came))
            if wanted(found[-1]):
                return found[-1], found
        return None, found

    def drain(self) -> None:
        """Take what has come and was not asked for."""
        self.listen(0.0)

    def every(self, seconds: float, period: float, send: Callable[[], None]) -> list[CameFrame]:
        """All frames of the next seconds, in which something is sent once in each period, s."""
        found = []
        for _ in range(max(1, round(seconds / period))):
            send()
            found += self.listen(period)
        return found


def _frame(came: tuple[Frame, int]) -> CameFrame:
    frame, t_ns = came
    return CameFrame(int(frame.id), bytes(frame.payload), int(frame.flags), t_ns)


def shown(frames: list[CameFrame]) -> str:
    """Frames for people: the first of them, or nothing."""
    if not frames:
        return "nothing"
    more = f" and {len(frames) - 3} more" if len(frames) > 3 else ""
    return ", ".join(map(str, frames[:3])) + more
