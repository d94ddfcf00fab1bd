"""Frames and their events on a simulated bus, as values and as NumPy rows."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from typing import Any, cast

import numpy as np

from cosim.bus.timing import CLASSIC, FrameFormat, TimingError, padded

#: ``can_frame_t`` of ``cosim/c/bus/bus.h`` as a NumPy row.
FRAME = np.dtype(
    [("id", "<u4"), ("flags", "u1"), ("length", "u1"), ("reserved", "<u2"), ("data", "u1", 64)]
)
#: ``bus_request_t``: a frame that is pending at a node from `at` ps on.
REQUEST = np.dtype([("at", "<i8"), ("node", "<i4"), ("reserved", "<i4"), ("frame", FRAME)])
#: ``bus_event_t``: see :class:`BusEvent` for the kinds. `time` in ps.
EVENT = np.dtype(
    [
        ("time", "<i8"),
        ("request", "<i8"),
        ("frame", "<i4"),
        ("bit", "<i2"),
        ("node", "<i2"),
        ("tec", "<i2"),
        ("rec", "<i2"),
        ("kind", "u1"),
        ("code", "u1"),
        ("role", "u1"),
        ("reserved", "u1"),
    ]
)
#: ``bus_received_t``: a frame of a receive FIFO.
RECEIVED = np.dtype([("time", "<i8"), ("request", "<i8"), ("frame", FRAME)])


class BusEvent(IntEnum):
    """``EVENT_``: kinds of events.

    An event has the time of the end of the bit in which the node saw it. STARTED: the begin of the
    start of frame. SENT and RECEIVED: the end of the last bit of the frame (EOF), which is three
    bits before the next frame can start. `bit` counts from the start of frame (0), with stuff bits.
    FREE has no node (-1): after error or overload flags, all nodes are idle or bus-off again.
    """

    STARTED = 0
    SENT = 1
    RECEIVED = 2
    LOST = 3
    ERROR = 4
    STATE = 5
    DROPPED = 6
    RECOVERED = 7
    OVERLOAD = 8
    FREE = 9


class ErrorCode(IntEnum):
    """``ERROR_``: the code of an ERROR event (the numbers are those of FMI-LS-BUS)."""

    BIT = 1
    STUFF = 2
    FORM = 3
    CRC = 4
    ACK = 5


class ErrorRole(IntEnum):
    """``ROLE_``: flags of an ERROR event.

    PRIMARY: no other node sent an active error flag in that bit. SENDER: the node was transmitter.
    """

    PRIMARY = 1
    SENDER = 2


class ControllerState(IntEnum):
    """``STATE_``: the code of a STATE event.

    ACTIVE, WARNING (a counter above 95), PASSIVE (above 127), OFF (TEC above 255); INTEGRATING:
    after a reset, until 11 recessive bits were seen.
    """

    ACTIVE = 0
    WARNING = 1
    PASSIVE = 2
    OFF = 3
    INTEGRATING = 4


class DropCause(IntEnum):
    """``DROP_``: the code of a DROPPED event.

    OVERFLOW: the transmit queue was full. REPLACED: by a newer frame of the same identifier in
    mailboxes. ABORTED: by the host. ONE_SHOT: no second attempt. RESET: of the controller.
    RECEIVE_OVERFLOW: received, but the receive FIFO was full.
    """

    OVERFLOW = 0
    REPLACED = 1
    ABORTED = 2
    ONE_SHOT = 3
    RESET = 4
    RECEIVE_OVERFLOW = 5


@dataclass(frozen=True, slots=True)
class BusFrame:
    """A CAN frame. `dlc`: how many bytes a remote frame asks for."""

    identifier: int
    data: bytes = b""
    format: FrameFormat = CLASSIC
    dlc: int = 0

    def __post_init__(self) -> None:
        kind, length = self.format, len(self.data)
        width = 29 if kind.extended else 11
        if not 0 <= self.identifier < 1 << width:
            raise TimingError(f"found identifier {self.identifier:#x}, expected {width} bits")
        if kind.remote:
            if length:
                raise TimingError("found data in a remote frame, expected none")
            padded(self.dlc, kind.fd)
        elif self.dlc not in (0, length):
            raise TimingError(
                f"found DLC {self.dlc} of {length} bytes; expected it in remote frames only"
            )
        elif length > 8:
            padded(length, kind.fd)

    @property
    def length(self) -> int:
        """Number of data bytes; for a remote frame, the number requested."""
        return self.dlc if self.format.remote else len(self.data)

    @property
    def flags(self) -> int:
        """``CAN_`` flags of ``cosim/c/bus/length.h``."""
        return self.format.flags

    def row(self) -> np.void:
        """The frame as a row of :data:`FRAME`."""
        rows = np.zeros(1, FRAME)
        rows[["id", "flags", "length"]] = (self.identifier, self.flags, self.length)
        rows["data"][0, : len(self.data)] = np.frombuffer(self.data, np.uint8)
        return cast(np.void, rows[0])


@cache
def format_of(flags: int) -> FrameFormat:
    """The format of a frame with these ``CAN_`` flags."""
    fd, brs, esi, remote, extended = (bool(flags >> place & 1) for place in range(5))
    return FrameFormat(extended, fd, brs, remote, esi)


def frame_of_fields(identifier: int, flags: int, length: int, data: bytes) -> BusFrame:
    """The frame of the fields of a row; `data` may be longer than the frame."""
    kind = format_of(flags)
    if kind.remote:
        return BusFrame(identifier, b"", kind, length)
    return BusFrame(identifier, data[:length], kind)


def frame_of(row: Any) -> BusFrame:
    """The frame of a row of :data:`FRAME`."""
    fields = int(row["id"]), int(row["flags"]), int(row["length"])
    return frame_of_fields(*fields, row["data"].tobytes())
