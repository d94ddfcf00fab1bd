"""Drives on their buses, spoken to one frame at a time: for checks before a run, without a node.

A drive that was enabled is fed with torque 0 whenever :meth:`DriveLine.serve` waits, and disabled
when the line is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from math import inf
from typing import Self, final

from bridge.can import interface
from bridge.can.codec import Codec
from bridge.can.interface import Attachment
from bridge.deployment.drive_messages import command_codec, feedback_codec, profile_of
from bridge.deployment.drive_sequences import Foreign
from bridge.deployment.spec import Deployment
from bridge.drives.raw_frames import Raw
from bridge.drives.status import DriveTold
from bridge.native.frame import Frame
from bridge.native.message import Decoded
from bridge.node.buses import can_spec
from bridge.safety.limits import to_si
from cosim.base.clock import monotonic_ns, sleep

#: s between two looks at a bus, and between two SYNCs.
LOOK, SYNC = 0.002, 0.01
OPERATIONAL = 5


@dataclass
class LineDrive:
    """A drive of the deployment, and what it has told: the word of its state, its position (rad).

    `joint`: the signal that carries its torque; `host`: number of the node that commands it.
    """

    foreign: Foreign
    joint: str
    host: int
    command: Codec
    position: Codec | None
    limit: float = 0.0  # of the torque at the joint, N.m: of guard and profile the lower one
    status_id: int = -1  # identifier of the frame that tells its state
    beat: Codec | None = None  # heartbeat of its host
    sync: Codec | None = None
    word: int | None = None
    told_ns: int = 0
    q: float | None = None
    tau: float = 0.0  # N.m at the joint, while it is served
    served: bool = False
    asked: bool = False
    answers: list[Frame] = field(default_factory=list)

    @property
    def name(self) -> str:
        """``drive 1 on bus left``."""
        return f"drive {self.foreign.node} on bus {self.foreign.bus}"

    @property
    def state(self) -> DriveTold | None:
        """The state that it told last; None: nothing yet, or one that its profile does not have."""
        return None if self.word is None else self.foreign.profile.status.at(self.word)

    @property
    def says(self) -> str:
        """That state for people."""
        if self.word is None:
            return "nothing"
        return self.foreign.profile.status.describe(self.word)


def line_drives(d: Deployment) -> list[LineDrive]:
    """The drives that take torques by a profile, in the order of the deployment."""
    found: dict[tuple[str, int], LineDrive] = {}
    owner = {part: spec.number for spec in d.nodes.values() for part in spec.components}
    for name, spec in d.messages.items():
        torque = next((c for c in spec.carries if c.partition(".")[2].startswith("tau")), "")
        key = spec.bus, spec.drive
        if not spec.profile or not torque or key in found:
            continue
        profile, host = profile_of(d, name), owner.get(torque.partition(".")[0], 1)
        known, gear = bool(profile.status.message), spec.gear if profile.side == "motor" else 1.0
        found[key] = LineDrive(
            Foreign(spec.bus, profile, spec.drive),
            torque,
            host,
            command_codec(d, name),
            feedback_codec(d, name, "q"),
            _limit(d, torque, profile.limits.get("tau_max", inf) * gear),
            profile.status_layout(spec.drive).identifier if known else -1,
            profile.host_heartbeat(host),
            profile.host_sync(),
        )
    return list(found.values())


def _limit(d: Deployment, torque: str, most: float) -> float:
    """The limit of a torque (``component.tau[0]``) at the joint, N.m; `most`: of its drive."""
    component, _, index = torque.partition(".")
    found = [most]
    for name, node in d.nodes.items():
        limit = node.guard.tau_max if node.guard and component in node.components else None
        if limit is not None:
            at = int(index.partition("[")[2].rstrip("]") or 0)
            value = limit if isinstance(limit, str | float | int) else limit[at]
            found.append(to_si(value, "N.m", d.place("nodes", name, "guard", "tau_max")))
    return min(found) if min(found) < inf else 0.0


@final
class DriveLine:
    """The buses of these drives. Use as a context manager: the drives are disabled at its end."""

    def __init__(self, d: Deployment, drives: Sequence[LineDrive]) -> None:
        self.deployment, self.drives = d, drives
        self._ends: dict[str, Attachment] = {}
        self._stack = ExitStack()
        self._fed_ns = self._sync_ns = 0
        self.feeding = True  # heartbeats and torques 0

    def __enter__(self) -> Self:
        for bus in {drive.foreign.bus for drive in self.drives}:
            self._ends[bus] = interface.attach(can_spec(self.deployment, bus))
            self._stack.callback(self._ends[bus].close)
        return self

    def __exit__(self, *_: object) -> None:
        for drive in self.drives:
            self.disable(drive)
        self._stack.close()

    def send(self, drive: LineDrive, raw: Raw, value: int = 0) -> None:
        """A frame of the profile to a drive."""
        frame = drive.foreign.frame(*raw.at(drive.foreign.node, value))
        self._ends[drive.foreign.bus].bus.send(frame)

    def disable(self, drive: LineDrive) -> None:
        """Torque 0, then the frames that disable it."""
        drive.served, drive.tau = False, 0.0
        for frame in drive.foreign.frames("disable"):
            self._ends[drive.foreign.bus].bus.send(frame)

    def ask(self, drive: LineDrive) -> None:
        """Torque 0: some drives tell their state only as an answer."""
        self._torque(drive, 0.0)

    def raise_drive(self, drive: LineDrive, *sequences: str) -> str:
        """Send sequences step by step, each after its answer; why it did not follow, or ""."""
        profile = drive.foreign.profile
        for sequence in sequences:
            for raw in profile.sequences[sequence]:
                if why := self._step(drive, raw):
                    return f"{sequence}: {why}"
        drive.served = "enable" in sequences
        return ""

    def _step(self, drive: LineDrive, raw: Raw) -> str:
        if not raw.expect:
            self.send(drive, raw)
            self.serve(LOOK)
            return ""
        bits = drive.foreign.profile.status.bits(raw.expect)
        within, again = to_si(raw.within, "s", "within"), to_si(raw.again, "s", "again")
        sent_ns, end = 0, monotonic_ns() + round(within * 1e9)
        began = monotonic_ns()
        while monotonic_ns() < end:
            if monotonic_ns() - sent_ns > again * 1e9 > 0 or not sent_ns:
                self.send(drive, raw)
                sent_ns = monotonic_ns()
            self.serve(LOOK)
            if drive.told_ns >= began and self._is(drive, bits):
                return ""
        return f"it tells {drive.says}, expected {' or '.join(raw.expect)} within {within:g} s"

    @staticmethod
    def _is(drive: LineDrive, bits: int) -> bool:
        state, states = drive.state, drive.foreign.profile.status.states
        return state is not None and bool(bits >> states.index(state) & 1)

    def serve(self, seconds: float) -> None:
        """Feed the drives that are served, send SYNC, and take what they tell, for `seconds`, s."""
        end = monotonic_ns() + round(seconds * 1e9)
        while True:
            now = monotonic_ns()
            self._feed(now)
            self._synchronize(now)
            for bus, attached in self._ends.items():
                for frame in attached.bus.drain():
                    self._take(bus, frame, now)
            if now >= end:
                return
            sleep(LOOK)

    def _feed(self, now: int) -> None:
        """Torques and heartbeats that are due: at a quarter of the shortest watchdog."""
        shortest = min(d.foreign.profile.timeout for d in self.drives)
        if now - self._fed_ns < max(shortest / 4, LOOK) * 1e9:
            return
        self._fed_ns = now
        hosts = {(d.foreign.bus, d.host): d for d in self.drives}
        for (bus, _), drive in hosts.items():
            if self.feeding and drive.beat is not None:
                self._put(bus, drive, drive.beat, [OPERATIONAL])
        for drive in self.drives:
            if drive.served and self.feeding:
                self._torque(drive, drive.tau)

    def _synchronize(self, now: int) -> None:
        """SYNC, at which some drives tell their state, also where they are not fed."""
        if now - self._sync_ns < SYNC * 1e9:
            return
        self._sync_ns = now
        for bus, drive in {d.foreign.bus: d for d in self.drives}.items():
            if drive.sync is not None:
                self._put(bus, drive, drive.sync, [])

    def _torque(self, drive: LineDrive, tau: float) -> None:
        values = [tau] + [0.0] * (len(drive.command.signals) - 1)
        self._put(drive.foreign.bus, drive, drive.command, values)

    def _put(self, bus: str, drive: LineDrive, codec: Codec, values: list[float]) -> None:
        data = codec.encode(values)
        self._ends[bus].bus.send(drive.foreign.frame(codec.layout.identifier, data))

    def _take(self, bus: str, frame: Frame, now: int) -> None:
        word = int.from_bytes(frame.payload[:8], "little")
        for drive in self.drives:
            if drive.foreign.bus != bus:
                continue
            status, node = drive.foreign.profile.status, drive.foreign.node
            if frame.id == drive.status_id:
                state = status.at(word)
                other = state is not None and state.kind == "other"
                if not other and word & status.number == status.own(node):
                    drive.word, drive.told_ns = word, now
            if drive.position is not None and frame.id == drive.position.layout.identifier:
                result, values, _ = drive.position.decode(frame.payload)
                drive.q = float(values[0]) if result is Decoded.OK else drive.q
            if drive.asked:
                drive.answers.append(frame)


def answer(line: DriveLine, drive: LineDrive, raw: Raw, reply: Raw) -> int | None:
    """The value that a drive answers to a frame within half a second; None: it does not."""
    drive.answers.clear()
    drive.asked = True
    line.send(drive, raw)
    found: list[int] = []
    for _ in range(50):
        line.serve(0.01)
        values = (reply.value(drive.foreign.node, f.id, f.payload) for f in drive.answers)
        found = [value for value in values if value is not None]
        if found:
            break
    drive.asked = False
    return found[0] if found else None
