"""A Damiao drive in MIT mode.

Facts: one answer for each command; status nibble in the answer: 0 disabled, 1 enabled, 8 and 9
voltage, A over-current, B MOSFET hot, C coil hot, D communication lost, E overload.
Errors latch until FB (clear); FC (enable) is refused until then. Register 9, TIMEOUT, counts 50 us;
0 is off; it runs while enabled and each frame to the drive's identifier restarts it. Register 10 is
the mode, 1 is MIT. Codes are truncated, not rounded: 2047 is the torque nearest to 0.
"""

from __future__ import annotations

import struct

import can

from tests.strict_drives.core import EventLog, Joint, Setup, StrictDrive

RANGES = {"4310": (12.5, 30.0, 10.0), "4340": (12.5, 10.0, 28.0), "8009": (12.5, 45.0, 54.0)}
DISABLED, ENABLED, OVER_CURRENT, HOT, LOST = 0, 1, 0xA, 0xB, 0xD
REGISTERS, MASTER = 0x7FF, 0x10
TIMEOUT, MODE = 9, 10
CLASSIC_1M, FD_5M = 4, 9  # of register 35, the bit rate
FLOATS = (21, 22, 23)
UNIT = 50e-6  # s


class Damiao(StrictDrive):
    """State: "disabled", "enabled", or "error 0xD"."""

    def __init__(
        self, number: int, setup: Setup, joint: Joint, log: EventLog, kind: str = "4310"
    ) -> None:
        super().__init__(number, setup, joint, log)
        self.state, self.nibble, self.on_at = "disabled", DISABLED, 0.0
        self.ranges, self.hot = RANGES[kind], False
        self.told_ranges: dict[int, bytes] = {}  # registers that read otherwise
        self.told_number = number
        rate = FD_5M if setup.fd else CLASSIC_1M
        fixed = {7: MASTER + number, 8: number, 13: 4, 14: 5017, 15: 1000 + number, 35: rate}
        self.registers = {TIMEOUT: round(setup.timeout / UNIT), MODE: 1, **fixed}

    @property
    def enabled(self) -> bool:
        return self.state == "enabled"

    @property
    def timeout(self) -> float:
        return self.registers[TIMEOUT] * UNIT

    def _be(self, nibble: int, now: float, why: str) -> None:
        self.nibble = nibble
        names = {DISABLED: "disabled", ENABLED: "enabled"}
        self.go(names.get(nibble, f"error 0x{nibble:X}"), now, why)

    def receive(self, m: can.Message, now: float) -> None:
        data = bytes(m.data)
        if m.is_remote_frame:
            return
        if m.arbitration_id == REGISTERS and len(data) == 8:
            self._register(data, now)
        elif m.arbitration_id == self.number and len(data) == 8:
            self.fed(now, self.timeout)
            self._power(now)
            self.counts["frames"] += 1
            if data[:7] == b"\xff" * 7:
                self._special(data[7], now)
            else:
                self._torque(data, now)
            self._answer(now)

    def _special(self, what: int, now: float) -> None:
        self.log(now, self.number, "request", what=f"0x{what:X}", state=self.state)
        if what == 0xFC:
            if self.nibble != DISABLED or self.refuses:
                self.counts["refused"] += self.nibble != ENABLED
            elif self.setup.enable:
                self.on_at = now + self.setup.enable
            else:
                self._be(ENABLED, now, "enabled by the host")
        elif what == 0xFD:
            self.on_at = 0.0
            if self.nibble == ENABLED:
                self._be(DISABLED, now, "disabled by the host")
        elif what == 0xFB and self.nibble > ENABLED and not self.hot:
            self._be(DISABLED, now, "cleared by the host")

    def _torque(self, data: bytes, now: float) -> None:
        """An MIT command: torque is what kp = kd = 0 leaves."""
        code = (data[6] & 15) << 8 | data[7]
        gains = (data[3] & 15) << 8 | data[4], data[5] << 4 | data[6] >> 4
        tau = (code / 4095 * 2 - 1) * self.ranges[2]
        if self.registers[MODE] == 1:
            self.commanded(tau, code not in (2047, 2048) or any(gains), now)

    def _register(self, data: bytes, now: float) -> None:
        number, what, register = data[0] | data[1] << 8, data[2], data[3]
        if number != self.number:
            return
        if what == 0xCC:
            self._answer(now)
            return
        if what == 0x55 and register in self.registers and register < 13:
            self.registers[register] = struct.unpack("<I", data[4:8])[0]
            self.log(now, self.number, "written", register=register, value=self.registers[register])
        if what not in (0x33, 0x55):
            return
        if register in self.told_ranges:
            value = self.told_ranges[register]
        elif register in FLOATS:
            value = struct.pack("<f", self.ranges[register - FLOATS[0]])
        else:
            value = struct.pack("<I", self.registers.get(register, 0))
        self.send(now, self._master, bytes([*data[:2], what, register]) + value, tells=False)

    @property
    def _master(self) -> int:
        return MASTER + (self.other or self.number)

    def _answer(self, now: float) -> None:
        q, dq = self.measured(now)
        codes = [
            max(0, min(top, int((value + limit) / (2 * limit) * top)))
            for value, limit, top in zip(
                (q, dq, self.applied), self.ranges, (65535, 4095, 4095), strict=True
            )
        ]
        p, v, t = codes
        warm = 110 if self.hot else 30
        head = (self.other or self.told_number) & 15 | self.nibble << 4
        body = [head, p >> 8, p & 255, v >> 4, (v & 15) << 4 | t >> 8, t & 255, warm, warm]
        self.send(now, self._master, bytes(body))

    def tick(self, now: float) -> None:
        self.starving(now, self.timeout)
        self._power(now)

    def _power(self, now: float) -> None:
        """The power stage is on a while after the request."""
        if self.on_at and now >= self.on_at:
            self.on_at = 0.0
            self._be(ENABLED, now, "enabled by the host")

    def expired(self, now: float) -> None:
        self._be(LOST, now, "watchdog")

    def trip(self, code: int, now: float, why: str) -> None:
        self.hot = code in (HOT, 0xC)
        self._be(code or OVER_CURRENT, now, why)

    def reboot(self, now: float) -> None:
        self.registers[TIMEOUT], self.on_at = round(self.setup.timeout / UNIT), 0.0
        self._be(DISABLED, now, "boots")
