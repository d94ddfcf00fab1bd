"""An ODrive axis on CANSimple.

Facts: identifier = node << 5 | command, little endian. Heartbeat (0x01) every `beat` ms: errors,
axis state, procedure result. Set_Axis_State (0x07): 1 idle, 8 closed loop; refused while an error
is there (procedure result 3, DISARMED). Set_Controller_Mode (0x0B), Set_Input_Torque (0x0E),
Clear_Errors (0x18), Get_Encoder_Estimates (0x09, turns) cyclic, Get_Torques (0x1C), Get_Version
(0x00), Get_Error (0x03), Estop (0x02). The watchdog, if a tool has enabled it, is fed by set-points
and expires in closed loop with error 0x01000000; the axis goes to idle.
"""

from __future__ import annotations

import struct
from math import pi

import can

from tests.strict_drives.core import EventLog, Joint, Setup, StrictDrive, following

IDLE, CLOSED_LOOP = 1, 8
SUCCESS, BUSY, DISARMED = 0, 1, 3
WATCHDOG, ESTOP, OVER_CURRENT = 0x1000000, 0x2000000, 0x400
TORQUE_MODE, PASSTHROUGH = 1, 1
TURN = 2 * pi


class ODrive(StrictDrive):
    """State: "idle" or "closed loop"."""

    def __init__(
        self, number: int, setup: Setup, joint: Joint, log: EventLog, torques: bool = False
    ) -> None:
        super().__init__(number, setup, joint, log)
        self.state, self.errors, self.reason, self.result = "idle", 0, 0, SUCCESS
        self.mode = (3, 1)  # position control, as it boots
        self.torques, self.on_at = torques, 0.0
        self.next_beat = self.next_estimate = 0.0

    @property
    def enabled(self) -> bool:
        return self.state == "closed loop"

    def receive(self, m: can.Message, now: float) -> None:
        node, command = m.arbitration_id >> 5, m.arbitration_id & 31
        if node != self.number:
            return
        if m.is_remote_frame:
            self._asked(command, now)
            return
        data = bytes(m.data)
        self.counts["frames"] += 1
        if command in (0x0C, 0x0D, 0x0E):
            self.fed(now, self.setup.timeout)
        if command == 0x0E and len(data) == 4:
            self._torque(struct.unpack("<f", data)[0], now)
        elif command == 0x07 and len(data) >= 4:
            self._state(struct.unpack("<I", data[:4])[0], now)
        elif command == 0x0B and len(data) == 8:
            self.mode = struct.unpack("<II", data)
            self.log(now, self.number, "mode", control=self.mode[0], input=self.mode[1])
        elif command == 0x18:
            self.log(now, self.number, "request", what="clear")
            self.errors, self.reason, self.result = 0, 0, SUCCESS
        elif command == 0x02:
            self.trip(ESTOP, now, "emergency stop")

    def _torque(self, tau: float, now: float) -> None:
        follows = self.mode == (TORQUE_MODE, PASSTHROUGH)
        self.commanded(tau if follows else 0.0, tau != 0.0, now)

    def _state(self, wanted: int, now: float) -> None:
        self.log(now, self.number, "request", what=wanted, state=self.state)
        if wanted == IDLE:
            self.on_at, self.result = 0.0, SUCCESS
            self.fed(now, self.setup.timeout)
            self.go("idle", now, "idle by the host")
        elif wanted == CLOSED_LOOP and not self.enabled:
            if self.errors or self.refuses:
                self.result = DISARMED
                self.counts["refused"] += 1
            elif self.setup.enable:
                self.on_at, self.result = now + self.setup.enable, BUSY
            else:
                self._close(now)

    def _close(self, now: float) -> None:
        self.on_at, self.result = 0.0, SUCCESS
        self.go("closed loop", now, "closed loop by the host")

    def tick(self, now: float) -> None:
        self.starving(now, self.setup.timeout)
        if self.on_at and now >= self.on_at:
            self._close(now)
        if now >= self.next_beat:
            self.next_beat = following(self.next_beat, self.setup.beat, now)
            self._beat(now)
        if now >= self.next_estimate:
            self.next_estimate = following(self.next_estimate, self.setup.period, now)
            self._estimates(now)
            if self.torques:
                self._asked(0x1C, now)

    def _identifier(self, command: int) -> int:
        return (self.other or self.number) << 5 | command

    def _beat(self, now: float) -> None:
        axis = CLOSED_LOOP if self.enabled else IDLE
        data = struct.pack("<IBBBB", self.errors, axis, self.result, 0, 0)
        self.send(now, self._identifier(0x01), data)

    def _estimates(self, now: float) -> None:
        q, dq = self.measured(now)
        data = struct.pack("<ff", q / TURN, dq / TURN)
        self.send(now, self._identifier(0x09), data, tells=False)

    def _asked(self, command: int, now: float) -> None:
        if command == 0x01:
            self._beat(now)
        elif command == 0x09:
            self._estimates(now)
        elif command == 0x1C:
            data = struct.pack("<ff", self.tau, self.applied)
            self.send(now, self._identifier(0x1C), data, tells=False)
        elif command == 0x00:
            data = bytes([2, 4, 4, 58, 0, 6, 11, 0])
            self.send(now, self._identifier(0x00), data, tells=False)
        elif command == 0x03:
            data = struct.pack("<II", self.errors, self.reason)
            self.send(now, self._identifier(0x03), data, tells=False)

    def expired(self, now: float) -> None:
        self.trip(WATCHDOG, now, "watchdog")

    def trip(self, code: int, now: float, why: str) -> None:
        self.errors = self.reason = code or OVER_CURRENT
        self.on_at, self.result = 0.0, DISARMED
        self.go("idle", now, f"{why}: error 0x{self.errors:X}")

    def reboot(self, now: float) -> None:
        self.errors, self.reason, self.result, self.mode = 0, 0, SUCCESS, (3, 1)
        self.on_at = 0.0
        self.go("idle", now, "boots")
