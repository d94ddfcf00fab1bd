"""Parts that strict drives share: log, joint, faults by schedule, and count of misdeeds."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from random import Random
from typing import TextIO

import can

#: Torque frames that a drive may still get after it has told that it is not enabled: that of the
#: sender's slot that had taken its frames from the bus before the drive told so.
UNDER_WAY = 1
LISTED = 20  # misdeeds that are logged one by one; all are counted


class EventLog:
    """JSON lines, written at once."""

    def __init__(self, file: TextIO) -> None:
        self.file = file

    def __call__(self, now: float, drive: int, event: str, **facts: object) -> None:
        line = {"t": round(now, 6), "drive": drive, "event": event, **facts}
        self.file.write(json.dumps(line) + "\n")
        self.file.flush()


@dataclass
class Joint:
    """J ddq = tau - damping dq - spring (q - rest), at the output of the drive. SI."""

    q: float = 0.0
    inertia: float = 1.0
    damping: float = 1.0
    spring: float = 0.0
    dq: float = 0.0
    at: float = 0.0
    rest: float = field(init=False)

    def __post_init__(self) -> None:
        self.rest = self.q

    def advance(self, now: float, tau: float) -> None:
        """Move on to `now` (s) under a torque, N.m; after a second of silence, at rest."""
        left = now - self.at
        self.at = now
        if not 0 < left <= 1.0:
            return
        steps = max(1, round(left / 5e-4))
        h = left / steps
        for _ in range(steps):
            force = tau - self.damping * self.dq - self.spring * (self.q - self.rest)
            self.dq += h * force / self.inertia
            self.q += h * self.dq


@dataclass
class Fault:
    """Something that happens `t` s after the drive was enabled for the `nth` time."""

    kind: str
    value: float
    t: float
    drives: tuple[int, ...] = ()  # (): all
    nth: int = 1

    @classmethod
    def parse(cls, text: str) -> Fault:
        """``KIND[=VALUE]@T[#NTH]`` for all drives, ``N:KIND[=VALUE]@T[#NTH]`` for one."""
        drive, colon, rest = text.rpartition(":")
        what, at, when = rest.partition("@")
        t, _, nth = when.partition("#")
        kind, _, value = what.partition("=")
        if not at or (colon and not drive.isdigit()):
            raise ValueError(f"fault {text!r}: expected [DRIVE:]KIND[=VALUE]@SECONDS")
        number = float(int(value, 0)) if value[:2].lower() == "0x" else float(value or 0)
        return cls(kind, number, float(t), (int(drive),) if colon else (), int(nth or 1))


@dataclass
class Setup:
    """Settings that the drives of a bus have in common. Times in s."""

    timeout: float = 0.0  # of the watchdog, as a tool has set it before; 0: off
    enable: float = 0.0  # from the request to the enabled power stage
    answer: float = 0.0  # to an answer, and up to `jitter` more
    jitter: float = 0.0
    boot: float = 0.3
    period: float = 0.004  # of what is sent without a request
    beat: float = 0.1  # of an ODrive's heartbeat
    host: int = 0  # node number of the host, where the protocol has one
    fd: bool = False


class StrictDrive:
    """A drive on a bus. Subclasses are the vendors' state machines.

    `receive` takes a frame and its time of arrival, `tick` is called when nothing waits to be read;
    both append to `out` what is sent, as (due, message). Enabled: the power stage is on and follows
    torques.
    """

    faults_known = ("trip", "reboot", "unplug", "late", "other", "old", "nothing", "wrong", "drop")

    def __init__(self, number: int, setup: Setup, joint: Joint, log: EventLog) -> None:
        self.number, self.setup, self.joint, self.log = number, setup, joint, log
        self.faults: list[Fault] = []
        self.out: list[tuple[float, can.Message]] = []
        self.random = Random(number)
        self.state = ""
        self.tau = 0.0  # commanded, N.m at the output
        self.silent_until = 0.0
        self.late, self.other, self.old = 0.0, 0, False
        self.sign, self.drops, self.refuses = 1.0, False, False
        self.first_enabled = self.fed_at = 0.0
        self.enabled_at: list[float] = []
        self.told: float | None = 0.0  # since when it has told that it is not enabled
        self.under_way = 0
        self.counts = dict.fromkeys(
            ("frames", "torques", "under_way", "off", "trips", "enabled", "refused"), 0
        )
        self.greatest_gap, self.watchdog = 0.0, 0.0
        self.kept: tuple[float, float] | None = None

    # ---- for subclasses ------------------------------------------------------------------------

    @property
    def enabled(self) -> bool:
        raise NotImplementedError

    def receive(self, m: can.Message, now: float) -> None:
        raise NotImplementedError

    def tick(self, now: float) -> None:
        raise NotImplementedError

    def trip(self, code: int, now: float, why: str) -> None:
        raise NotImplementedError

    def reboot(self, now: float) -> None:
        raise NotImplementedError

    # ---- events --------------------------------------------------------------------------------

    def go(self, state: str, now: float, why: str) -> None:
        """Change the state, and log it."""
        before, was = self.state, self.enabled
        self.state = state
        if state == before:
            return
        self.log(now, self.number, "state", before=before, after=state, why=why)
        if self.enabled and not was:
            self.counts["enabled"] += 1
            self.first_enabled = self.first_enabled or now
            self.enabled_at.append(now)
            self.fed_at, self.told, self.under_way = now, None, 0
            self.tau = 0.0
            if self.drops:
                self.trip(0, now, "drops at once")
        elif was and not self.enabled:
            self.tau = 0.0

    def fed(self, now: float, timeout: float) -> None:
        """A frame that the watchdog counts has arrived."""
        if self.enabled:
            gap, self.watchdog = now - self.fed_at, timeout
            if gap > self.greatest_gap:
                self.greatest_gap = gap
                if timeout and gap > timeout / 2:
                    self.log(now, self.number, "gap", seconds=round(gap, 6), watchdog=timeout)
            if timeout and gap > timeout:
                self.starve(now, gap)
        self.fed_at = now

    def starving(self, now: float, timeout: float) -> None:
        """Nothing waits to be read: has the watchdog run out?"""
        if self.enabled and timeout and now - self.fed_at > timeout:
            self.greatest_gap = max(self.greatest_gap, now - self.fed_at)
            self.watchdog = timeout
            self.starve(now, now - self.fed_at)

    def starve(self, now: float, gap: float) -> None:
        """The watchdog has run out."""
        self.counts["trips"] += 1
        self.log(now, self.number, "watchdog", seconds=round(gap, 6))
        self.expired(now)

    def expired(self, now: float) -> None:
        raise NotImplementedError

    def commanded(self, tau: float, nonzero: bool, now: float) -> None:
        """A torque was commanded, N.m; `nonzero`: more than the code nearest to 0."""
        self.joint.advance(now, self.applied)
        if self.enabled:
            self.tau = tau
            self.counts["torques"] += nonzero
            return
        if not nonzero:
            return
        if self.first_enabled and (self.told is None or now <= self.told):
            self.counts["under_way"] += 1
        elif self.first_enabled and self.under_way < UNDER_WAY:
            self.under_way += 1
            self.counts["under_way"] += 1
        else:
            self.counts["off"] += 1
            if self.counts["off"] <= LISTED:
                self.log(now, self.number, "torque while off", tau=round(tau, 4), state=self.state)

    @property
    def applied(self) -> float:
        """Torque of the motor, N.m."""
        return self.sign * self.tau if self.enabled else 0.0

    def measured(self, now: float) -> tuple[float, float]:
        """Position and velocity of now; of an encoder that stands still: as they were."""
        self.joint.advance(now, self.applied)
        if self.old:
            self.kept = self.kept or (self.joint.q, self.joint.dq)
            return self.kept
        return self.joint.q, self.joint.dq

    def send(self, now: float, identifier: int, data: bytes, *, tells: bool = True) -> None:
        """Send a frame; `tells`: it tells the state of the drive."""
        if now < self.silent_until:
            return
        fd = self.setup.fd
        m = can.Message(
            arbitration_id=identifier, is_extended_id=False, data=data, is_fd=fd, bitrate_switch=fd
        )
        wait = self.setup.answer + self.late + self.setup.jitter * self.random.random()
        self.out.append((now + wait, m))
        if tells and not self.enabled and self.told is None:
            self.told = now + wait

    # ---- faults --------------------------------------------------------------------------------

    def inject(self, now: float) -> None:
        """Faults that are due by now."""
        for fault in list(self.faults):
            immediate = fault.kind in ("drop", "refuse", "nothing", "wrong") and fault.t == 0
            times = self.enabled_at
            due = len(times) >= fault.nth and now >= times[fault.nth - 1] + fault.t
            if immediate or due:
                self.faults.remove(fault)
                self.log(now, self.number, "fault", kind=fault.kind, value=fault.value)
                self._inject(fault, now)

    def _inject(self, fault: Fault, now: float) -> None:
        match fault.kind:
            case "trip":
                self.trip(int(fault.value), now, "forced")
            case "reboot":
                self.silent_until = now + self.setup.boot
                self.joint.dq = 0.0
                self.reboot(now)
            case "unplug":
                self.silent_until = float("inf")
            case "late":
                self.late = fault.value * 1e-3
            case "other":
                self.other = int(fault.value)
            case "old":
                self.old = True
            case "nothing":
                self.sign = 0.0
            case "wrong":
                self.sign = -1.0
            case "drop":
                self.drops = True
            case "refuse":
                self.refuses = True
            case kind:
                raise ValueError(f"no fault {kind!r}")

    def hears(self, m: can.Message, now: float) -> bool:
        """True if the drive is on the bus, and its controller takes a frame of this format."""
        if now < self.silent_until or m.is_error_frame or m.is_extended_id:
            return False
        if not self.setup.fd:
            return not m.is_fd
        return not m.is_fd or bool(m.bitrate_switch)

    def summary(self, now: float) -> None:
        """The last line of a drive."""
        self.log(
            now, self.number, "end", state=self.state, gap=round(self.greatest_gap, 6),
            watchdog=self.watchdog, q=self.joint.q, **self.counts,
        )  # fmt: skip


def following(due: float, period: float, now: float) -> float:
    """The next time of something periodic: in step, or from now on where it has fallen behind."""
    return due + period if now - due < period else now + period


def numbers(text: str) -> Iterator[float]:
    """Numbers between commas."""
    yield from (float(word) for word in text.split(",") if word)
