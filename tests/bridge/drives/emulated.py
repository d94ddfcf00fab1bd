"""A drive that answers on a bus according to its profile, in place of a motor."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bridge.can.codec import Codec
from bridge.drives.model import Drive
from bridge.drives.profiles import DriveProfile, Joint, ProfileMessage
from bridge.native.message import Decoded
from bridge.native.safety import DriveRequest, DriveState, Status
from bridge.safety.limits import to_si
from cosim.base.errors import ScenarioError

Array = NDArray[np.float64]
Raws = list[tuple[int, bytes]]
#: Sequences of a profile, and what each asks a drive for.
REQUESTS = {
    "enable": DriveRequest.ENABLE,
    "disable": DriveRequest.DISABLE,
    "clear": DriveRequest.CLEAR,
}


@final
class EmulatedDrive:
    """A drive of a profile at node `node`: powered, ready, its time starting at 0.

    A frame is a torque command if the codec makes the same bytes of what it reads in it: a frame
    that asks for more than torque (a position gain, another mode) is none. Profiles without an
    enabling sequence are enabled from the start. `carried`: joints of a command that are used
    (default all). `h`: s, of the plant. `place`: for errors, which are ScenarioError.
    """

    def __init__(
        self,
        profile: DriveProfile,
        node: int,
        h: float,
        joint: Joint | None = None,
        carried: int | None = None,
        place: str = "drive",
        host: int | None = None,
    ) -> None:
        self.profile, self.node = profile, node
        self.joints = profile.joints if carried is None else carried
        if not 1 <= self.joints <= profile.joints:
            raise ScenarioError(f"{self.joints} joints, expected 1 to {profile.joints}", place)
        self.drive: Drive = profile.drive.build(self.joints, h, place)
        self._command = profile.codec(profile.command, node)
        self._feedback = [(part, profile.codec(part, node)) for part in profile.feedback]
        self._si = {
            signal: profile.conversion(part, signal, joint)
            for part in (profile.command, *profile.feedback)
            for signal in part.signals
        }
        self._tau, self._fresh = np.zeros(self.joints), False
        self._reached = dict.fromkeys(REQUESTS, 0)
        self._counter = 0
        self._beat = None if host is None else profile.host_heartbeat(host)
        self._beat_ns = -1  # of the last heartbeat; its time-out runs from the first one on
        self.refused = 0  # frames of a rehearsal that a real drive must not follow
        self.drive.request(DriveRequest.POWER_ON, 0)
        if not profile.sequences["enable"]:
            self.drive.request(DriveRequest.ENABLE, 0)

    def receive(self, identifier: int, data: bytes, now_ns: int) -> Raws:
        """Take a frame; what it is answered by at once (a register read back)."""
        for name in REQUESTS:
            self._follow(name, identifier, data, now_ns)
        if identifier == self._command.layout.identifier:
            self._take(data)
        if self._beat is not None and identifier == self._beat.layout.identifier:
            self._beat_ns = now_ns if len(data) == self._beat.layout.length else self._beat_ns
        return self._register(identifier, data)

    def step(self, q: ArrayLike, dq: ArrayLike, now_ns: int) -> tuple[Array, Raws]:
        """One tick: torque at the joints (joints,), N.m, and the frames that tell its state.

        q, dq (joints,): of the plant, rad, rad/s.
        """
        self._watch(now_ns)
        torque = self.drive.step(self._tau, self._fresh, dq, now_ns)
        self._fresh = False
        measured = self.drive.measure(q, dq)
        self._counter += 1
        values = {"tau": torque, "q": measured[0], "dq": measured[1]}
        return torque, [self._told(part, codec, values) for part, codec in self._feedback]

    @property
    def state(self) -> DriveState:
        """The state of its emulated drive."""
        return self.drive.state

    def _watch(self, now_ns: int) -> None:
        """A fault where the host was heard, and then not for as long as the watchdog waits."""
        timeout = self.drive.struct.watchdog.timeout_ns
        silent = self._beat_ns >= 0 and 0 < timeout < now_ns - self._beat_ns
        if silent and self.drive.state == DriveState.ENABLED:
            self.drive.struct.state = DriveState.FAULT
            self.drive.struct.faults += 1

    def _follow(self, name: str, identifier: int, data: bytes, now_ns: int) -> None:
        """One frame further in a sequence; the last one is the request, others change nothing."""
        frames = self.profile.frames(name, self.node)
        if not frames or frames[self._reached[name]] != (identifier, data):
            return
        self._reached[name] += 1
        if self._reached[name] == len(frames):
            self._reached[name] = 0
            self.drive.request(REQUESTS[name], now_ns)

    def _take(self, data: bytes) -> None:
        result, values, header = self._command.decode(data)
        if result is not Decoded.OK:
            return
        if self.profile.refuses_simulated and header.status & Status.SIMULATED:
            self.refused += 1
            return
        si = self._joint_values(self.profile.command.tau, values)
        self._tau, self._fresh = si[: self.joints], True

    def _joint_values(self, signals: Sequence[str], values: Iterable[float]) -> Array:
        pairs = zip(signals, values, strict=True)
        return np.array([self._si[s][0] * value + self._si[s][1] for s, value in pairs])

    def _told(
        self, part: ProfileMessage, codec: Codec, values: dict[str, Array]
    ) -> tuple[int, bytes]:
        sent = np.zeros(len(part.signals))
        for n, signal in enumerate(part.signals):
            port = next(name for name in values if signal in getattr(part, name))
            k = getattr(part, port).index(signal)
            gain, offset = self._si[signal]
            sent[n] = (values[port][k] - offset) / gain if k < self.joints else 0.0
        return codec.layout.identifier, codec.encode(sent, counter=self._counter)

    def _register(self, identifier: int, data: bytes) -> Raws:
        own, watchdog = self.profile.watchdog, self.drive.struct.watchdog
        unit_ns = round(to_si(own.unit, "s", "watchdog.unit") * 1e9)
        if own.write is not None:
            value = own.write.value(self.node, identifier, data)
            if value is not None:
                watchdog.timeout_ns = value * unit_ns
        if own.read is None or own.reply is None or own.read.at(self.node) != (identifier, data):
            return []
        return [own.reply.at(self.node, watchdog.timeout_ns // unit_ns)]
