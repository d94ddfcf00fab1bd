"""Frames of Zenoh's messages, against the bytes of real sessions whose unit is one CAN FD frame."""

from __future__ import annotations

import json
import socket
import struct
import threading
import time
from collections.abc import Iterator

import pytest
import zenoh

from cosim.bus.fragments import ZenohMessage
from cosim.bus.timing import TimingError

KEY = "island/joint/xi"
PREFIX = 2  # over TCP each batch has its length in front, and it counts
UNIT = 64


class Wire:
    """The bytes that one end of a TCP connection sends, recorded on their way to the other end."""

    def __init__(self, target: int) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._server.getsockname()[1])
        self._target, self._heard = target, bytearray()
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        near, _ = self._server.accept()
        far = socket.create_connection(("127.0.0.1", self._target))
        for source, sink, kept in ((near, far, True), (far, near, False)):
            threading.Thread(target=self._pump, args=(source, sink, kept), daemon=True).start()

    def _pump(self, source: socket.socket, sink: socket.socket, kept: bool) -> None:
        while data := source.recv(65536):
            if kept:
                self._heard += data
            sink.sendall(data)

    def batches(self) -> list[bytes]:
        """Complete batches since the last call, without their lengths."""
        found = []
        while len(self._heard) >= PREFIX:
            (length,) = struct.unpack_from("<H", self._heard)
            if len(self._heard) < PREFIX + length:
                break
            found.append(bytes(self._heard[PREFIX : PREFIX + length]))
            del self._heard[: PREFIX + length]
        return found


class Pair:
    """A publisher and a subscriber, whose batches are at most one frame."""

    def __init__(self) -> None:
        with socket.socket() as s:
            s.bind(("127.0.0.1", 0))
            port = int(s.getsockname()[1])
        self._far = zenoh.open(_config(listen=f"tcp/127.0.0.1:{port}"))
        self.wire = Wire(port)
        self._near = zenoh.open(_config(connect=f"tcp/127.0.0.1:{self.wire.port}"))
        self.heard: list[bytes] = []
        self._far.declare_subscriber(KEY, lambda s: self.heard.append(s.payload.to_bytes()))

    def publisher(self, priority: zenoh.Priority, express: bool) -> zenoh.Publisher:
        """A publisher that the far end hears."""
        made = self._near.declare_publisher(KEY, priority=priority, express=express)
        ending = time.monotonic() + 20
        while not made.matching_status.matching and time.monotonic() < ending:
            time.sleep(0.01)
        assert made.matching_status.matching
        time.sleep(0.2)  # declarations are on their way
        return made

    def frames(self, publisher: zenoh.Publisher, payload: bytes, attachment: int) -> list[bytes]:
        """The batches of one message that arrived; Zenoh may drop one when its queue is full."""
        for _ in range(20):
            self.wire.batches()
            self.heard.clear()
            publisher.put(payload, attachment=bytes(attachment) or None)
            ending = time.monotonic() + 1
            while not self.heard and time.monotonic() < ending:
                time.sleep(0.002)
            if self.heard:
                break
        assert self.heard == [payload]
        return [b for b in self.wire.batches() if b[0] & 0x1F in (0x05, 0x06)]  # no keep-alive

    def close(self) -> None:
        """Close both."""
        self._near.close()
        self._far.close()


def _config(listen: str = "", connect: str = "") -> zenoh.Config:
    config = zenoh.Config()
    settings = {
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "listen/endpoints": [listen] if listen else [],
        "connect/endpoints": [connect] if connect else [],
        "transport/link/tx/batch_size": UNIT + PREFIX,
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config


@pytest.fixture(scope="module")
def pair() -> Iterator[Pair]:
    """Two sessions over loopback."""
    made = Pair()
    yield made
    made.close()


def number_bytes(batch: bytes) -> int:
    """Bytes of the sequence number of a frame or fragment: 3 or fewer where it is small."""
    return next(i for i in range(1, 6) if not batch[i] & 0x80)


@pytest.mark.parametrize("attachment", [0, 16, 33, 200])
@pytest.mark.parametrize(
    ("priority", "express", "data", "default"),
    [
        (zenoh.Priority.REAL_TIME, True, False, False),
        (zenoh.Priority.DATA_LOW, False, False, False),
        (zenoh.Priority.DATA, True, True, False),
        (zenoh.Priority.DATA, False, True, True),
    ],
)
def test_frames_are_those_of_a_session(
    pair: Pair, priority: zenoh.Priority, express: bool, data: bool, default: bool, attachment: int
) -> None:
    publisher = pair.publisher(priority, express)
    edges = [48, 49, 50, 51, 52, 53, 54, 103, 104, 105, 106, 107, 108, 109, 110]
    for payload in [0, 1, 8, 40, *edges, 127, 128, 129, 400, 1000]:
        found = pair.frames(publisher, bytes(payload), attachment)
        message = ZenohMessage(payload, attachment, data, default)
        expected = message.frames(UNIT, number_bytes(found[0]))
        assert tuple(len(batch) for batch in found) == expected, payload
    publisher.undeclare()


def test_a_twist_of_ros_2_is_the_put_of_89_bytes_that_was_reported() -> None:
    """52 bytes of CDR and an attachment of 35 bytes with its header: zenoh pull request 2757."""
    twist = ZenohMessage(52, attachment=33, data_priority=True, default_quality=True)
    assert twist.length - 2 == 89  # without header and key of the push
    assert len(twist.frames()) == 2


def test_messages_that_cannot_be_are_refused() -> None:
    with pytest.raises(TimingError, match="negative"):
        ZenohMessage(-1)
    with pytest.raises(TimingError, match="default_quality without"):
        ZenohMessage(1, default_quality=True)
