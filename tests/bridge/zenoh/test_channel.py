"""A Zenoh bus does what every bus does, and finds its peers again."""

import socket
from collections.abc import Callable
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
import zenoh

from bridge.can.socket import BusError
from bridge.native import pace
from bridge.native.frame import DATA, Frame
from bridge.native.journal import Journal
from bridge.zenoh import session
from bridge.zenoh.channel import ZenohAttachment
from bridge.zenoh.options import ZenohOptions
from cosim.base.clock import sleep, stopwatch
from tests.bridge.can.bus_contract import (
    PATIENCE,
    BusContract,
    BusPeer,
    Pair,
    collect,
    keys,
    numbered,
    numbers,
)
from tests.bridge.zenoh.ends import IDENTIFIERS, both, endpoint, key, opened

BURST = 300


class Peer(BusPeer):
    """Another end, which closes its session."""

    def __init__(self, attachment: ZenohAttachment) -> None:
        super().__init__(attachment.bus)
        self._attachment = attachment

    def close(self) -> None:
        self._attachment.close()


def every_frame() -> list[Frame]:
    """All identifiers, lengths to the greatest; each content only once."""
    rng, lengths = np.random.default_rng(1), (1, 8, 24, 40, 64, 65, 128, DATA)
    return [Frame.of(i, rng.bytes(n)) for n in lengths for i in IDENTIFIERS]


class TestContract(BusContract):
    """What needs CAN is not asked for: formats, remote and error frames, filters.

    Nothing is dropped here (as in lock-step); what congestion drops otherwise nobody counts.
    """

    test_remote_frames_keep_the_length_they_ask_for = None
    test_filters_take_identifier_mask_and_format = None
    test_error_frames_change_the_state_and_are_logged_but_not_given = None
    test_health_says_what_was_on_the_bus = None
    frames = staticmethod(every_frame)
    logged = staticmethod(lambda: numbered(40))

    @pytest.fixture
    def connect(self, tmp_path: Path) -> Callable[..., object]:
        def connected(log: Journal, accepts: object) -> tuple[ZenohAttachment, Peer]:
            ours, theirs = both(endpoint(tmp_path), log, lockstep=True, lookahead=False)
            return ours, Peer(theirs)

        return connected

    def test_a_frame_nobody_publishes_is_counted(self, pair: Pair):
        pair.ours.bus.send(Frame.of(0x200))
        until(lambda: pair.health().send_failed == 1)
        assert "0x200" in pair.health().last_error

    def test_what_is_longer_than_a_frame_is_counted_and_does_no_harm(self, pair: Pair):
        attachment = pair.peer._attachment
        attachment.session.put(key("b", 0x100), bytes(DATA + 1))
        pair.peer.send([Frame.of(0x101, b"next")])
        assert keys(pair.take(2)) == [(0x101, 0, b"next")]
        assert (pair.health().oversized, pair.health().overruns) == (1, 0)


def until(reached: Callable[[], bool]) -> None:
    elapsed = stopwatch()
    while not reached():
        assert elapsed() < 3 * PATIENCE
        sleep(0.005)


def free_ports(n: int) -> list[int]:
    held = [socket.create_server(("127.0.0.1", 0)) for _ in range(n)]
    ports = [s.getsockname()[1] for s in held]
    for s in held:
        s.close()
    return ports


@pytest.mark.parametrize("protocol", ["tcp", "udp"])
def test_protocols(protocol: str):
    (port,) = free_ports(1)
    a, b = both(f"{protocol}/127.0.0.1:{port}")
    b.bus.send(Frame.of(0x100, b"x"))
    assert keys(collect(a.bus, 1)) == [(0x100, 0, b"x")]
    a.close()
    b.close()


def exchange(a: ZenohAttachment, b: ZenohAttachment, what: bytes) -> None:
    """One way and back, tried until it arrives."""
    for sender, receiver in ((a, b), (b, a)):
        elapsed, there = stopwatch(), False
        while not there:  # repetitions of what was said before may still come
            assert elapsed() < PATIENCE
            sender.bus.send(Frame.of(0x100, what))
            sleep(0.01)
            there = any(frame.payload == what for frame in receiver.bus.drain())


def test_what_congestion_leaves_is_in_order_and_once(tmp_path: Path):
    a, b = both(endpoint(tmp_path))
    for frame in numbered(BURST):
        b.bus.send(frame)
    found: list[Frame] = []
    until(lambda: bool(found.extend(a.bus.drain()) or found))
    sleep(0.2)
    order = numbers([*found, *a.bus.drain()])
    assert order and order == sorted(set(order))
    exchange(a, b, b"on it goes")
    a.close()
    b.close()


