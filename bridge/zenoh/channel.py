"""A Zenoh session between rings, so that a tick never waits for it.

Sending: a thread sleeps on a descriptor, empties the ring and puts. Receiving: Zenoh's threads call
back, which stamps the arrival and copies the sample into the ring; a tick runs no Python. In
lock-step with look-ahead all samples that wait are put as one payload a message, and what the ring
has no room for waits in the network.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import final

import zenoh

from bridge.can.health import BusHealth, bus_health
from bridge.can.socket import BusError
from bridge.deployment.zenoh_keys import Names
from bridge.native.bus import Bus
from bridge.native.frame import DATA, Frame, Ring
from bridge.native.journal import Journal
from bridge.native.mail import frame_reader, frame_writer, keep_thread
from bridge.zenoh import batches
from bridge.zenoh.lost_peers import LOOK, LostPeers
from bridge.zenoh.options import ZenohOptions
from bridge.zenoh.presence import Presence, wait_until_there
from bridge.zenoh.session import (
    CLOSING,
    close_session,
    configure,
    lease_time,
    listens_on,
    open_session,
)
from bridge.zenoh.socket_release import Linger, release
from bridge.zenoh.wakeup import Wake
from cosim.base.clock import monotonic_ns, sleep
from cosim.base.copies import replace

#: Free places that a receiver in lock-step leaves in its ring, and s between two looks for more.
ROOM, PAUSE = 256, 0.001
ENCODING = "application/octet-stream;cosim.sample.v1"


@dataclass(frozen=True, slots=True)
class ZenohTraffic:
    """Messages that one node sends and receives on a bus: frame numbers by key, and its peers.

    `heard_by_others`: keys it publishes that must have a subscriber before it is ready; `steady`:
    received keys that are published continuously, and their longest period, s.
    """

    node: str
    publishes: Mapping[str, int]
    hears: Mapping[str, int]
    peers: tuple[str, ...] = ()
    heard_by_others: tuple[str, ...] = ()
    steady: tuple[str, ...] = ()
    period: float = 0.0


@final
class ZenohAttachment:
    """A node's end of a Zenoh bus. Raises ScenarioError, BusError where it cannot be opened."""

    def __init__(
        self,
        name: str,
        names: Names,
        traffic: ZenohTraffic,
        options: ZenohOptions,
        *,
        number: int = 0,
        log: Journal | None = None,
        capacity: int = 8192,
        access: Mapping[str, object] | None = None,
    ) -> None:
        self._name, self.names, self.traffic, self._options = name, names, traffic, options
        self._config = configure(options, traffic.node, access)
        self._rx, self._tx = Ring(capacity), Ring(capacity)
        self._joins = options.lockstep and options.lookahead
        self._most = capacity - ROOM  # frames that wait in lock-step, about
        self._refused, self._restarts, self._left = 0, 0, 0
        self._oversized: dict[str, int] = {}  # by key
        self._fault = self._refusal = ""  # of the session, of a frame: the first one explains more
        self._silence = LostPeers(
            names.senders(traffic.steady),
            lease_time(self._config),
            period=traffic.period,
            udp=any(e.startswith("udp/") for e in listens_on(self._config)),
        )
        self._opening, self._ready = threading.Lock(), False
        self._declaring: list[Callable[[zenoh.Session], None]] = []
        self._stop = threading.Event()
        self._wake = Wake()
        self._open()
        self.bus = Bus.from_rings(self._rx, self._tx, number, log, wake=self._wake.inn)
        send = self._send_batches if self._joins else self._send
        self._threads = [threading.Thread(target=send, name=f"zenoh {name}", daemon=True)]
        if not options.lockstep:  # in which a lost sample is waited for in vain
            self._threads.append(threading.Thread(target=self._mend, daemon=True))
        for thread in self._threads:
            thread.start()

    def _open(self) -> None:
        """Open a session and declare everything on it."""
        within = self._options.wait if self._options.wait > 0 else None
        session = open_session(self._config, self._name, within)
        self._publishers = {
            number: control_publisher(
                session, key, self._options.reliability, block=self._options.lockstep
            )
            for key, number in self.traffic.publishes.items()
        }
        self.presence = Presence(session, self.names, self.traffic.node)
        self._subscribers = [
            session.declare_subscriber(
                key,
                self._receiver(key, number),
                allowed_origin=zenoh.Locality.REMOTE,
            )
            for key, number in self.traffic.hears.items()
        ]
        for declare in self._declaring:
            declare(session)
        self.presence.declare()
        if self._ready:
            self.presence.ready()
        self.session = session

    def declare(self, declare: Callable[[zenoh.Session], None]) -> None:
        """Declare something more on the session, and on one that takes its place."""
        self._declaring.append(declare)
        declare(self.session)

    def wait_for_peers(self) -> None:
        """Wait until every peer is present and the required keys have subscribers.

        Raises BusError after the option ``wait`` (s), with the missing peers.
        """
        if self._options.wait <= 0:
            return
        wait_until_there(self._missing, self._options.wait, self._stop.is_set)

    def _missing(self) -> list[str]:
        with self._opening:
            numbers = {key: self.traffic.publishes[key] for key in self.traffic.heard_by_others}
            heard = {key: self._publishers[number] for key, number in numbers.items()}
            return self.presence.missing(self.traffic.peers, heard)

    def ready(self) -> None:
        """Let it be seen that this node is ready for a start."""
        with self._opening:
            self._ready = True
            self.presence.ready()

    def health(self, now_ns: int) -> BusHealth:
        """State and counts at `now_ns` (monotonic); `restarts`: times the session was opened anew;
        `peers_left`: times the token of a peer went away.
        """
        health = bus_health(self.bus, self._name, now_ns)
        return replace(
            health,
            send_failed=health.send_failed + self._refused,
            restarts=self._restarts,
            peers_left=self._left + self.presence.lost,
            oversized=sum(self._oversized.values()),
            last_error=self._fault or self._refusal or health.last_error,
        )

    def close(self) -> None:
        """Send what waits, end the thread, close the session."""
        if self._stop.is_set():
            return
        self._stop.set()
        self._wake.set()
        for thread in self._threads:
            thread.join(None if thread is self._threads[0] else CLOSING)
        self.bus.struct.fd = -1
        self._wake.close()
        self._close()

    def _close(self) -> None:
        for subscriber in self._subscribers:
            subscriber.undeclare()  # type: ignore[no-untyped-call]
        self._subscribers = []
        close_session(self.session)

    def _mend(self) -> None:
        """Reopen the session if a peer is no longer received; see :class:`LostPeers`."""
        linger, most = Linger(), 0
        while not self._stop.wait(LOOK):
            linger.clear()
            links = len(self.session.info.links())
            most = max(most, links)  # with one link less, the other end may still use that one
            there = self.presence.there if links == most else frozenset()
            silent = self._silence.silent(there, monotonic_ns())
            if silent:
                self._fault = f"{', '.join(silent)} silent: session is opened anew"
                with self._opening:
                    self._left += self.presence.lost
                    self._close()
                    self._reopen()
                self._fault, most = f"{', '.join(silent)} silent: session opened anew", 0

    def _reopen(self) -> None:
        while not self._stop.is_set():
            try:
                self._open()
            except BusError as error:  # as long as the old one holds the address
                self._fault = str(error)
                release(listens_on(self._config))
                self._stop.wait(LOOK)
            else:
                self._restarts += 1
                if self._stop.is_set():  # nobody may wait for it any more
                    self._close()
                return

    def _receiver(self, key: str, number: int) -> zenoh.handlers.Callback[zenoh.Sample]:
        """The receiver of one key: called on Zenoh's threads, of which there may be several."""
        bring, counts = frame_writer(self._rx, number), self._silence.counts
        counts.setdefault(key, 0)
        self._oversized.setdefault(key, 0)

        def fits(length: int) -> bool:
            self._oversized[key] += length > DATA
            return length <= DATA

        def receive(sample: zenoh.Sample) -> None:
            keep_thread()
            counts[key] += 1
            if fits(len(sample.payload)):
                bring(sample.payload.to_bytes())

        def receive_all(message: zenoh.Sample) -> None:
            keep_thread()
            for sample in batches.samples_of(message):
                while len(self._rx) > self._most and not self._stop.is_set():
                    sleep(PAUSE)
                if fits(len(sample)):
                    bring(sample)

        called = receive_all if self._joins else receive
        return zenoh.handlers.Callback(called, indirect=False)

    def _send(self) -> None:
        """Frames of the ring, to their publishers; sleeps until `bus_send` wakes it."""
        frame = Frame()
        take = frame_reader(self._tx, self._wake.out, frame)
        while not self._stop.is_set():
            if take():  # one wake may be a frame's and the stop's
                self._put(frame)
        while self._tx.get(frame):  # sent before the stop
            self._put(frame)

    def _send_batches(self) -> None:
        """Send like :meth:`_send`; all frames of a message that wait, as one payload."""
        frame = Frame()
        take = frame_reader(self._tx, self._wake.out, frame)
        while not self._stop.is_set():
            if take():
                self._put_all(frame)
        if self._tx.get(frame):
            self._put_all(frame)

    def _put_all(self, frame: Frame) -> None:
        """This frame, and those that wait behind it."""
        waiting = {frame.id: [frame.payload]}
        while self._tx.get(frame):
            waiting.setdefault(frame.id, []).append(frame.payload)
        for number, samples in waiting.items():
            if len(samples) == 1:
                self._put_payload(number, samples[0])
            else:
                self._put_payload(number, batches.joined(samples), batches.ENCODING)

    def _put(self, frame: Frame) -> None:
        self._put_payload(frame.id, frame.payload)

    def _put_payload(
        self, number: int, payload: bytes, encoding: zenoh.Encoding | None = None
    ) -> None:
        try:
            self._publishers[number].put(payload, encoding=encoding)
        except (zenoh.ZError, KeyError) as error:
            self._refused += 1
            self._refusal = f"frame {number:#x}: {error}"


def control_publisher(
    session: zenoh.Session, key: str, reliability: str, *, block: bool = False
) -> zenoh.Publisher:
    """A publisher for control: immediate, high priority, dropped rather than late.

    `block`: late rather than dropped, for lock-step.
    """
    reliable = block or reliability == "reliable"
    congestion = zenoh.CongestionControl.BLOCK if block else zenoh.CongestionControl.DROP
    return session.declare_publisher(
        key,
        encoding=ENCODING,
        priority=zenoh.Priority.REAL_TIME,
        congestion_control=congestion,
        express=True,
        reliability=zenoh.Reliability.RELIABLE if reliable else zenoh.Reliability.BEST_EFFORT,
    )
