"""What may happen to a drive of any vendor."""

from __future__ import annotations

import ctypes as c
import struct
from collections.abc import Callable
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.native.frame import Flags, Frame
from bridge.native.vendor import VendorFault as Fault
from bridge.native.vendor import VendorKind as Kind
from tests.bridge.drives.vendors import (
    FEEDBACK,
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


@KINDS
@pytest.mark.parametrize("waited", [0, 1, 5])
def test_the_time_of_an_answer_begins_with_its_request(kind: Kind, waited: int) -> None:
    """A plant that gives the values later does not make the drive slower."""
    drive = Drive(kind, answer_ns=2 * MS)
    if kind == Kind.CIA402:
        drive.hears(0, bytes([1, N]))
    drive.at(3 * MS)
    list(drive.sent())  # a boot-up
    ask(drive)
    ask(drive)  # the answer is that of the first request
    drive.at((3 + waited) * MS)
    at_once = drive.says()
    drive.at(20 * MS)
    assert [*at_once, *drive.sent()][0].t_ns == 3 * MS + max(2, waited) * MS


def splitmix(seed: int) -> int:
    """The first number of Steele's SplitMix64 with this seed."""
    whole = (1 << 64) - 1
    z = (seed + 0x9E3779B97F4A7C15) & whole
    z = ((z ^ z >> 30) * 0xBF58476D1CE4E5B9) & whole
    z = ((z ^ z >> 27) * 0x94D049BB133111EB) & whole
    return z ^ z >> 31


@pytest.mark.parametrize("seed", [0, 1, 7, 1 << 63])
def test_the_time_of_an_answer_is_drawn_from_the_seed(seed: int) -> None:
    drive = Drive(Kind.DAMIAO, answer_ns=100, jitter_ns=MS, seed=seed)
    drive.hears(0x7FF, bytes([N, 0, 0x33, 9, 0, 0, 0, 0]))
    drive.at(2 * MS)
    assert [s.t_ns for s in drive.sent()] == [100 + splitmix(seed) % MS]


@KINDS
def test_a_drive_without_power_or_cable_and_frames_with_errors_are_nothing_to_it(
    kind: Kind,
) -> None:
    def state(fault: Fault | None, flags: int) -> tuple[int, int]:
        drive = Drive(kind)
        if fault is not None:
            drive.fault(fault)
        for identifier, data in (
            (N, b"\xff" * 7 + b"\xfc"),
            (N << 5 | 7, bytes([8, 0, 0, 0])),
            (0, bytes([1, N])),
        ):
            drive.hears(identifier, data, flags)
        drive.call("step", 5 * MS)
        return int(drive.v.state), int(drive.v.network)

    heard = state(None, 0)
    untouched = Drive(kind)
    assert heard != (untouched.v.state, untouched.v.network)
    assert state(None, int(Flags.ERROR)) == (untouched.v.state, untouched.v.network)
    assert state(Fault.UNPLUG, 0) == (untouched.v.state, untouched.v.network)
    assert state(Fault.REBOOT, 0)[1] == 0


@KINDS
def test_only_an_odrive_tells_its_position_without_a_question(kind: Kind) -> None:
    drive = Drive(kind)
    for part, (identifier, step) in enumerate(FEEDBACK[kind]):
        frame = Frame.of(identifier + step * N, bytes(8))
        drive.call("say", part, c.byref(frame), 0)
    assert len(drive.sent()) == (2 if kind == Kind.ODRIVE else 0)


@pytest.mark.parametrize(
    ("kind", "identifier", "data", "asks"),
    [
        (Kind.DAMIAO, N, bytes(8), 0), (Kind.DAMIAO, N, b"\xff" * 7 + b"\xfd", 1),
        (Kind.DAMIAO, N + 1, b"\xff" * 7 + b"\xfd", 0), (Kind.DAMIAO, 0x7FF, bytes(8), 1),
        (Kind.ODRIVE, N << 5 | 0x0E, bytes(4), 0), (Kind.ODRIVE, N << 5 | 7, bytes(4), 1),
        (Kind.ODRIVE, (N + 1) << 5 | 7, bytes(4), 0),
        (Kind.CIA402, 0x200 + N, rpdo(0x0F), 0), (Kind.CIA402, 0x200 + N, rpdo(0x1F), 0),
        (Kind.CIA402, 0x200 + N, rpdo(0x07), 1), (Kind.CIA402, 0x200 + N, rpdo(0x0F)[:4], 1),
        (Kind.CIA402, 0x201 + N, rpdo(0x07), 0), (Kind.CIA402, 0x80, b"", 1),
        (Kind.CIA402, 0, bytes([1, N]), 1), (Kind.CIA402, 0x702, b"\x05", 1),
    ],
)  # fmt: skip
def test_a_frame_that_asks_for_something_else_than_torque_is_known(
    kind: Kind, identifier: int, data: bytes, asks: int
) -> None:
    drive = Drive(kind)
    assert drive.call("take", c.byref(Frame.of(identifier, data)), 0) == asks


@KINDS
def test_a_watchdog_of_0_never_trips(kind: Kind) -> None:
    drive = ENABLED[kind](timeout_ns=0)
    drive.at(10_000 * MS)
    assert (drive.v.trips, drive.v.acts) == (0, 1)


@KINDS
@pytest.mark.parametrize("every", [0, 3 * MS])
def test_a_drive_has_a_heartbeat_only_where_it_has_a_period(kind: Kind, every: int) -> None:
    """Its first one is due a period after power-up; with a period of 0 none ever is."""
    drive = Drive(kind, beat_ns=every)
    assert drive.v.beat_due_ns == (every or (1 << 63) - 1)
    drive.at(10 * MS)
    assert drive.v.beat_due_ns == (12 * MS if every else (1 << 63) - 1)


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
