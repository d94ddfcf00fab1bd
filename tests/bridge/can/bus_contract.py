"""Rules for every bus, whatever is behind it. A backend is a `connect` that gives two ends."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Protocol

import can
import numpy as np
import pytest

from bridge.can.health import BusHealth
from bridge.can.interface import Attachment
from bridge.can.threaded import to_frame, to_message
from bridge.native import pace
from bridge.native.bus import Accept, Bus, BusState
from bridge.native.frame import Flags, Frame, frame_dtype
from bridge.native.journal import Journal
from cosim.base.clock import sleep, stopwatch

BURST = 5000
PATIENCE = 20.0  # s; only a test that fails waits for so long
LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
FORMATS = (
    Flags(0), Flags.EXTENDED, Flags.FD, Flags.FD | Flags.BRS, Flags.FD | Flags.EXTENDED,
    Flags.FD | Flags.BRS | Flags.ESI | Flags.EXTENDED,
)  # fmt: skip


class Peer(Protocol):
    """The other end: sends, and has received."""

    def send(self, frames: Sequence[Frame]) -> None: ...

    def take(self, n: int) -> list[Frame]:
        """The frames that have arrived, once they are n or nothing more comes."""

    def close(self) -> None: ...


@dataclass
class Pair:
    ours: Attachment
    peer: Peer
    log: Journal

    def take(self, n: int) -> list[Frame]:
        """The frames that our end received, once they and those counted as lost are n."""
        return collect(self.ours.bus, n)

    def health(self) -> BusHealth:
        return self.ours.health(pace.now())


Connect = Callable[..., tuple[Attachment, Peer]]


def collect(bus: Bus, n: int) -> list[Frame]:
    elapsed, found = stopwatch(), bus.drain()
    while len(found) + bus.struct.overruns < n and elapsed() < PATIENCE:
        sleep(0.002)
        found += bus.drain()
    return found


class PythonCanPeer:
    """A plain python-can bus."""

    def __init__(self, device: can.BusABC) -> None:
        self.device = device

    def send(self, frames: Sequence[Frame]) -> None:
        for frame in frames:
            self.device.send(to_message(frame), timeout=PATIENCE)

    def take(self, n: int) -> list[Frame]:
        found: list[Frame] = []
        while len(found) < n and (message := self.device.recv(PATIENCE if n else 0)):
            found.append(to_frame(message, 0))
        while message := self.device.recv(0.02):
            found.append(to_frame(message, 0))
        return found

    def close(self) -> None:
        self.device.shutdown()


class BusPeer:
    """Another of our own buses."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus

    def send(self, frames: Sequence[Frame]) -> None:
        assert [self.bus.send(frame) for frame in frames] == [0] * len(frames)

    def take(self, n: int) -> list[Frame]:
        return collect(self.bus, n)

    def close(self) -> None:
        pass


def every_frame() -> list[Frame]:
    """Both formats, identifiers at their limits, all lengths; each content only once."""
    rng, frames = np.random.default_rng(1), []
    for flags, length in product(FORMATS, LENGTHS):
        if length > 8 and not flags & Flags.FD:
            continue
        top = 0x1FFFFFFF if flags & Flags.EXTENDED else 0x7FF
        for identifier in (0, 1, 0x555, top):
            frames.append(Frame.of(identifier, rng.bytes(length), flags))
    return frames


def numbered(n: int, start: int = 0) -> list[Frame]:
    return [Frame.of(0x100 + k % 16, (start + k).to_bytes(8, "little")) for k in range(n)]


def numbers(frames: Sequence[Frame]) -> list[int]:
    return [int.from_bytes(frame.payload, "little") for frame in frames]


def keys(frames: Sequence[Frame]) -> list[tuple[int, int, bytes]]:
    return [frame.key() for frame in frames]


