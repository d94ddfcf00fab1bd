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
