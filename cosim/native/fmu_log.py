"""The log of FMUs, as ``fmu_log.h`` keeps it: the last lines, and all where there is room."""

from __future__ import annotations

import ctypes as c
from mmap import mmap

from cosim.native import structs
from cosim.native.enums import LOG_LINES


class Log(structs.LogStruct):
    """The last lines an FMU logged, and the text that follows in memory."""

    def forget(self) -> None:
        """Drop all that was logged."""
        self.count = self.used = self.dropped = 0

    def copy(self, room: int) -> Log:
        """The same in memory of its own; `room`: bytes for text behind this one."""
        found = log(room=room)
        c.memmove(c.addressof(found), c.addressof(self), c.sizeof(Log) + room)
        return found

    def tail(self, n: int = 3) -> list[str]:
        """The last `n` lines, oldest first."""
        first = max(0, self.count - min(n, LOG_LINES))
        lines = (self.line[i % LOG_LINES].value for i in range(first, self.count))
        return [" ".join(line.decode("utf-8", "replace").split()) for line in lines]

    def said(self) -> str:
        """The last lines as part of an error message, or how to get some."""
        if self.count:
            return "; ".join(self.tail())
        hint = "" if self.capacity else "; log = true in its component, or --fmu-log, may tell more"
        return f"the FMU logged nothing{hint}"

    def text(self) -> str:
        """Everything that was kept, and what was not: "" where no room was given."""
        kept = c.string_at(c.addressof(self) + c.sizeof(Log), self.used).decode("utf-8", "replace")
        if not self.dropped:
            return kept
        last = "\n".join(self.tail(LOG_LINES))
        return f"{kept}... {self.dropped} lines left out; the last ones:\n{last}\n"


def log(memory: mmap | None = None, room: int = 0) -> Log:
    """A log at the start of `memory` (default: its own), with `room` bytes for text behind it."""
    found = Log.from_buffer(mmap(-1, c.sizeof(Log) + room) if memory is None else memory)
    found.capacity = room
    return found


def logs(n: int) -> c.Array[Log]:
    """`n` logs without room for text. They take no memory as long as nothing is logged."""
    return (Log * n).from_buffer(mmap(-1, max(1, n) * c.sizeof(Log)))