class BusContract:
    """Inherit, and give the fixture `connect(log, accepts) -> (ours, peer)`.

    `frames`: of all kinds the bus takes; `logged`: such as a journal of CAN has room for.
    """

    frames = staticmethod(every_frame)
    logged = staticmethod(every_frame)

    @pytest.fixture
    def pair(self, connect: Connect, tmp_path: Path) -> Iterator[Pair]:
        log = Journal.create(tmp_path / "frames", frame_dtype(), 2 * BURST)
        ours, peer = connect(log, None)
        yield Pair(ours, peer, log)
        peer.close()
        ours.close()
        log.close()

    def test_frames_are_received_unchanged_and_in_order(self, pair: Pair):
        frames = self.frames()
        pair.peer.send(frames)
        assert keys(pair.take(len(frames))) == keys(frames)
        assert pair.health().received == len(frames)

    def test_frames_are_sent_unchanged_and_in_order(self, pair: Pair):
        frames = self.frames()
        assert {pair.ours.bus.send(frame) for frame in frames} == {0}
        assert keys(pair.peer.take(len(frames))) == keys(frames)
        assert pair.health().sent == len(frames)

    def test_remote_frames_keep_the_length_they_ask_for(self, pair: Pair):
        frame = Frame.of(0x123, b"", Flags.REMOTE)
        frame.length = 5
        assert pair.ours.bus.send(frame) == 0
        (found,) = pair.peer.take(1)
        assert (found.id, found.flags, found.length) == (0x123, Flags.REMOTE, 5)

    def test_receiving_does_not_wait(self, pair: Pair):
        assert [pair.ours.bus.receive(Frame()) for _ in range(100)] == [False] * 100

    def test_own_frames_do_not_come_back(self, pair: Pair):
        assert pair.ours.bus.send(Frame.of(0x101, b"ours")) == 0
        assert len(pair.peer.take(1)) == 1
        pair.peer.send([Frame.of(0x102, b"theirs")])
        assert keys(pair.take(1)) == [(0x102, 0, b"theirs")]

    def test_a_burst_comes_in_order_and_what_is_lost_is_counted(self, pair: Pair):
        pair.peer.send(numbered(BURST))
        found = numbers(pair.take(BURST))
        assert found == sorted(set(found))
        assert len(found) + pair.health().overruns == BURST

    def test_a_burst_goes_in_order_and_what_is_refused_is_counted(self, pair: Pair):
        refused = sum(pair.ours.bus.send(frame) != 0 for frame in numbered(BURST))
        found = numbers(pair.peer.take(BURST - refused))
        assert found == sorted(set(found))
        health = pair.health()
        assert len(found) == health.sent == BURST - health.send_failed
        assert refused == health.send_failed

    def test_the_log_has_what_was_sent_and_received(self, pair: Pair):
        sent, received = self.logged(), self.logged()[::-1]
        for frame in sent:
            pair.ours.bus.send(frame)
        pair.peer.send(received)
        pair.take(len(received))
        rows = Journal.open(pair.log.path)
        is_sent = rows["flags"] & Flags.SENT != 0
        assert row_keys(rows[is_sent]) == keys(sent)
        assert row_keys(rows[~is_sent]) == keys(received)
        assert rows["sequence"].tolist() == list(range(len(rows)))
        assert set(rows["bus"]) == {pair.ours.bus.struct.number}

    def test_times_are_monotonic_and_lie_where_things_happened(self, pair: Pair):
        before = pace.now()
        pair.peer.send(numbered(16))
        times = [frame.t_ns for frame in pair.take(16)]
        sent = Frame.of(0x100)
        pair.ours.bus.send(sent)
        moments = [before, *times, sent.t_ns, pace.now()]
        assert moments == sorted(moments)

    def test_filters_take_identifier_mask_and_format(self, connect: Connect, tmp_path: Path):
        """Frames that are not taken are on record all the same, and counted."""
        accepts = [Accept(0x100, 0x7F0), Accept(0x18FF0000, 0x1FFF0000, Flags.EXTENDED)]
        with Journal.create(tmp_path / "frames", frame_dtype(), 100) as log:
            ours, peer = connect(log, accepts)
            wanted = [Frame.of(0x100), Frame.of(0x10F), Frame.of(0x18FFABCD, b"", Flags.EXTENDED)]
            others = [
                Frame.of(0x110), Frame.of(0x7FF), Frame.of(0x18FEABCD, b"", Flags.EXTENDED),
                Frame.of(0x100, b"", Flags.EXTENDED), Frame.of(0x100, b"", Flags.REMOTE),
            ]  # fmt: skip
            last = Frame.of(0x101, b"last")
            peer.send([*others, *wanted, *others, last])
            assert keys(collect(ours.bus, 4)) == keys([*wanted, last])
            assert row_keys(Journal.open(log.path)) == keys([*others, *wanted, *others, last])
            assert ours.bus.struct.foreign == 2 * len(others)
            peer.close()
            ours.close()

    def test_error_frames_change_the_state_and_are_logged_but_not_given(self, pair: Pair):
        passive, off, restarted = bytes([0, 0x20, 0, 0, 0, 0, 130, 7]), bytes(8), bytes(8)
        errors = [(0x204, passive, BusState.PASSIVE), (0x40, off, BusState.OFF)]
        for identifier, data, state in errors:
            pair.peer.send([Frame.of(identifier, data, Flags.ERROR)])
            self._until(pair, lambda state=state: pair.ours.bus.state == state)
            assert pair.ours.bus.state == state
        pair.peer.send([Frame.of(0x100, restarted, Flags.ERROR), Frame.of(5)])
        assert keys(pair.take(1)) == [(5, 0, b"")]
        health = pair.health()
        assert (health.state, health.restarts, health.error_frames) == (BusState.ACTIVE, 1, 3)
        assert (health.tx_errors, health.rx_errors) == (130, 7)
        logged = Journal.open(pair.log.path)
        assert logged["id"].tolist() == [0x204, 0x40, 0x100, 5]

    @staticmethod
    def _until(pair: Pair, reached: Callable[[], bool]) -> None:
        elapsed = stopwatch()
        while not reached() and elapsed() < PATIENCE:
            assert pair.ours.bus.drain() == []
            sleep(0.002)

    def test_health_says_what_was_on_the_bus(self, pair: Pair):
        for frame in numbered(10):
            pair.ours.bus.send(frame)
        pair.peer.send(numbered(10))
        pair.take(10)
        health = pair.health()
        assert health.ok and health.state == BusState.ACTIVE
        assert (health.sent, health.received, health.error_frames) == (10, 10, 0)
        assert pair.ours.bus.traffic.frames == 20
        assert pair.ours.bus.traffic.bits == pytest.approx(20 * (47 + 64 + 98 / 30))


def row_keys(rows: np.ndarray) -> list[tuple[int, int, bytes]]:
    return [
        (int(r["id"]), int(r["flags"]) & ~Flags.SENT, r["data"][: r["length"]].tobytes())
        for r in rows
    ]
