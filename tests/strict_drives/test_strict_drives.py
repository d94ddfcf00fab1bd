"""The strict drives themselves: state machines against the vendors' documents, in fake time."""

from __future__ import annotations

import ast
import io
import json
import struct
from pathlib import Path

import can
import pytest

from tests.strict_drives.cia402 import Cia402
from tests.strict_drives.core import EventLog, Fault, Joint, Setup, StrictDrive
from tests.strict_drives.damiao import Damiao
from tests.strict_drives.judged import DriveLog
from tests.strict_drives.odrive import ODrive
from tests.strict_drives.ours import Ours, crc, profile2

HERE = Path(__file__).parent
JUDGES = ("__init__", "__main__", "bench", "cia402", "core", "damiao", "judged", "odrive", "ours")


class Line:
    """A drive, its time in ms, and what it has said."""

    def __init__(self, kind: type[StrictDrive], number: int, setup: Setup, *more: object) -> None:
        self.file = io.StringIO()
        self.drive = kind(number, setup, Joint(q=0.5), EventLog(self.file), *more)
        self.now = 1000.0

    def at(self, ms: float) -> None:
        """Let time pass; the drive looks at its clock every 0.5 ms."""
        until = 1000.0 + ms * 1e-3
        while self.now < until - 1e-9:
            self.now = min(until, self.now + 5e-4)
            self.drive.inject(self.now)
            self.drive.tick(self.now)

    def send(self, ms: float, identifier: int, data: bytes, fd: bool = False) -> list[can.Message]:
        """A frame at a time; what is answered."""
        self.at(ms)
        self.drive.out.clear()
        m = can.Message(arbitration_id=identifier, is_extended_id=False, data=data, is_fd=fd)
        if self.drive.hears(m, self.now):
            self.drive.receive(m, self.now)
        return [message for _, message in self.drive.out]

    @property
    def log(self) -> DriveLog:
        self.drive.summary(self.now)
        return DriveLog("one", tuple(map(json.loads, self.file.getvalue().splitlines())))


def special(last: int) -> bytes:
    return b"\xff" * 7 + bytes([last])


def mit(code: int) -> bytes:
    return bytes([0x80, 0, 0x80, 0, 0, 0, code >> 8, code & 255])


def test_nothing_of_the_project_is_imported() -> None:
    for name in JUDGES:
        tree = ast.parse((HERE / f"{name}.py").read_text("utf-8"))
        names = {n.name for x in ast.walk(tree) if isinstance(x, ast.Import) for n in x.names}
        names |= {x.module or "" for x in ast.walk(tree) if isinstance(x, ast.ImportFrom)}
        assert not {n for n in names if n.split(".")[0] in ("cosim", "bridge", "fmus")}, name


def test_the_checks_are_autosars() -> None:
    assert crc(b"123456789", 16, 0x1021, 0xFFFF) == 0x29B1
    assert profile2(b"12345678", ord("9")) == 0xDF


# ---- Damiao ------------------------------------------------------------------------------------


def damiao(timeout: float = 0.05) -> Line:
    return Line(Damiao, 1, Setup(timeout=timeout))


def test_damiao_tells_its_state_and_moves_only_when_enabled() -> None:
    line = damiao()
    (answer,) = line.send(0, 1, mit(3000))
    assert answer.arbitration_id == 0x11 and answer.data[0] == 0x01
    (answer,) = line.send(1, 1, special(0xFC))
    assert answer.data[0] == 0x11
    for k in range(2, 40):
        line.send(k, 1, mit(3000))
    assert line.drive.joint.dq > 0.1
    end = line.log.end
    assert (end["off"], end["torques"]) == (1, 38)


def test_damiao_trips_and_refuses_until_it_is_cleared() -> None:
    line = damiao()
    line.send(0, 1, special(0xFC))
    (answer,) = line.send(51, 1, mit(2047))
    assert answer.data[0] == 0xD1
    assert line.send(52, 1, special(0xFC))[0].data[0] == 0xD1
    assert line.send(53, 1, special(0xFD))[0].data[0] == 0xD1
    assert line.send(54, 1, special(0xFB))[0].data[0] == 0x01
    assert line.send(55, 1, special(0xFC))[0].data[0] == 0x11
    assert line.log.end["trips"] == 1 and line.log.states[:2] == ["enabled", "error 0xD"]


def test_damiao_registers_hold_the_watchdog_and_the_ranges() -> None:
    line = damiao(0.0)
    line.send(0, 0x7FF, bytes([1, 0, 0x55, 9]) + struct.pack("<I", 2000))
    (answer,) = line.send(1, 0x7FF, bytes([1, 0, 0x33, 9, 0, 0, 0, 0]))
    assert bytes(answer.data) == bytes([1, 0, 0x33, 9]) + struct.pack("<I", 2000)
    (answer,) = line.send(2, 0x7FF, bytes([1, 0, 0x33, 23, 0, 0, 0, 0]))
    assert struct.unpack("<f", answer.data[4:]) == (10.0,)
    line.send(3, 1, special(0xFC))
    line.at(102)
    assert line.drive.enabled
    line.at(105)
    assert line.drive.state == "error 0xD"


