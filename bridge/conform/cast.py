"""The roles that the kit plays on the buses: all peers of the participant, and its supervisor.

A thread sends heartbeats, samples and SYNC when they are due. Rules change what a role does: it is
silent, in another state, or its samples pass a function that forges them.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, final

import numpy as np
from numpy.typing import NDArray

from bridge.can.codec import Codec
from bridge.conform.lateness import KitLateness
from bridge.deployment.carried import Carried
from bridge.deployment.services import Service
from bridge.deployment.system import System
from bridge.native import epoch as epochs
from bridge.native.enums import LifeState, Status
from bridge.native.frame import Frame
from bridge.native.message import Header, carries_state
from bridge.realtime.host_clock import host_clock
from cosim.base.clock import monotonic_ns, realtime_ns, realtime_offset_ns

#: ns: between two previews of a waiting node, and between two EPOCHs.
PREVIEW_NS, EPOCH_NS = 20_000_000, 100_000_000
_TICK_NS = 250_000
#: ns: samples that are later than any verdict bears are left out, as a kit that is too slow for its
#: messages would never catch up with them.
GIVEN_UP_NS = 2_000_000_000


class SendFrame(Protocol):
    """Sends a frame on a bus of the kit."""

    def __call__(self, bus: str, frame: Frame) -> None:
        """Send it."""


@dataclass(frozen=True, slots=True)
class Sample:
    """A sample that is due: its values, and the header that it has by right."""

    carried: Carried
    number: int
    status: int
    values: NDArray[np.float64]

    @property
    def codec(self) -> Codec:
        """The encoding of its message."""
        assert isinstance(self.carried.encoding, Codec)
        return self.carried.encoding

    def stamp_us(self, number: int) -> int:
        """The time stamp of the sample with this number, us."""
        return (number * self.carried.period_ns + self.carried.offset_ns) // 1000

    def frame(
        self,
        *,
        number: int | None = None,
        counter: int | None = None,
        t_us: int | None = None,
        values: NDArray[np.float64] | None = None,
        status: int | None = None,
    ) -> Frame:
        """The frame; everything that is not given is as it should be, or follows from `number`.

        `values`: (n,), in the units of the signals; `t_us`: us.
        """
        of = self.number if number is None else number
        header = Header(
            (of if counter is None else counter) & 0xFFFFFFFF,
            self.status if status is None else status,
            (self.stamp_us(of) if t_us is None else t_us) & 0xFFFFFFFF,
        )
        return self.codec.frame(self.values if values is None else values, header)


#: Frames that are sent in place of a sample.
Tamper = Callable[[Sample], Sequence[Frame]]


def copy_of(frame: Frame, data: bytes | None = None, **fields: int) -> Frame:
    """A frame with other data, flags or identifier."""
    payload = frame.payload if data is None else data
    made = Frame.of(
        fields.get("id", int(frame.id)), payload, fields.get("flags", int(frame.flags)), 0
    )
    made.length = fields.get("length", len(payload))
    return made


@dataclass(slots=True)
class PeerRole:
    """A node that the kit plays."""

    name: str
    number: int
    period_ns: int
    buses: tuple[str, ...]
    beats: bool = True
    state: LifeState | None = None
    """None: INACTIVE before t = 0, ACTIVE from then on."""
    boots: int = 1
    count: int = 0
    due_ns: int = 0
    damage: Callable[[Frame], Frame] | None = None

    def life(self, running: bool) -> LifeState:
        """The state in its heartbeats."""
        if self.state is not None:
            return self.state
        return LifeState.ACTIVE if running else LifeState.INACTIVE


@dataclass(slots=True)
class MessageRole:
    """A message that the participant receives."""

    carried: Carried
    values: NDArray[np.float64]
    sends: bool = True
    tamper: Tamper | None = None
    number: int = 0
    due_ns: int = 0
    last_ns: int = 0
    """The time at which the last unforged frame was sent."""


@dataclass(slots=True)
class SyncRole:
    """SYNC, if a peer sends it."""

    buses: tuple[str, ...]
    period_ns: int
    count: int = 0
    due_ns: int = 0


@dataclass(slots=True)
class EpochFields:
    """An EPOCH of the kit: t = 0 (monotonic, ns); what is None is that of this host.

    `other`: it has this host's number, and the identity of another.
    """

    origin_ns: int
    run: int | None = None
    host: int | None = None
    date_error_ns: int = 0
    dated: bool = True
    damage: Callable[[Frame], Frame] | None = None
    other: bool = False


@final
@dataclass
class Cast:
    """All roles, and the thread that plays them. `services`: by bus."""

    system: System
    node: str
    services: Mapping[str, Service]
    send: SendFrame
    lateness: KitLateness
    peers: dict[str, PeerRole] = field(default_factory=dict)
    messages: dict[str, MessageRole] = field(default_factory=dict)
    sync: SyncRole | None = None
    t0_ns: int | None = None
    silent: bool = True
    fault: str = ""
    lock: threading.RLock = field(default_factory=threading.RLock)
    _stop: threading.Event = field(default_factory=threading.Event)
    _thread: threading.Thread | None = None
    _epochs: int = 0

    def open(self) -> None:
        """Begin to play."""
        self._thread = threading.Thread(target=self._play, name="conform cast", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()

    # ---- what rules do -----------------------------------------------------------------------

    @property
    def running(self) -> bool:
        """True from t = 0 on."""
        return self.t0_ns is not None and monotonic_ns() >= self.t0_ns

    def begin_run(self, t0_ns: int | None) -> None:
        """Let all peers have this t = 0 (monotonic, ns); None: they wait for a start."""
        with self.lock:
            self.t0_ns = t0_ns
            now_ns = monotonic_ns()
            for role in self.messages.values():
                role.due_ns = now_ns
                role.number = 0
                if t0_ns is not None:
                    first = t0_ns + role.carried.offset_ns
                    role.number = max(0, -(-(now_ns - first) // role.carried.period_ns))
                    role.due_ns = first + role.number * role.carried.period_ns

    def restore(self) -> None:
        """All roles as they should be."""
        with self.lock:
            for peer in self.peers.values():
                peer.beats, peer.state, peer.damage = True, None, None
            for role in self.messages.values():
                role.sends, role.tamper = True, None

    def command(self, command: int, number: int, buses: Sequence[str] = ()) -> None:
        """Send NMT on all buses that have it."""
        self._say("nmt", [command, number], buses)

    def estop(self, buses: Sequence[str] = ()) -> None:
        """Send ESTOP once on all buses that have it."""
        self._say("estop", [0, 2], buses)

    def epoch(self, said: EpochFields) -> None:
        """Send EPOCH on all buses that have it, HOST and DATE before one without identity."""
        ours = host_clock()
        host = ours.number if said.host is None else said.host
        run = epochs.new_run(said.origin_ns) if said.run is None else said.run
        date = said.origin_ns + realtime_offset_ns() + said.date_error_ns
        for bus, service in self.services.items():
            codec = service.epoch
            if not isinstance(codec, Codec):
                continue
            room = len(codec.signals) > len(epochs.SIGNALS)
            strange = said.other or said.host is not None
            identity = (0.0, 0.0, 0.0, 1.0) if strange else ours.identity
            kept = ours.kept and not said.other
            values = epochs.values(run, host, kept, date, identity if room else ())
            now = realtime_ns() + said.date_error_ns
            dated = epochs.before(host, now, identity) if said.dated and not room else []
            for one in [*dated, values]:
                frame = codec.frame(one, Header(self._epochs, int(Status.SIMULATED), 0))
                self._epochs += 1
                self.send(bus, said.damage(frame) if said.damage else frame)

    def _say(self, what: str, values: Sequence[float], buses: Sequence[str]) -> None:
        for bus, service in self.services.items():
            codec = getattr(service, what)
            if isinstance(codec, Codec) and (not buses or bus in buses):
                self.send(bus, codec.frame(values, Header()))

    # ---- the thread --------------------------------------------------------------------------

    def _play(self) -> None:
        while not self._stop.is_set():
            try:
                with self.lock:
                    wake_ns = self._turn(monotonic_ns())
            except Exception as error:
                self.fault = self.fault or str(error) or type(error).__name__
                wake_ns = monotonic_ns() + 5_000_000
            left = max(_TICK_NS, wake_ns - monotonic_ns())  # rules wait for the lock
            self._stop.wait(min(left, 5_000_000) / 1e9)

    def _turn(self, now_ns: int) -> int:
        """Send what is due; the time of what is due next."""
        if self.silent:
            return now_ns + 5_000_000
        for peer in self.peers.values():
            if peer.due_ns <= now_ns:
                self._beat(peer, now_ns)
        for role in self.messages.values():
            while role.due_ns <= now_ns:
                self._tell(role, now_ns)
        if self.sync is not None and self.sync.due_ns <= now_ns:
            self._synchronize(self.sync, now_ns)
        due = [peer.due_ns for peer in self.peers.values()]
        due += [role.due_ns for role in self.messages.values()]
        due += [self.sync.due_ns] if self.sync is not None else []
        return max(min(due, default=now_ns + 5_000_000), now_ns + _TICK_NS)

    def _late(self, due_ns: int, now_ns: int, period_ns: int) -> int:
        """The next time; lateness counts where the role was due."""
        if due_ns:
            self.lateness.add(now_ns, now_ns - due_ns)
        following = due_ns + period_ns
        return following if following > now_ns else now_ns + period_ns

    def _beat(self, peer: PeerRole, now_ns: int) -> None:
        peer.due_ns = self._late(peer.due_ns, now_ns, peer.period_ns)
        if not peer.beats:
            return
        life = peer.life(self.running)
        values = [int(life), 0, peer.boots, int(life is LifeState.ACTIVE)]
        for bus in peer.buses:
            codec = self.services[bus].heartbeats.get(peer.number)
            if isinstance(codec, Codec):
                frame = codec.frame(values, Header(peer.count, int(Status.SIMULATED), 0))
                self.send(bus, peer.damage(frame) if peer.damage else frame)
        peer.count += 1

    def _tell(self, role: MessageRole, now_ns: int) -> None:
        carried = role.carried
        running = self.t0_ns is not None and now_ns >= self.t0_ns
        status = int(Status.SIMULATED)
        status |= int(LifeState.ACTIVE | Status.DEADMAN) if running else int(LifeState.INACTIVE)
        if running:
            late_ns = now_ns - role.due_ns
            self.lateness.add(now_ns, late_ns)
            missed = late_ns // carried.period_ns if late_ns > GIVEN_UP_NS else 0
            role.number += missed
            role.due_ns += missed * carried.period_ns
        sample = Sample(carried, role.number if running else 0, status, role.values)
        if running:
            role.number += 1
            role.due_ns += carried.period_ns
        else:
            role.due_ns = now_ns + PREVIEW_NS
            if self.t0_ns is not None:
                role.due_ns = min(role.due_ns, self.t0_ns + carried.offset_ns)
                if role.due_ns <= now_ns:
                    return
            if not carries_state(sample.codec.message):
                return  # receivers could not tell it from a sample
        if not role.sends:
            return
        if role.tamper is None:
            self.send(carried.bus, sample.frame())
            role.last_ns = now_ns
            return
        for frame in role.tamper(sample):
            self.send(carried.bus, frame)

    def _synchronize(self, sync: SyncRole, now_ns: int) -> None:
        sync.due_ns = self._late(sync.due_ns, now_ns, sync.period_ns)
        for bus in sync.buses:
            codec = self.services[bus].sync
            if isinstance(codec, Codec):
                self.send(bus, codec.frame([1 + sync.count % 240], Header()))
        sync.count += 1
