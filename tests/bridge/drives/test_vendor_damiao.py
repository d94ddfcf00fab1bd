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


def special(last: int) -> bytes:
    return b"\xff" * 7 + bytes([last])


def register(drive: Drive, rid: int) -> bytes:
    """The value of a register."""
    drive.says()
    drive.hears(0x7FF, bytes([N, 0, 0x33, rid, 0, 0, 0, 0]))
    return drive.says()[-1].data[4:]


@pytest.mark.parametrize(("mode", "kept"), [(0, 1), (1, 1), (2, 2), (4, 4), (5, 1), (1 << 31, 1)])
def test_a_damiao_control_mode_that_is_none_is_not_taken(mode: int, kept: int) -> None:
    drive = Drive(Kind.DAMIAO)
    drive.hears(0x7FF, bytes([N, 0, 0x55, 10]) + struct.pack("<I", mode))
    assert register(drive, 10) == struct.pack("<I", kept)


@pytest.mark.parametrize("rid", [21, 22, 23])
@pytest.mark.parametrize("value", [0.0, -1.0, float("inf"), float("nan"), 0.5, 25.0])
def test_a_damiao_range_is_a_number_above_0(rid: int, value: float) -> None:
    drive = Drive(Kind.DAMIAO)
    before = {r: register(drive, r) for r in (9, 10, 21, 22, 23)}
    drive.hears(0x7FF, bytes([N, 0, 0x55, rid]) + struct.pack("<f", value))
    if 0 < value < 100:
        before[rid] = struct.pack("<f", value)
    assert {r: register(drive, r) for r in before} == before


@pytest.mark.parametrize("last", [0xFA, 0xFF])
def test_only_four_damiao_frames_of_ff_are_requests(last: int) -> None:
    """Another one is a torque, which a disabled drive refuses."""
    drive = Drive(Kind.DAMIAO)
    drive.hears(N, special(last))
    drive.at(2 * MS)
    assert (drive.v.state, drive.v.refused) == (0, 1)


@pytest.mark.parametrize("place", range(7))
def test_a_damiao_request_has_seven_bytes_of_ff(place: int) -> None:
    data = bytearray(special(0xFC))
    data[place] = 0xFE
    drive = Drive(Kind.DAMIAO)
    drive.hears(N, bytes(data))
    drive.at(2 * MS)
    assert drive.v.state == 0


def test_damiao_requests_do_in_each_state_what_they_should() -> None:
    drive = damiao_enabled()
    drive.hears(N, special(0xFB))  # to clear takes no power from a drive that has it
    assert (drive.v.state, drive.v.acts) == (1, 1)
    drive.hears(N, special(0xFC))
    drive.at(4 * MS)
    assert (drive.v.state, drive.v.acts) == (1, 1)
    drive.hears(N, special(0xFD))
    assert (drive.v.state, drive.v.acts) == (0, 0)
    drive.hears(N, special(0xFC))
    drive.hears(N, special(0xFD))  # in the same cycle
    drive.at(6 * MS)
    assert drive.v.state == 0


def test_a_damiao_drive_that_is_hot_is_neither_cleared_nor_enabled() -> None:
    drive = damiao_enabled()
    drive.fault(Fault.HOT, 1)
    drive.at(3 * MS)
    assert (drive.v.state, drive.v.acts) == (0xB, 0)
    for last in (0xFB, 0xFC):
        drive.hears(N, special(last))
    drive.at(6 * MS)
    (*_, said) = drive.says()
    assert said.data[0] == 0xB0 | N and said.data[6] > said.data[7] > 0


@pytest.mark.parametrize(("code", "refused"), [(2047, 0), (2048, 0), (2046, 1), (2049, 1)])
def test_a_damiao_torque_of_none_is_not_refused(code: int, refused: int) -> None:
    drive = Drive(Kind.DAMIAO)
    drive.hears(N, bytes([0x80, 0, 0x80, 0, 0, 0, code >> 8, code & 255]))
    assert drive.v.refused == refused


def test_a_damiao_drive_tells_its_state_when_asked_and_that_feeds_nothing() -> None:
    drive = damiao_enabled()
    drive.hears(0x7FF, bytes([N, 0, 0xCC, 0, 0, 0, 0, 0]))
    (said,) = drive.says()
    assert (said.id, said.data[0]) == (0x10 + N, 0x10 | N)
    for first, second in ((N + 1, 0), (N, 1)):  # a number has two bytes
        drive.hears(0x7FF, bytes([first, second, 0xCC, 0, 0, 0, 0, 0]))
    assert drive.says() == []
    for k in range(3, 40):
        drive.at(k * MS)
        drive.hears(0x7FF, bytes([N, 0, 0xCC, 0, 0, 0, 0, 0]))
    assert drive.v.state == 0xD


def test_an_enabled_damiao_drive_stores_nothing() -> None:
    drive = damiao_enabled(timeout_ns=50 * MS)
    drive.hears(0x7FF, bytes([N, 0, 0x55, 9]) + struct.pack("<I", 100))
    drive.hears(0x7FF, bytes([N, 0, 0xAA, 1, 0, 0, 0, 0]))
    drive.fault(Fault.REBOOT)
    drive.at(60 * MS)
    assert register(drive, 9) == struct.pack("<I", 1000)


def test_a_damiao_register_frame_that_asks_for_nothing_known_is_not_answered() -> None:
    drive = Drive(Kind.DAMIAO)
    drive.hears(0x7FF, bytes([N, 0, 0x44, 9, 1, 2, 3, 4]))
    assert drive.says() == []
    assert register(drive, 9) == struct.pack("<I", 400)


@pytest.mark.parametrize("length", [7, 9, 0])
def test_damiao_frames_of_another_length_are_not_heard(length: int) -> None:
    drive = Drive(Kind.DAMIAO)
    drive.hears(N, bytes(min(length, 8)) if length < 9 else bytes(12), BRS if length > 8 else 0)
    assert (drive.says(), drive.v.unheard) == ([], 1)
