"""Messages of python-can as frames of the simulated bus, and back."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import cache
from typing import Any, NamedTuple

import can

from bridge.simulated_can.options import ChannelOperationError
from cosim.base.errors import CosimError
from cosim.bus.frames import BusFrame, format_of
from cosim.bus.timing import BusTiming, FrameFormat, padded

EXTENDED, REMOTE, ERROR, FD, BRS, ESI, RX = (1 << place for place in range(7))
"""Flags of a message on its way between processes."""


def flags_of(message: can.Message) -> int:
    """The flags of a message."""
    return (
        (EXTENDED if message.is_extended_id else 0)
        | (REMOTE if message.is_remote_frame else 0)
        | (ERROR if message.is_error_frame else 0)
        | (FD if message.is_fd else 0)
        | (BRS if message.bitrate_switch else 0)
        | (ESI if message.error_state_indicator else 0)
        | (RX if message.is_rx else 0)
    )


@cache
def _format(flags: int) -> FrameFormat:
    fd = flags & FD > 0
    brs, esi = fd and flags & BRS > 0, fd and flags & ESI > 0
    return FrameFormat(flags & EXTENDED > 0, fd, brs, flags & REMOTE > 0, esi)


@cache
def received_flags(kind: int, own: bool) -> int:
    """The flags of a received message whose frame has the flags `kind` of the bus."""
    found = format_of(kind)
    flags = (EXTENDED * found.extended) | (REMOTE * found.remote) | (FD * found.fd)
    return flags | (BRS * found.brs) | (ESI * found.esi) | (0 if own else RX)


def frame_of_message(message: can.Message, channel: Hashable, timing: BusTiming) -> BusFrame:
    """The frame of a message; FD data is filled with zeros to the next length, as Linux does.

    Raises ChannelOperationError for what a bus with this timing cannot carry.
    """
    fields = message.arbitration_id, flags_of(message), message.dlc, bytes(message.data)
    return frame_to_send(fields, channel, timing)


def frame_to_send(
    fields: tuple[int, int, int, bytes], channel: Hashable, timing: BusTiming
) -> BusFrame:
    """The frame of a message with these fields: identifier, flags, DLC and data.

    Raises ChannelOperationError for what a bus with this timing cannot carry.
    """
    identifier, flags, dlc, data = fields
    if flags & ERROR:
        raise ChannelOperationError(
            f"channel {channel!r}: found an error frame to send, expected a message"
        )
    if flags & FD and not timing.fd:
        raise ChannelOperationError(
            f"channel {channel!r}: found a CAN FD message on a classic bus, expected fd=True"
        )
    try:
        kind = _format(flags & ~RX)
        if kind.remote:
            return BusFrame(identifier, b"", kind, dlc)
        if len(data) > 8:
            data = data.ljust(padded(len(data), kind.fd), b"\0")
        return BusFrame(identifier, data, kind)
    except CosimError as error:
        raise ChannelOperationError(f"channel {channel!r}: {error}") from error


def message_of_frame(frame: BusFrame, own: bool, stamp: float, channel: Hashable) -> can.Message:
    """A message of its own for one receiver, stamped with a time (s); `own`: it is the sender."""
    kind, data = frame.format, bytearray(frame.data)
    return can.Message(
        stamp,
        frame.identifier,
        kind.extended,
        kind.remote,
        False,
        channel,  # type: ignore[arg-type]
        frame.length,
        data,
        kind.fd,
        not own,
        kind.brs,
        kind.esi,
    )


class MessageForm(NamedTuple):
    """The form in which messages are received."""

    of_frame: Callable[[BusFrame, bool, float, Hashable], Any]
    """Makes it of a frame, with the arguments of :func:`message_of_frame`."""
    of_message: Callable[[can.Message], Any]


MESSAGES = MessageForm(message_of_frame, lambda message: message)
