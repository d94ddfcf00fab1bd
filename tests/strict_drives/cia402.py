"""A CiA 402 drive in cyclic synchronous torque mode: NMT, PDO, SYNC, EMCY and heartbeats.

Facts: boots into pre-operational (0x700 + n: 00, then 7F every 100 ms); PDOs only in operational.
RPDO1 (0x200 + n): control word, mode, target torque in 1/1000 of the rated one. At each SYNC
TPDO1 (0x180 + n): status word, position, torque; TPDO2 (0x280 + n): velocity. The drive looks at
the control word once in a cycle of 1 ms: of several words in one cycle it sees the last. Each
transition takes a cycle; the power stage longer. A fault is left by a rising edge of bit 7 only.
The consumer heartbeat (0x1016) runs from the first heartbeat of the host; after it: EMCY 0x8130.
"""

from __future__ import annotations

import struct
from math import pi

import can

from tests.strict_drives.core import EventLog, Joint, Setup, StrictDrive, following

CYCLE, BEAT = 1e-3, 0.1
COUNTS, RATED = 65536, 1.0
OFF, READY, ON, ENABLED, FAULT = (
    "switch on disabled", "ready to switch on", "switched on", "operation enabled", "fault",
)  # fmt: skip
#: With voltage enabled (bit 4), remote (bit 9), and in torque mode "follows" (bit 12).
WORDS = {OFF: 0x0250, READY: 0x0231, ON: 0x0233, ENABLED: 0x1237, FAULT: 0x0218}
NAME = b"a strict CiA 402 drive"
PRE_OPERATIONAL, OPERATIONAL, STOPPED = 0x7F, 0x05, 0x04
LOST, OVER_CURRENT = 0x8130, 0x2310


