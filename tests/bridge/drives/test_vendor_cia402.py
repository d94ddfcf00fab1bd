"""A CiA 402 drive in C: NMT, PDOs, emergencies, cycles."""

from __future__ import annotations

import struct

import pytest

from bridge.native.vendor import VendorFault as Fault
from bridge.native.vendor import VendorKind as Kind
from tests.bridge.drives.vendors import MS, Drive, N, cia_enabled, rpdo


def test_a_cia_402_drive_boots_up_and_answers_sync_only_when_operational() -> None:
    drive = Drive(Kind.CIA402)
    drive.fault(Fault.REBOOT)
    drive.at(50 * MS)
    assert [(s.id, s.data) for s in drive.sent()] == [(0x700 + N, b"\0")]
    drive.hears(0x80, b"")
    assert drive.says() == []
    drive.hears(0, b"\x01\0")
    drive.hears(0x80, b"")
    assert [s.id for s in drive.says()] == [0x180 + N, 0x280 + N]


def test_control_words_within_a_cycle_are_one() -> None:
    """All three of an enabling at once leave the drive where it was."""
    drive = Drive(Kind.CIA402)
    drive.hears(0, bytes([1, N]))
    for word in (0x80, 0x06, 0x07, 0x0F):
        drive.hears(0x200 + N, rpdo(word))
    drive.at(10 * MS)
    assert drive.v.state == 1


def test_a_cia_402_drive_goes_up_a_state_a_cycle() -> None:
    drive, seen = Drive(Kind.CIA402), []
    drive.hears(0, bytes([1, N]))
    drive.hears(0x200 + N, rpdo(0x06))
    for k in range(1, 5):
        drive.at(k * MS)
        drive.hears(0x200 + N, rpdo(0x0F))
        seen.append(drive.v.state)
    assert seen == [2, 3, 4, 4]


def test_a_lost_host_is_an_emergency_and_a_fault_that_ends_operational() -> None:
    drive = cia_enabled()
    drive.sent()
    drive.at(30 * MS)
    (said,) = drive.sent()
    assert (said.id, said.data[:3]) == (0x80 + N, struct.pack("<HB", 0x8130, 0x11))
    assert (drive.v.state, drive.v.network, drive.v.acts) == (7, 127, 0)
    drive.hears(0x200 + N, rpdo(0x80))
    drive.at(33 * MS)
    assert drive.v.state == 7  # PDOs are not heard
    drive.hears(0, bytes([1, N]))
    drive.hears(0x200 + N, rpdo(0x80))
    drive.at(36 * MS)
    assert drive.v.state == 1
    assert [s.data[:3] for s in drive.sent()] == [b"\0\0\0"]


@pytest.mark.parametrize("word", [0x02, 0x0B])
def test_a_quick_stop_takes_its_time_and_no_torque_acts(word: int) -> None:
    drive = cia_enabled(host=0)
    drive.hears(0x200 + N, rpdo(word, 100))
    drive.at(drive.t + 2 * MS)
    assert (drive.v.state, drive.v.acts) == (5, 0)
    drive.at(drive.t + 21 * MS)
    assert drive.v.state == 1


def test_a_torque_is_in_thousandths_and_acts_in_its_mode_only() -> None:
    drive = cia_enabled(rated=2.0)
    drive.hears(0x200 + N, rpdo(0x0F, -250))
    assert (drive.v.tau, drive.v.acts) == (-0.5, 1)
    drive.hears(0x200 + N, rpdo(0x0F, -250, mode=8))
    assert drive.v.acts == 0


@pytest.mark.parametrize(("data", "code"), [(b"\x06\0", 0x8210), (rpdo(0x06) + b"\0", 0x8220)])
def test_a_pdo_of_another_length_is_an_emergency(data: bytes, code: int) -> None:
    drive = Drive(Kind.CIA402)
    drive.hears(0, bytes([1, N]))
    drive.hears(0x200 + N, data)
    assert [struct.unpack("<H", s.data[:2])[0] for s in drive.sent()] == [code]
    drive.at(2 * MS)
    assert drive.v.state == (2 if code == 0x8220 else 1)