def test_a_hot_damiao_is_not_cleared() -> None:
    line = damiao()
    line.send(0, 1, special(0xFC))
    line.drive.trip(0xB, line.now, "forced")
    assert line.send(1, 1, special(0xFB))[0].data[0] == 0xB1


def test_frames_of_the_other_format_are_not_heard() -> None:
    assert damiao().send(0, 1, special(0xFC), fd=True) == []
    line = Line(Damiao, 1, Setup(timeout=0.05, fd=True))
    assert line.send(0, 1, special(0xFC), fd=True) == []  # without bit rate switch
    assert line.send(1, 1, special(0xFC))[0].is_fd


# ---- what counts -------------------------------------------------------------------------------


def test_frames_under_way_are_excepted_and_no_more() -> None:
    """Told by the answer at 10 ms: one more torque is that of the slot which had begun."""
    line = damiao()
    line.send(0, 1, special(0xFC))
    line.drive.trip(0xA, line.now, "forced")
    line.send(5, 1, mit(3000))  # its answer tells
    assert line.log.end["off"] == 0
    line.send(10, 1, mit(3000))
    assert (line.log.end["under_way"], line.log.end["off"]) == (2, 0)
    line.send(15, 1, mit(3000))
    line.send(20, 1, mit(2047))
    line.send(25, 1, mit(2048))
    assert (line.log.end["under_way"], line.log.end["off"]) == (2, 1)
    assert "1 torques while not enabled" in next(line.log.misdeeds())


def test_a_gap_above_half_of_the_watchdog_is_a_misdeed() -> None:
    line = damiao()
    line.send(0, 1, special(0xFC))
    line.send(24, 1, mit(2047))
    line.send(30, 1, special(0xFD))
    line.at(100)
    assert not list(line.log.misdeeds())
    line.send(110, 1, special(0xFC))
    line.send(136, 1, special(0xFD))
    assert "unfed for 0.026 s" in next(line.log.misdeeds())


@pytest.mark.parametrize(
    ("text", "kind", "value", "drives"),
    [
        ("trip=0xD@2", "trip", 13.0, ()),
        ("3:late=40@0.5", "late", 40.0, (3,)),
        ("old@1", "old", 0.0, ()),
    ],
)
def test_faults_by_schedule(text: str, kind: str, value: float, drives: tuple[int, ...]) -> None:
    found = Fault.parse(text)
    assert (found.kind, found.value, found.drives) == (kind, value, drives)


def test_a_fault_without_a_time_is_refused() -> None:
    with pytest.raises(ValueError, match="expected"):
        Fault.parse("trip=1")


def test_a_drive_that_reboots_is_silent_and_off() -> None:
    line = damiao()
    line.drive.faults = [Fault.parse("reboot@0.01")]
    line.send(0, 1, special(0xFC))
    for ms in (5, 8, *range(15, 300, 5)):
        assert bool(line.send(ms, 1, mit(2047))) == (ms < 10)
    (answer,) = line.send(320, 1, mit(2047))
    assert answer.data[0] == 0x01


# ---- ODrive ------------------------------------------------------------------------------------


def odrive(timeout: float = 0.05) -> Line:
    return Line(ODrive, 2, Setup(timeout=timeout, period=0.01))


def torque(value: float) -> bytes:
    return struct.pack("<f", value)


def test_odrive_needs_torque_mode_and_closed_loop() -> None:
    line = odrive()
    line.send(0, 2 << 5 | 7, struct.pack("<I", 8))
    line.send(1, 2 << 5 | 0xB, struct.pack("<II", 1, 1))
    line.send(2, 2 << 5 | 0xE, torque(1.0))
    line.send(12, 2 << 5 | 0xE, torque(1.0))
    assert line.drive.joint.dq > 0
    line.at(70)
    assert line.drive.state == "idle" and line.drive.errors == 0x1000000
    line.send(71, 2 << 5 | 7, struct.pack("<I", 8))
    assert line.drive.state == "idle" and line.drive.result == 3
    line.send(72, 2 << 5 | 0x18, b"\0")
    line.send(73, 2 << 5 | 7, struct.pack("<I", 8))
    assert line.drive.state == "closed loop"


def test_odrive_beats_every_100_ms_and_estimates_by_itself() -> None:
    line = odrive()
    line.at(205)
    kinds = [m.arbitration_id & 31 for _, m in line.drive.out]
    assert kinds.count(1) == 3 and 19 <= kinds.count(9) <= 22
    beat = next(m for _, m in line.drive.out if m.arbitration_id & 31 == 1)
    assert struct.unpack("<IBBBB", beat.data) == (0, 1, 0, 0, 0)


