"""A Damiao drive in C: registers, watchdog, formats."""

from __future__ import annotations

import struct

import pytest

from bridge.native.vendor import VendorFault as Fault
from bridge.native.vendor import VendorKind as Kind
from tests.bridge.drives.vendors import BRS, MS, Drive, N, damiao_enabled, mit


def test_a_damiao_watchdog_is_its_register_and_latches() -> None:
    drive = Drive(Kind.DAMIAO, timeout_ns=0)
    drive.hears(0x7FF, bytes([N, 0, 0x55, 9]) + struct.pack("<I", 1000))  # 50 ms
    assert drive.says()[0].data == bytes([N, 0, 0x55, 9]) + struct.pack("<I", 1000)
    drive.hears(N, b"\xff" * 7 + b"\xfc")
    for k in range(1, 11):
        drive.at(k * 50 * MS)
        drive.hears(N, mit(1.0))
    drive.at(11 * 50 * MS)
    assert drive.v.acts
    drive.at(11 * 50 * MS + 1)
    assert not drive.v.acts
    drive.says()
    for request in (mit(1.0), b"\xff" * 7 + b"\xfc", b"\xff" * 7 + b"\xfd"):
        drive.hears(N, request)
        assert [s.data[0] for s in drive.says()] == [0xD0 | N]
    assert drive.v.refused == 1
    drive.hears(N, b"\xff" * 7 + b"\xfb")
    assert [s.data[0] for s in drive.says()] == [N]


def test_a_damiao_register_does_not_feed_its_watchdog() -> None:
    drive = damiao_enabled()
    for k in range(3, 40):
        drive.at(k * MS)
        drive.hears(0x7FF, bytes([N, 0, 0x33, 9, 0, 0, 0, 0]))
    assert drive.v.state == 0xD


@pytest.mark.parametrize(
    ("rid", "value"),
    [(7, 0x13), (8, N), (10, 1), (21, 12.5), (22, 30.0), (23, 10.0), (35, 4)],
)
def test_damiao_registers_are_read(rid: int, value: float) -> None:
    drive = Drive(Kind.DAMIAO)
    drive.hears(0x7FF, bytes([N, 0, 0x33, rid, 0, 0, 0, 0]))
    (said,) = drive.says()
    kind = "<f" if isinstance(value, float) else "<I"
    assert (said.id, said.data[:4]) == (0x10 + N, bytes([N, 0, 0x33, rid]))
    assert struct.unpack(kind, said.data[4:]) == (value,)


def test_a_damiao_register_that_is_not_there_and_another_drives_are_not_answered() -> None:
    drive = Drive(Kind.DAMIAO)
    for first, rid in ((N, 40), (N + 1, 9)):
        drive.hears(0x7FF, bytes([first, 0, 0x33, rid, 0, 0, 0, 0]))
    assert drive.says() == []


@pytest.mark.parametrize(("flags", "heard"), [(0, True), (BRS, True), (1, False), (16, False)])
@pytest.mark.parametrize("own", [0, BRS])
def test_damiao_frames_without_bit_rate_switch_are_not_heard(
    flags: int, heard: bool, own: int
) -> None:
    """What is heard is answered in the drive's own format."""
    drive = Drive(Kind.DAMIAO, format=own)
    drive.hears(N, mit(0.0), flags)
    assert [s.flags for s in drive.says()] == [own] * heard
    assert drive.v.unheard == (not heard)


def test_a_damiao_torque_is_decoded_by_its_register() -> None:
    drive = damiao_enabled()
    drive.hears(N, mit(2.5))
    assert abs(drive.v.tau - 2.5) < 5e-3
    drive.hears(0x7FF, bytes([N, 0, 0x55, 23]) + struct.pack("<f", 20.0))
    drive.hears(N, mit(2.5))
    assert abs(drive.v.tau - 5.0) < 1e-2


def test_a_damiao_drive_in_another_mode_follows_no_torque() -> None:
    drive = damiao_enabled()
    drive.hears(0x7FF, bytes([N, 0, 0x55, 10, 2, 0, 0, 0]))
    drive.says()
    drive.hears(N, mit(2.5))
    assert drive.says() == []


def test_a_stored_time_out_outlives_a_reboot_and_a_written_one_does_not() -> None:
    drive = Drive(Kind.DAMIAO, timeout_ns=10 * MS)
    drive.hears(0x7FF, bytes([N, 0, 0x55, 9]) + struct.pack("<I", 1000))
    drive.fault(Fault.REBOOT)
    drive.at(60 * MS)
    drive.says()
    drive.hears(0x7FF, bytes([N, 0, 0x33, 9, 0, 0, 0, 0]))
    assert drive.says()[-1].data[4:] == struct.pack("<I", 200)
    drive.hears(0x7FF, bytes([N, 0, 0x55, 9]) + struct.pack("<I", 1000))
    drive.hears(0x7FF, bytes([N, 0, 0xAA, 1, 0, 0, 0, 0]))
    drive.fault(Fault.REBOOT)
    drive.at(120 * MS)
    drive.says()
    drive.hears(0x7FF, bytes([N, 0, 0x33, 9, 0, 0, 0, 0]))
    assert drive.says()[-1].data[4:] == struct.pack("<I", 1000)