def test_stopped_by_nmt_a_drive_is_off() -> None:
    drive = cia_enabled()
    drive.hears(0, bytes([2, N]))
    assert drive.v.acts == 0
    drive.at(drive.t + 6 * MS)
    assert drive.v.state == 7


def state_after(drive: Drive, *words: int) -> int:
    """The state after control words, two cycles for each."""
    for word in words:
        drive.hears(0x200 + N, rpdo(word))
        drive.at(drive.t + 2 * MS)
        drive.hears(0x702, b"\x7f")
    return int(drive.v.state)


SOD, READY, ON, ENABLED, QUICK, FAULT = 1, 2, 3, 4, 5, 7


@pytest.mark.parametrize(
    ("words", "state"),
    [
        ((0x00,), SOD), ((0x07,), SOD), ((0x0F,), SOD), ((0x06,), READY), ((0x86,), SOD),
        ((0x06, 0x0F), ENABLED), ((0x06, 0x07), ON), ((0x06, 0x06), READY),
        ((0x06, 0x00), SOD), ((0x06, 0x02), SOD), ((0x06, 0x05), SOD),
        ((0x06, 0x07, 0x06), READY), ((0x06, 0x07, 0x00), SOD), ((0x06, 0x07, 0x02), SOD),
        ((0x06, 0x07, 0x07), ON), ((0x06, 0x07, 0x0F), ENABLED), ((0x06, 0x07, 0x8F), ON),
        ((0x06, 0x07, 0x0F, 0x07), ON), ((0x06, 0x07, 0x0F, 0x06), READY),
        ((0x06, 0x07, 0x0F, 0x00), SOD), ((0x06, 0x07, 0x0F, 0x0D), SOD),
        ((0x06, 0x07, 0x0F, 0x02), QUICK), ((0x06, 0x07, 0x0F, 0x8F), ENABLED),
        ((0x06, 0x07, 0x0F, 0x02, 0x0F), QUICK), ((0x06, 0x07, 0x0F, 0x02, 0x00), SOD),
    ],
)  # fmt: skip
def test_the_transitions_of_a_cia_402_drive(words: tuple[int, ...], state: int) -> None:
    """IEC 61800-7-201: bits 0 to 3 and 7 of the control word."""
    drive = Drive(Kind.CIA402)
    drive.hears(0x702, b"\x7f")
    drive.hears(0, bytes([1, N]))
    assert state_after(drive, *words) == state


def test_a_quick_stop_long_after_the_enabling_takes_as_long() -> None:
    drive = cia_enabled(host=0)
    drive.at(300 * MS)
    drive.hears(0x200 + N, rpdo(0x02))
    drive.at(302 * MS)
    assert drive.v.state == QUICK
    drive.at(319 * MS)
    assert drive.v.state == QUICK
    drive.at(322 * MS)
    assert drive.v.state == SOD
    assert state_after(drive, 0x06, 0x07, 0x0F) == ENABLED
    drive.at(400 * MS)
    assert drive.v.state == ENABLED


@pytest.mark.parametrize(
    ("words", "low"),
    [((), 0x50), ((0x06,), 0x31), ((0x06, 0x07), 0x33), ((0x06, 0x07, 0x0F), 0x37)],
)
def test_the_status_word_tells_the_state(words: tuple[int, ...], low: int) -> None:
    """Voltage is enabled (bit 4), it is remote (9), and follows torques when it is enabled (12)."""
    drive = Drive(Kind.CIA402)
    drive.hears(0x702, b"\x7f")
    drive.hears(0, bytes([1, N]))
    state_after(drive, *words)
    drive.hears(0x80, b"")
    first, second = drive.says()[-2:]
    high = 0x12 if words[-1:] == (0x0F,) else 0x02
    assert (first.id, first.data[:2]) == (0x180 + N, bytes([low, high]))
    assert (second.id, second.data) == (0x280 + N, bytes(8))