def test_odrive_in_position_mode_follows_no_torque() -> None:
    line = odrive()
    line.send(0, 2 << 5 | 0xE, torque(0.0))
    line.send(1, 2 << 5 | 7, struct.pack("<I", 8))
    line.send(2, 2 << 5 | 0xE, torque(5.0))
    assert line.drive.applied == 0.0 and line.log.end["off"] == 0


# ---- CiA 402 -----------------------------------------------------------------------------------


def cia() -> Line:
    return Line(Cia402, 11, Setup(timeout=0.05, host=2))


def word(value: int, per_mille: int = 0) -> bytes:
    return struct.pack("<Hbh", value, 10, per_mille)


def status(line: Line, ms: float) -> int:
    first = line.send(ms, 0x80, b"")[0]
    return struct.unpack("<H", first.data[:2])[0]


def test_cia402_follows_word_by_word_and_no_faster() -> None:
    line = cia()
    assert line.send(0, 0x80, b"") == []  # no PDO before it is operational
    line.send(1, 0x000, b"\x01\x0b")
    for value in (0x06, 0x07, 0x0F):
        line.send(2, 0x20B, word(value))
    line.at(12)
    assert status(line, 12) & 0x6F == 0x40  # of three words in a cycle it saw the last
    for k, (value, expected) in enumerate(((0x06, 0x21), (0x07, 0x23), (0x0F, 0x27))):
        line.send(20 + 5 * k, 0x20B, word(value))
        assert status(line, 24 + 5 * k) & 0x6F == expected


def test_cia402_loses_its_host_and_needs_an_edge() -> None:
    line = cia()
    line.send(0, 0x000, b"\x01\x00")
    line.send(1, 0x702, b"\x05")
    for k, value in enumerate((0x06, 0x07, 0x0F)):
        line.send(2 + 3 * k, 0x20B, word(value))
    line.send(20, 0x20B, word(0x0F, 500))
    assert line.drive.enabled and line.drive.applied == pytest.approx(0.5)
    line.at(60)
    codes = [m.data[:2] for _, m in line.drive.out if m.arbitration_id == 0x08B]
    assert codes == [struct.pack("<H", 0x8130)]
    assert status(line, 61) & 0x4F == 0x08
    line.send(62, 0x20B, word(0x06))
    assert status(line, 65) & 0x4F == 0x08
    line.send(66, 0x20B, word(0x80))
    assert status(line, 69) & 0x4F == 0x40


# ---- ours --------------------------------------------------------------------------------------


def epoch(host: int, origin: float, kept: int = 0) -> bytes:
    """An EPOCH without a right CRC, which the drive does not look at; `origin` in s."""
    bits = 1 | host << 6 | kept << 14 | round(origin * 1e5) << 15
    return bytes(2) + bits.to_bytes(6, "little")


@pytest.mark.parametrize("identity", [0, 1, 2**31, 2**32 - 1])
def test_our_drive_starts_at_an_epoch_and_at_no_host_or_date(identity: int) -> None:
    """The origin of a HOST is any number of 32 bits: hours before or behind the present date."""
    line = Line(Ours, 1, Setup(timeout=0.1, host=2, fd=True))
    line.send(1, 0x000, b"\x80\x01")
    line.send(2, 0x002, epoch(0, identity * 1e-5, kept=1))
    line.send(3, 0x002, epoch(0, 1000.003))
    assert not line.drive.enabled and not line.drive.t0
    line.send(4, 0x002, epoch(77, 1000.05))
    assert line.drive.enabled and line.drive.t0 == pytest.approx(1000.05)
    line.at(59)
    stamps = [m.data[4:8] for _, m in line.drive.out if m.arbitration_id == 0x4A1]
    assert stamps[-1] == struct.pack("<I", 5000)


def test_our_drive_takes_torques_only_when_started_and_fed() -> None:
    from tests.strict_drives.ours import profile5

    line = Line(Ours, 1, Setup(timeout=0.1, host=2, fd=True))

    def link(counter: int, raw: int, status: int = 0) -> bytes:
        body = struct.pack("<BBI4i", counter, status, 0, raw, 0, 0, 0)
        return struct.pack("<H", profile5(body, 0x1000 + 0x3A2)) + body

    def send(ms: float, data: bytes) -> None:
        line.at(ms)
        m = can.Message(arbitration_id=0x3A2, is_extended_id=False, data=data, is_fd=True,
                        bitrate_switch=True)  # fmt: skip
        line.drive.receive(m, line.now)

    send(1, link(1, 1 << 20))
    line.send(2, 0x000, b"\x80\x01")
    line.send(3, 0x000, b"\x01\x01")
    assert line.drive.enabled
    send(110, link(2, 1 << 20))
    send(111, link(2, 1 << 20))  # repeated
    send(112, link(3, 1 << 20, 128))  # of a rehearsal
    send(113, b"\0" + link(4, 1 << 20)[1:])  # damaged
    end = line.log.end
    assert (end["off"], end["torques"], end["refused"]) == (1, 1, 3)
    line.at(230)
    assert line.drive.state == "fault" and line.drive.reasons == 32
