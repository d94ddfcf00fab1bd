"""Messages on their way between a program and the process that has the bus."""

from __future__ import annotations

import itertools

import can
import msgpack  # type: ignore[import-untyped]
import pytest

from bridge.simulated_can.frames import frame_of_message, message_of_frame
from bridge.simulated_can.protocol import pack_frame, pack_message, unpack_frame, unpack_message
from cosim.bus.timing import BusTiming

FLAGS = ["is_extended_id", "is_fd", "bitrate_switch", "error_state_indicator", "is_rx"]


@pytest.mark.parametrize("values", list(itertools.product([False, True], repeat=len(FLAGS))))
def test_a_message_arrives_with_its_flags(values):
    flags = dict(zip(FLAGS, values, strict=True))
    message = can.Message(1.5, 0x123, data=b"abc", channel="bench", **flags)
    packed = msgpack.unpackb(msgpack.packb(pack_message(message)))
    assert unpack_message(packed, "bench").equals(message, timestamp_delta=0.0)


@pytest.mark.parametrize("kind", ["is_remote_frame", "is_error_frame"])
def test_remote_and_error_frames_arrive_as_such(kind):
    message = can.Message(2.0, 0x7, dlc=5, channel="bench", is_extended_id=False, **{kind: True})
    if kind == "is_error_frame":
        message.data = bytearray(5)
    assert unpack_message(pack_message(message), "bench").equals(message, timestamp_delta=0.0)


FRAMES = [
    can.Message(arbitration_id=0x123, data=b"abc", is_extended_id=False),
    can.Message(arbitration_id=0x1ABCDEF0, data=bytes(8)),
    can.Message(arbitration_id=0x7, dlc=5, is_remote_frame=True, is_extended_id=False),
    can.Message(arbitration_id=0x7, data=bytes(9), is_fd=True, bitrate_switch=True),
    can.Message(arbitration_id=0x7, data=bytes(64), is_fd=True, error_state_indicator=True),
    can.Message(arbitration_id=0x7, data=b"abc", bitrate_switch=True),  # CAN FD only: ignored
]


@pytest.mark.parametrize("message", FRAMES, ids=str)
@pytest.mark.parametrize("own", [False, True])
def test_a_frame_goes_and_comes_as_its_message_does(message: can.Message, own: bool) -> None:
    timing = BusTiming(1e6, 5e6, fd=True)
    frame = unpack_frame(pack_message(message), "bench", timing)
    assert frame == frame_of_message(message, "bench", timing)
    assert len(frame.data) in (*range(9), 12, 64)
    received = unpack_message(pack_frame(frame, own, 1.5, "bench"), "bench")
    assert received.equals(message_of_frame(frame, own, 1.5, "bench"), timestamp_delta=0.0)
    assert (received.arbitration_id, received.is_rx) == (message.arbitration_id, not own)
    assert received.is_extended_id == message.is_extended_id
    assert received.is_remote_frame == message.is_remote_frame
    assert received.bitrate_switch == (message.is_fd and message.bitrate_switch)
    assert received.error_state_indicator == message.error_state_indicator
    assert bytes(received.data[: len(message.data)]) == bytes(message.data)


def test_data_that_are_no_bytes_are_refused() -> None:
    with pytest.raises(TypeError, match="found data of int, expected bytes"):
        unpack_frame([5, 0, 0, 10**9, 0.0], "bench", BusTiming(1e6))
