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
        data = b"" if kind.remote else bytes(message.data)
        data = data.ljust(padded(len(data), kind.fd), b"\0")
        return BusFrame(message.arbitration_id, data, kind, message.dlc if kind.remote else 0)
    except CosimError as error:
        raise ChannelOperationError(f"channel {channel!r}: {error}") from error


def message_of_frame(frame: BusFrame, own: bool) -> can.Message:
    """A message of its own for one receiver; `own`: it is the sender. Time and channel are open."""
    kind = frame.format
    return can.Message(
        arbitration_id=frame.identifier,
        is_extended_id=kind.extended,
        is_remote_frame=kind.remote,
        is_fd=kind.fd,
        bitrate_switch=kind.brs,
        error_state_indicator=kind.esi,
        dlc=frame.length,
        data=None if kind.remote else frame.data,
        is_rx=not own,
    )
