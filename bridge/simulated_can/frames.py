"""Messages of python-can as frames of the simulated bus, and back."""

from __future__ import annotations

from collections.abc import Hashable
from functools import cache

import can

from bridge.simulated_can.options import ChannelOperationError
from cosim.base.errors import CosimError
from cosim.bus.frames import BusFrame
from cosim.bus.timing import BusTiming, FrameFormat, padded


@cache
def _format(extended: bool, remote: bool, fd: bool, brs: bool, esi: bool) -> FrameFormat:
    return FrameFormat(extended, fd, fd and brs, remote, fd and esi)


def frame_of_message(message: can.Message, channel: Hashable, timing: BusTiming) -> BusFrame:
    """The frame of a message; FD data is filled with zeros to the next length, as Linux does.

    Raises ChannelOperationError for what a bus with this timing cannot carry.
    """
    if message.is_error_frame:
        raise ChannelOperationError(
            f"channel {channel!r}: found an error frame to send, expected a message"
        )
    if message.is_fd and not timing.fd:
        raise ChannelOperationError(
            f"channel {channel!r}: found a CAN FD message on a classic bus, expected fd=True"
        )
    try:
        kind = _format(
            message.is_extended_id,
            message.is_remote_frame,
            message.is_fd,
            message.bitrate_switch,
            message.error_state_indicator,
        )
        if kind.remote:
            return BusFrame(message.arbitration_id, b"", kind, message.dlc)
        data = bytes(message.data)
        if len(data) > 8:
            data = data.ljust(padded(len(data), kind.fd), b"\0")
        return BusFrame(message.arbitration_id, data, kind)
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
        frame.dlc if kind.remote else len(data),
        data,
        kind.fd,
        not own,
        kind.brs,
        kind.esi,
    )
