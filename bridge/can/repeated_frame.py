"""Periodic sending of one frame, for the emergency stop and for a babbling peer."""

from __future__ import annotations

import ctypes as c
import signal
from collections.abc import Iterator
from contextlib import contextmanager

from bridge.native import pace
from bridge.native.bus import Bus
from bridge.native.frame import Flags, Frame

LONGEST_WAIT = 50_000_000  # ns; a signal is answered within
#: Bit of a number that makes it an identifier of 29 bits, as in linux/can.h.
EXTENDED = 0x80000000


def repeat(
    bus: Bus, identifier: int, rate: float, length: int, frames: int | None, stop: c.c_int32
) -> tuple[int, int]:
    """Send `rate` frames a second of `length` bytes until `stop` is not 0, or so many.

    `identifier`: bit 31 makes it a 29-bit one. More than 8 bytes: CAN FD. Late ones are caught up.
    Returns how many were sent, and how many were not taken.
    """
    frame = Frame.of(identifier & 0x1FFFFFFF, bytes(length), flags_of(identifier, length))
    start, k, failed = pace.now(), 0, 0
    while (frames is None or k < frames) and not stop.value:
        deadline = start + round(k * 1e9 / rate)
        while pace.now() < deadline and not stop.value:
            pace.wait(min(deadline, pace.now() + LONGEST_WAIT), 0, stop)
        frame.data[: min(length, 4)] = [*k.to_bytes(8, "little")][: min(length, 4)]
        frame.t_ns = 0
        failed += bus.send(frame) != 0
        k += 1
    return k - failed, failed


def flags_of(identifier: int, length: int) -> int:
    """Format of a frame with this identifier and so many bytes, see `Flags`."""
    long = identifier & EXTENDED or identifier & 0x1FFFFFFF > 0x7FF
    return (Flags.EXTENDED if long else 0) | (Flags.FD | Flags.BRS if length > 8 else 0)


@contextmanager
def stopped_by_signals() -> Iterator[c.c_int32]:
    """A flag for C that is not 0 once SIGTERM or SIGINT has come."""
    stop = c.c_int32(0)

    def told(*_: object) -> None:
        stop.value = 1

    before = {s: signal.signal(s, told) for s in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