def test_a_fault_needs_an_edge_of_bit_7_and_a_cool_drive() -> None:
    drive = cia_enabled()
    drive.fault(Fault.HOT, 1)
    for _ in range(10):
        drive.hears(0x702, b"\x7f")
        drive.at(drive.t + 5 * MS)
    assert drive.v.state == FAULT
    assert state_after(drive, 0x80, 0x00, 0x80) == FAULT
    drive.fault(Fault.HOT, 0)
    assert state_after(drive, 0x80) == FAULT  # no edge
    assert state_after(drive, 0x00, 0x80) == SOD


@pytest.mark.parametrize(
    ("data", "network"),
    [
        (bytes([1, N]), 5), (bytes([1, 0]), 5), (bytes([1, N + 1]), 127), (bytes([1]), 127),
        (bytes([1, N, 0]), 127), (bytes([2, N]), 4), (bytes([9, N]), 127),
    ],
)  # fmt: skip
def test_nmt_commands_of_two_bytes_to_it_or_to_all_are_obeyed(data: bytes, network: int) -> None:
    drive = Drive(Kind.CIA402)
    drive.hears(0, data)
    assert drive.v.network == network


@pytest.mark.parametrize("command", [0x81, 0x82])
def test_a_reset_by_nmt_is_a_power_up(command: int) -> None:
    drive = cia_enabled()
    drive.sent()
    drive.hears(0, bytes([command, N]))
    assert drive.v.acts == 0
    drive.at(drive.t + 60 * MS)
    assert [(s.id, s.data) for s in drive.sent()] == [(0x700 + N, b"\0")]
    assert (drive.v.state, drive.v.network) == (SOD, 127)


@pytest.mark.parametrize(
    ("code", "register"),
    [(0x2310, 3), (0x3210, 5), (0x4310, 9), (0x8130, 0x11), (0x7305, 1), (0xFF00, 1)],
)
def test_an_emergency_has_the_register_of_its_class(code: int, register: int) -> None:
    drive = cia_enabled()
    drive.sent()
    drive.fault(Fault.TRIP, code)
    drive.at(drive.t + MS)
    (said,) = drive.sent()
    assert (said.id, said.data) == (0x80 + N, struct.pack("<HB5x", code, register))


def test_only_torques_to_a_drive_that_is_not_enabled_are_refused() -> None:
    drive = Drive(Kind.CIA402)
    drive.hears(0, bytes([1, N]))
    for torque, refused in ((0, 0), (5, 1), (-5, 2)):
        drive.hears(0x200 + N, rpdo(0x06, torque))
        assert drive.v.refused == refused
    drive = cia_enabled()
    drive.hears(0x200 + N, rpdo(0x0F, 5))
    assert drive.v.refused == 0


@pytest.mark.parametrize(
    ("identifier", "data", "flags"),
    [(0x200 + N, rpdo(0x06), 1), (0x80, b"", 8), (0, bytes([1, N]), 16), (0x702, b"\x7f", 1)],
)
def test_a_cia_402_drive_hears_plain_frames_only(identifier: int, data: bytes, flags: int) -> None:
    drive = Drive(Kind.CIA402)
    drive.hears(identifier, data, flags)
    assert (drive.v.unheard, drive.v.network, drive.v.state) == (1, 127, SOD)
    drive.hears(0x200 + N + 1, rpdo(0x06), 1)
    assert drive.v.unheard == 1  # another drive's


def test_its_own_heartbeat_tells_the_state_of_the_network() -> None:
    drive = Drive(Kind.CIA402, beat_ns=10 * MS)
    drive.at(10 * MS)
    drive.hears(0, bytes([1, N]))
    drive.at(20 * MS)
    assert [(s.id, s.data) for s in drive.sent()] == [(0x700 + N, b"\x7f"), (0x700 + N, b"\x05")]
