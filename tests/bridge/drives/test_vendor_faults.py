"""What may happen to a drive of any vendor."""

from __future__ import annotations

import struct
from collections.abc import Callable
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.native.vendor import VendorFault as Fault
from bridge.native.vendor import VendorKind as Kind
from tests.bridge.drives.vendors import (
    MS,
    Drive,
    N,
    cia_enabled,
    damiao_enabled,
    mit,
    odrive_enabled,
    rpdo,
)  # fmt: skip

ENABLED: dict[Kind, Callable[..., Drive]] = {
    Kind.DAMIAO: damiao_enabled, Kind.ODRIVE: odrive_enabled, Kind.CIA402: cia_enabled,
}  # fmt: skip
KINDS = pytest.mark.parametrize("kind", list(Kind), ids=lambda kind: kind.name)


def ask(drive: Drive) -> None:
    """For an answer: a command, a remote frame, a SYNC."""
    if drive.kind == Kind.DAMIAO:
        drive.hears(N, mit(0.0))
    elif drive.kind == Kind.ODRIVE:
        drive.hears(N << 5 | 9, b"", 8)
    else:
        drive.hears(0x80, b"")


@KINDS
def test_a_drive_that_is_brought_up_is_enabled_with_its_watchdog_running(kind: Kind) -> None:
    drive = Drive(kind)
    drive.call("brought_up", 5 * MS)
    assert drive.v.acts
    drive.at(25 * MS)
    assert drive.v.acts
    drive.at(25 * MS + 1)
    assert not drive.v.acts
    assert drive.v.trips == 1


@KINDS
def test_a_reboot_is_silent_and_ends_disabled(kind: Kind) -> None:
    drive = ENABLED[kind]()
    drive.sent()
    drive.fault(Fault.REBOOT)
    ask(drive)
    drive.at(drive.t + 49 * MS)
    ask(drive)
    assert drive.says() == []
    drive.at(drive.t + 2 * MS)
    assert (drive.v.acts, bool(drive.v.network)) == (0, True)


@KINDS
def test_an_unplugged_drive_goes_on_by_itself_until_its_watchdog(kind: Kind) -> None:
    drive = ENABLED[kind]()
    drive.fault(Fault.UNPLUG)
    drive.sent()
    ask(drive)
    assert drive.says() == []
    assert drive.v.acts
    drive.at(drive.t + 30 * MS)
    assert drive.v.acts == 0
    drive.fault(Fault.PLUG)
    if kind == Kind.CIA402:
        drive.hears(0, bytes([1, N]))
    ask(drive)
    assert drive.says() != []


@KINDS
def test_over_temperature_is_not_cleared_until_it_is_cool(kind: Kind) -> None:
    drive = ENABLED[kind](timeout_ns=0, host=0)
    drive.fault(Fault.HOT, 2)
    code = {Kind.DAMIAO: 0xC, Kind.ODRIVE: 0x2000, Kind.CIA402: 0x4310}[kind]
    assert (drive.v.acts, drive.v.error) == (0, code)
    drive.at(drive.t + 10 * MS)
    for hot in (True, False):
        if kind == Kind.DAMIAO:
            drive.hears(N, b"\xff" * 7 + b"\xfb")
        elif kind == Kind.ODRIVE:
            drive.hears(N << 5 | 0x18, b"\0")
        else:
            drive.hears(0x200 + N, rpdo(0))
            drive.at(drive.t + 2 * MS)
            drive.hears(0x200 + N, rpdo(0x80))
        drive.at(drive.t + 2 * MS)
        assert drive.v.error == (code if hot else 0)
        drive.fault(Fault.HOT, 0)


@KINDS
def test_a_drive_may_be_enabled_and_drop_at_once(kind: Kind) -> None:
    drive = Drive(kind, timeout_ns=0)
    drive.fault(Fault.DROP, 1)
    seen = []
    if kind == Kind.DAMIAO:
        drive.hears(N, b"\xff" * 7 + b"\xfc")
    elif kind == Kind.ODRIVE:
        drive.hears(N << 5 | 0x0B, struct.pack("<II", 1, 1))
        drive.hears(N << 5 | 7, struct.pack("<I", 8))
    else:
        drive.hears(0, bytes([1, N]))
        drive.hears(0x200 + N, rpdo(6))
    for k in range(1, 40):
        drive.at(k * MS // 4)
        if kind == Kind.CIA402:
            drive.hears(0x200 + N, rpdo(6 if k < 8 else 0x0F))
        seen.append(drive.v.acts)
    assert [a for a, b in pairwise([*seen, -1]) if a != b] == [0, 1, 0]
    assert drive.v.error == 0


@KINDS
def test_a_drive_may_answer_late_for_another_and_with_old_positions(kind: Kind) -> None:
    drive = ENABLED[kind](timeout_ns=0, host=0)
    drive.says()
    drive.fault(Fault.OLD, 1)
    told = []
    for k in range(3):
        ask(drive)
        told += drive.says(bytes([9, 9, 1 + k, 7, 7, 7, 9, 9]))
    assert {s.data[2:6] for s in told} == {told[0].data[2:6]}
    drive.fault(Fault.OLD, 0)
    drive.fault(Fault.OTHER_ID, 1)
    ask(drive)
    (other, *_) = drive.says(bytes(8))
    assert other.id == told[0].id + 1
    drive.fault(Fault.OTHER_ID, 0)
    drive.fault(Fault.LATE, 3 * MS)
    asked = drive.t
    ask(drive)
    assert drive.says(bytes(8)) == []
    drive.at(asked + 4 * MS)
    assert next(s.t_ns for s in drive.sent()) == asked + 3 * MS


@KINDS
def test_answers_take_their_time_by_the_seed(kind: Kind) -> None:
    def times(seed: int) -> list[int]:
        drive = Drive(kind, answer_ns=MS // 10, jitter_ns=MS // 2, seed=seed)
        if kind == Kind.CIA402:
            drive.hears(0, bytes([1, N]))
        found = []
        for k in range(1, 6):
            drive.at(k * 2 * MS)
            ask(drive)
            drive.says()
            drive.at(k * 2 * MS + MS)
            found += [s.t_ns - k * 2 * MS for s in drive.sent()]
        return found

    assert times(1) == times(1) != times(2)
    assert all(MS // 10 <= t < MS // 10 + MS // 2 for t in times(1))


@settings(max_examples=80)
@given(
    kind=st.sampled_from(list(Kind)),
    frames=st.lists(
        st.tuples(
            st.sampled_from([0, 3, 0x7FF, 0x80, 0x203, 0x702, *range(96, 128)]),
            st.binary(max_size=8),
            st.integers(0, 63),
            st.integers(0, 5 * MS),
        ),
        max_size=60,
    ),
)
def test_whatever_it_hears_a_queue_has_room_or_counts(
    kind: Kind, frames: list[tuple[int, bytes, int, int]]
) -> None:
    drive = Drive(kind)
    for identifier, data, flags, wait in frames:
        drive.hears(identifier, data, flags)
        drive.at(drive.t + wait)
        assert 0 <= drive.v.n_ready <= drive.v.n_queue <= 16
    drive.says()
    drive.at(drive.t + 1000 * MS)
    drive.sent()
    assert drive.v.n_queue == 0