class Cia402(StrictDrive):
    """State: the names of CiA 402, in small letters."""

    def __init__(self, number: int, setup: Setup, joint: Joint, log: EventLog) -> None:
        super().__init__(number, setup, joint, log)
        self.state, self.nmt = OFF, PRE_OPERATIONAL
        self.word = self.before = 0
        self.mode, self.host_at, self.on_at = 0, 0.0, 0.0
        self.next_cycle = self.next_beat = 0.0
        self.booted = False
        self.rest = b""  # of a text that is read in segments
        self.changed: dict[tuple[int, int], int] = {}  # objects with other values
        self.hidden: set[tuple[int, int]] = set()  # objects that it does not have

    @property
    def enabled(self) -> bool:
        return self.state == ENABLED

    def receive(self, m: can.Message, now: float) -> None:
        if m.is_remote_frame:
            return
        self._cycles(now)
        data, n = bytes(m.data), self.number
        if m.arbitration_id == 0x000 and len(data) == 2 and data[1] in (0, n):
            self._network(data[0], now)
        elif m.arbitration_id == 0x080:
            self._sync(now)
        elif m.arbitration_id == 0x200 + n:
            self._command(data, now)
        elif m.arbitration_id == 0x700 + self.setup.host and len(data) == 1:
            if self.host_at:
                self.fed(now, self.setup.timeout)
            self.host_at = self.fed_at = now
        elif m.arbitration_id == 0x600 + n and len(data) == 8:
            self._sdo(data, now)

    def _network(self, command: int, now: float) -> None:
        self.log(now, self.number, "nmt", command=command)
        if command in (0x81, 0x82):
            self.reboot(now)
        states = {0x01: OPERATIONAL, 0x02: STOPPED, 0x80: PRE_OPERATIONAL}
        self.nmt = states.get(command, self.nmt)
        if self.nmt != OPERATIONAL and self.enabled:
            self.trip(0x8100, now, "not operational any more")

    def _command(self, data: bytes, now: float) -> None:
        if self.nmt != OPERATIONAL:
            return
        if len(data) < 5:
            self._emergency(0x8210, now)
            return
        self.counts["frames"] += 1
        word, mode, torque = struct.unpack("<Hbh", data[:5])
        if word != self.word:
            self.log(now, self.number, "control word", word=f"0x{word:04X}", state=self.state)
        self.word, self.mode = word, mode
        tau = torque * 1e-3 * RATED
        self.commanded(tau if mode == 10 else 0.0, torque != 0, now)

    def _sync(self, now: float) -> None:
        if self.nmt != OPERATIONAL:
            return
        q, dq = self.measured(now)
        n, counts = self.other or self.number, COUNTS / (2 * pi)
        torque = round(self.applied / RATED * 1e3)
        torque = max(-32768, min(32767, torque))
        data = struct.pack("<Hih", WORDS[self.state], int(q * counts), torque)
        self.send(now, 0x180 + n, data)
        self.send(now, 0x280 + n, struct.pack("<i", int(dq * counts)), tells=False)

    def tick(self, now: float) -> None:
        self._cycles(now)
        if self.host_at and self.enabled:
            self.starving(now, self.setup.timeout)
        elif self.host_at and self.setup.timeout and now - self.host_at > self.setup.timeout:
            self.log(now, self.number, "no heartbeat", seconds=round(now - self.host_at, 6))
            self.host_at = 0.0
        if now >= self.next_beat:
            self.next_beat = following(self.next_beat, BEAT, now)
            state = self.nmt if self.booted else 0
            self.booted = True
            self.send(now, 0x700 + self.number, bytes([state]), tells=False)

    def _cycles(self, now: float) -> None:
        """The state machine, once in a cycle."""
        if now < self.next_cycle:
            return
        self.next_cycle = max(self.next_cycle + CYCLE, now)
        edge = self.word & 0x80 and not self.before & 0x80
        self.before = self.word
        after = self._next(bool(edge), now)
        if after != self.state:
            self.go(after, now, f"control word 0x{self.word:04X}")
            self.fed_at = self.host_at or now  # heartbeats count from before it was enabled

    def _next(self, edge: bool, now: float) -> str:
        low, state = self.word & 15, self.state
        if state == FAULT:
            return OFF if edge else FAULT
        if not low & 2 or (not low & 4 and state != OFF):
            return OFF  # disable voltage, or quick stop
        if low & 7 == 6:
            self.on_at = 0.0
            return READY
        if state == READY and low & 7 == 7:
            return ON
        if state == ON and low == 15 and self.nmt == OPERATIONAL and not self.refuses:
            self.on_at = self.on_at or now + self.setup.enable
            return ENABLED if now >= self.on_at else ON
        if state == ENABLED and low == 7:
            return ON
        return state

    def _emergency(self, code: int, now: float) -> None:
        self.send(now, 0x080 + self.number, struct.pack("<HB5x", code, 0x21), tells=False)

    def _objects(self) -> dict[tuple[int, int], tuple[int, int]]:
        """Objects that can be read: value and bytes. PDOs as a tool has mapped them before."""
        n, four = self.number, 4
        return {
            (0x1000, 0): (0x00020192, four), (0x1018, 1): (0x1A0, four), (0x1018, 2): (0x402, four),
            (0x1018, 3): (0x10002, four), (0x1016, 0): (1, 1), (0x1017, 0): (100, 2),
            (0x1016, 1): (self.setup.host << 16 | round(self.setup.timeout * 1e3), four),
            (0x6041, 0): (WORDS[self.state], 2), (0x6061, 0): (self.mode & 0xFF, 1),
            (0x6064, 0): (int(self.joint.q * COUNTS / (2 * pi)) & 0xFFFFFFFF, four),
            (0x6072, 0): (3000, 2), (0x6076, 0): (round(RATED * 1e3), four),
            (0x1400, 1): (0x200 + n, four), (0x1400, 2): (0xFF, 1), (0x1600, 0): (3, 1),
            (0x1600, 1): (0x60400010, four), (0x1600, 2): (0x60600008, four),
            (0x1600, 3): (0x60710010, four),
            (0x1800, 1): (0x180 + n, four), (0x1800, 2): (1, 1), (0x1A00, 0): (3, 1),
            (0x1A00, 1): (0x60410010, four), (0x1A00, 2): (0x60640020, four),
            (0x1A00, 3): (0x60770010, four),
            (0x1801, 1): (0x280 + n, four), (0x1801, 2): (1, 1), (0x1A01, 0): (1, 1),
            (0x1A01, 1): (0x606C0020, four),
        }  # fmt: skip

    def _sdo(self, data: bytes, now: float) -> None:
        """Uploads of what names the drive and tells its settings; texts in segments."""
        index, sub = struct.unpack("<HB", data[1:4])
        known = self._objects() | {key: (value, 4) for key, value in self.changed.items()}
        known = {key: value for key, value in known.items() if key not in self.hidden}
        if data[0] & 0xEF == 0x60 and self.rest:
            piece, self.rest = self.rest[:7], self.rest[7:]
            head = data[0] & 0x10 | (7 - len(piece)) << 1 | (not self.rest)
            answer = bytes([head]) + piece.ljust(7, b"\0")
        elif data[0] == 0x40 and (index, sub) == (0x1008, 0):
            self.rest = NAME
            answer = b"\x41" + data[1:4] + struct.pack("<I", len(NAME))
        elif data[0] == 0x40 and (index, sub) in known:
            value, size = known[index, sub]
            head = 0x43 | (4 - size) << 2
            answer = bytes([head]) + data[1:4] + value.to_bytes(4, "little")
        else:
            answer = b"\x80" + data[1:4] + struct.pack("<I", 0x06020000)
        self.send(now, 0x580 + self.number, answer, tells=False)

    def expired(self, now: float) -> None:
        self.trip(LOST, now, "watchdog")

    def trip(self, code: int, now: float, why: str) -> None:
        self._emergency(code or OVER_CURRENT, now)
        self.go(FAULT, now, f"{why}: 0x{code or OVER_CURRENT:X}")

    def reboot(self, now: float) -> None:
        self.nmt, self.word, self.before, self.mode = PRE_OPERATIONAL, 0, 0, 0
        self.host_at, self.on_at, self.booted = 0.0, 0.0, False
        self.go(OFF, now, "boots")
