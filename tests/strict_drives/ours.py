"""A drive of our own protocol on CAN FD, two joints, from ``docs/can.md``.

It sends STATE (q, dq) every 5 ms and HEARTBEAT every 50 ms, obeys NMT, ESTOP and EPOCH, and takes
torques from LINK of its controller: only with a right CRC and a new counter, never of a rehearsal,
and only while ACTIVE. It is armed by NMT or by a switch of its own (`armed`), and starts with START
or, armed, at the t = 0 of an EPOCH. Without a torque for its time-out it goes to FAULT (4), until
RESET; where its controller has told that it has ended, it stops. Data IDs: see the DBC file.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path

import can

from tests.strict_drives.core import EventLog, Joint, Setup, StrictDrive

DBC = Path(__file__).parents[2] / "configs" / "can" / "link_fd2.dbc"
INACTIVE, ACTIVE, FAULT, FINISHED = 1, 2, 4, 5
NAMES = {INACTIVE: "inactive", ACTIVE: "active", FAULT: "fault"}
WATCHDOG, ESTOP = 32, 2  # bits of the reasons
SIMULATED, ARMED = 128, 8
LSB = 2.0**-20
JOINTS, PERIOD, BEAT, PREVIEW = 2, 5e-3, 0.05, 0.02
TURN = 2**33 * 1e-5  # s, of the origin in EPOCH
LATER = 0.1  # s, from a START without EPOCH to t = 0


def crc(data: bytes, width: int, polynomial: int, start: int) -> int:
    """The CRC of bytes, most significant bit first."""
    top, found = 1 << (width - 1), start
    for byte in data:
        found ^= byte << (width - 8)
        for _ in range(8):
            found = (found << 1 ^ (polynomial if found & top else 0)) & (2 * top - 1)
    return found


def profile5(body: bytes, data_id: int) -> int:
    """AUTOSAR E2E profile 5: of all bytes after the CRC, and the data ID."""
    return crc(body + struct.pack("<H", data_id), 16, 0x1021, 0xFFFF)


def profile2(body: bytes, data_id: int) -> int:
    """AUTOSAR E2E profile 2: of all bytes after the CRC, and the data ID of this counter."""
    return crc(body + bytes([data_id]), 8, 0x2F, 0xFF) ^ 0xFF


def data_ids(identifier: int) -> bytes:
    """The list of data IDs of a message."""
    found = re.search(rf'"E2EDataId" BO_ {identifier} "(\w+)"', DBC.read_text("utf-8"))
    assert found, f"no data ID of {identifier} in {DBC}"
    return bytes.fromhex(found[1])


class Ours(StrictDrive):
    """State: "inactive", "active" or "fault". `host`: the number of the controller's node."""

    def __init__(
        self, number: int, setup: Setup, joint: Joint, log: EventLog, armed: bool = False
    ) -> None:
        super().__init__(number, setup, joint, log)
        second = Joint(joint.q, joint.inertia, joint.damping, joint.spring)
        self.joints = [joint, second]
        self.taus = [0.0] * JOINTS
        self.life, self.state, self.armed, self.reasons = INACTIVE, "inactive", armed, 0
        self.switch = armed
        self.t0 = self.next_beat = self.next_state = 0.0
        self.sample = self.beats = 0
        self.counter, self.led = -1, False  # led: its controller has been active
        self.ids = data_ids(0x700 + number)

    @property
    def enabled(self) -> bool:
        return self.state == "active"

    def _live(self, life: int, now: float, why: str) -> None:
        self.life = life
        self.taus = [0.0] * JOINTS
        self.go(NAMES[life], now, why)
        self.next_beat = now  # what has changed is told at once

    def receive(self, m: can.Message, now: float) -> None:
        data = bytes(m.data)
        if m.is_remote_frame:
            return
        if m.arbitration_id == 0x000 and len(data) == 2 and data[1] in (0, self.number):
            self._network(data[0], now)
        elif m.arbitration_id == 0x001:
            self.reasons |= ESTOP
            self._live(FAULT, now, "emergency stop")
        elif m.arbitration_id == 0x002 and len(data) == 8:
            self._epoch(data, now)
        elif m.arbitration_id == 0x3A0 + self.setup.host and m.is_fd and len(data) == 24:
            self._torque(data, now)

    def _network(self, command: int, now: float) -> None:
        self.log(now, self.number, "nmt", command=command)
        if command == 128 and self.life == INACTIVE:
            self.armed = True
        elif command == 1 and self.life == INACTIVE and self.armed:
            self.t0 = self.t0 if self.t0 > now - 1.0 else now + LATER
            self._start(now)
        elif command == 2:
            self.armed = self.switch
            self._live(INACTIVE if self.life == ACTIVE else self.life, now, "stopped")
        elif command == 129:
            self.armed, self.reasons = self.switch, 0
            self._live(INACTIVE, now, "reset")

    def _epoch(self, data: bytes, now: float) -> None:
        bits = int.from_bytes(data[2:8], "little")
        if bits >> 6 & 255 == 0:
            return  # HOST or DATE, which have no t = 0
        origin = (bits >> 15) * 1e-5
        t0 = origin + round((now - origin) / TURN) * TURN
        if abs(t0 - self.t0) > 1e-3:
            self.log(now, self.number, "epoch", t0=round(t0, 5))
        self.t0 = t0
        if self.armed and self.life == INACTIVE and not self.refuses:
            self._start(now)

    def _start(self, now: float) -> None:
        self.sample, self.next_state = 0, self.t0
        self._live(ACTIVE, now, "started")

    def _torque(self, data: bytes, now: float) -> None:
        identifier = 0x1000 + 0x3A0 + self.setup.host
        if struct.unpack("<H", data[:2])[0] != profile5(data[2:], identifier):
            self.counts["refused"] += 1
            return
        counter, status = data[2], data[3]
        if counter == self.counter or status & SIMULATED:
            self.counts["refused"] += 1
            return
        self.counter = counter
        raw = struct.unpack("<2i", data[8:16])
        self.fed(now, self.setup.timeout)
        self.counts["frames"] += 1
        self._move(now)
        self.commanded(raw[0] * LSB, any(raw), now)
        self.taus = [r * LSB for r in raw] if self.enabled else [0.0] * JOINTS
        sender = status & 7
        self.led |= sender == ACTIVE
        if self.led and self.enabled and sender in (INACTIVE, FINISHED):
            self.led = False
            self._live(INACTIVE, now, "its controller has ended")

    def _move(self, now: float) -> None:
        for joint, tau in zip(self.joints, self.taus, strict=True):
            joint.advance(now, self.sign * tau if self.enabled else 0.0)

    def tick(self, now: float) -> None:
        if self.t0 and now < self.t0:
            self.fed_at = now  # before t = 0 nothing is commanded, and nothing moves
        self.starving(now, self.setup.timeout)
        if now >= self.next_beat:
            self.next_beat = now + BEAT
            self._beat(now)
        if now >= self.next_state:
            self._tell(now)

    def _tell(self, now: float) -> None:
        """The state: samples of t0 + k 5 ms while active, the first one as a preview before."""
        running = self.enabled and now >= self.t0
        if running:
            self.sample = max(self.sample, int((now - self.t0) / PERIOD))
            self.next_state = self.t0 + (self.sample + 1) * PERIOD
        else:
            self.next_state = now + PREVIEW
        self._move(now)
        kept = [(j.q, j.dq) for j in self.joints]
        if self.old:
            self.kept_all = kept = getattr(self, "kept_all", kept)
        codes = [round(q / LSB) for q, _ in kept] + [round(dq / LSB) for _, dq in kept]
        stamp = round(self.sample * PERIOD * 1e6) & 0xFFFFFFFF
        number = self.other or self.number
        status = self.life | ARMED * self.armed
        body = struct.pack("<BBI4i", self.sample & 255, status, stamp, *codes)
        head = struct.pack("<H", profile5(body, 0x1000 + 0x4A0 + number))
        self.send(now, 0x4A0 + number, head + body)

    def _beat(self, now: float) -> None:
        self.beats = (self.beats + 1) & 15
        state = self.life | ARMED * self.armed | 1 << 4  # first boot
        body = struct.pack("<BBBI", self.beats, state, 0, self.reasons)
        head = bytes([profile2(body, self.ids[self.beats])])
        self.send(now, 0x700 + self.number, head + body, classic=True)

    def send(
        self, now: float, identifier: int, data: bytes, *, tells: bool = True, classic: bool = False
    ) -> None:
        super().send(now, identifier, data, tells=tells)
        if classic and self.out and self.out[-1][1].arbitration_id == identifier:
            self.out[-1][1].is_fd = self.out[-1][1].bitrate_switch = False

    def expired(self, now: float) -> None:
        self.reasons |= WATCHDOG
        self._live(FAULT, now, "watchdog")

    def trip(self, code: int, now: float, why: str) -> None:
        self.reasons |= code or WATCHDOG
        self._live(FAULT, now, f"{why}: 0x{code:X}")

    def reboot(self, now: float) -> None:
        self.armed, self.reasons, self.t0 = self.switch, 0, 0.0
        self._live(INACTIVE, now, "boots")