def test_a_late_joiner_is_found(tmp_path: Path):
    where = endpoint(tmp_path)
    second = opened("b", "a", connect=(where,))  # nobody listens there yet
    second.bus.send(Frame.of(0x100, b"unheard"))
    first = opened("a", "b", listen=(where,))
    first.wait_for_peers()
    second.wait_for_peers()
    exchange(first, second, b"hello")
    first.close()
    second.close()


def test_who_was_away_is_heard_again_without_a_restart_of_others():
    (port,) = free_ports(1)
    where = f"tcp/127.0.0.1:{port}"
    first, second = both(where)
    exchange(first, second, b"one")
    first.close()
    until(lambda: second.presence.there == frozenset())
    again = opened("a", "b", listen=(where,))
    again.wait_for_peers()
    exchange(again, second, b"two")
    health = second.health(pace.now())
    assert (health.restarts, health.peers_left) == (0, 1)
    assert "times a peer left" in health.sentence()
    again.close()
    second.close()


def test_a_peer_that_is_there_but_silent_is_heard_on_a_session_opened_anew(tmp_path: Path):
    """As after a partition that only one end has noticed: its token stays, nothing comes."""
    a, b = both(endpoint(tmp_path))
    try:
        a._silence.limit_ns = 200_000_000
        b.bus.send(Frame.of(IDENTIFIERS[0], b"before"))
        assert collect(a.bus, 1)[0].payload == b"before"
        first, elapsed = a.session, stopwatch()
        while a.session is first and elapsed() < PATIENCE:
            sleep(0.05)
        assert first.is_closed()
        b.wait_for_peers()
        b.bus.send(Frame.of(IDENTIFIERS[1], b"after"))
        assert collect(a.bus, 1)[0].payload == b"after"
        a.wait_for_peers()
        a.bus.send(Frame.of(IDENTIFIERS[2], b"back"))
        assert collect(b.bus, 1)[0].payload == b"back"
        health = a.health(pace.now())
        assert health.restarts >= 1 and "b silent: session opened anew" in health.last_error
    finally:
        a.close()
        b.close()


def test_a_peer_that_does_not_come_is_named(tmp_path: Path):
    alone = opened("a", "b", wait=0.05, listen=(endpoint(tmp_path),))
    with pytest.raises(BusError, match=r"not there: b; no node listens to test/a/component/m100"):
        alone.wait_for_peers()
    alone.close()


def test_an_address_in_use_is_said():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        where = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(BusError, match=f"bus net: Zenoh: .*{where}"):
            opened("a", "b", listen=(where,))


def test_closing_twice_is_closing_once(tmp_path: Path):
    a, b = both(endpoint(tmp_path))
    for attachment in (a, a, b):
        attachment.close()
    assert a.bus.struct.fd == -1


def test_what_was_sent_just_before_the_end_does_not_hold_it(tmp_path: Path):
    for _ in range(20):
        only = opened("a", "b", listen=(endpoint(tmp_path),))
        only.bus.send(Frame.of(IDENTIFIERS[0], bytes(8)))
        closing = Thread(target=only.close, daemon=True)
        closing.start()
        closing.join(PATIENCE)
        assert not closing.is_alive()


def test_what_has_to_be_connected_to_and_is_not_there(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(session.zenoh, "open", lambda config: sleep(PATIENCE))
    config = session.configure(ZenohOptions("test"), "a")
    with pytest.raises(BusError, match=r"net: Zenoh: no connection after 0.1 s \(listen"):
        session.open_session(config, "net", 0.1)


class Slow:
    """A session that waits for a peer that has gone, and then says so."""

    def __init__(self, seconds: float) -> None:
        self.seconds, self.asked = seconds, False

    def close(self) -> None:
        self.asked = True
        sleep(self.seconds)
        raise zenoh.ZError("close operation timed out!")


@pytest.mark.parametrize("seconds", [0.0, 30.0])
def test_a_session_that_does_not_close_holds_nobody(
    monkeypatch: pytest.MonkeyPatch, seconds: float
):
    monkeypatch.setattr(session, "CLOSING", 0.05)
    elapsed, slow = stopwatch(), Slow(seconds)
    session.close_session(slow)  # type: ignore[arg-type]
    assert slow.asked and elapsed() < PATIENCE
