"""Messages on their way between a program and the process that has the bus."""

from __future__ import annotations

import itertools

import can
import msgpack  # type: ignore[import-untyped]
import pytest

from bridge.simulated_can.protocol import pack_message, unpack_message

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
