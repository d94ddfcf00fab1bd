"""An ODrive in C: heartbeats, requests, remote frames."""

from __future__ import annotations

import struct

import pytest

from bridge.native.vendor import VendorFault as Fault
from bridge.native.vendor import VendorKind as Kind
from tests.bridge.drives.vendors import BRS, MS, Drive, N, odrive_enabled


def test_an_odrive_tells_its_state_every_100_ms_and_its_watchdog_ends_in_idle() -> None:
    drive = odrive_enabled()
    drive.at(350 * MS)
    beats = [(s.t_ns, *struct.unpack("<IBB", s.data[:6])) for s in drive.sent()]
    assert [b[0] for b in beats] == [100 * MS, 200 * MS, 300 * MS]
    assert {b[1:] for b in beats} == {(0x1000000, 1, 3)}
    assert all(len(s.data) == 8 for s in drive.sent())


def test_an_odrive_in_another_control_mode_follows_no_torque() -> None:
    drive = Drive(Kind.ODRIVE)
    drive.hears(N << 5 | 7, struct.pack("<I", 8))
    drive.at(2 * MS)
    assert (drive.v.state, drive.v.acts) == (8, 0)
    drive.hears(N << 5 | 0x0B, struct.pack("<II", 1, 1))
    assert drive.v.acts


def test_an_odrive_answers_remote_frames_and_only_its_own() -> None:
    drive = Drive(Kind.ODRIVE)
    for node in (N, N + 1):
        for command in (0, 3, 0x15):
            drive.hears(node << 5 | command, b"", 8)
    assert [s.id for s in drive.sent()] == [N << 5, N << 5 | 3, N << 5 | 0x15]


@pytest.mark.parametrize(("state", "result"), [(3, 13), (99, 13), (1, 0)])
def test_an_odrive_refuses_states_it_cannot_be_in(state: int, result: int) -> None:
    drive = Drive(Kind.ODRIVE)
    drive.hears(N << 5 | 7, struct.pack("<I", state))
    assert (drive.v.state, drive.v.result) == (1, result)


def test_an_odrive_stops_by_estop_and_reboots_when_asked() -> None:
    drive = odrive_enabled()
    drive.hears(N << 5 | 2, b"")
    assert (drive.v.acts, drive.v.error, drive.v.result) == (0, 0x2000000, 3)
    drive.hears(N << 5 | 0x16, b"")
    drive.at(51 * MS)
    assert not drive.v.network
    drive.at(53 * MS)
    assert (drive.v.network, drive.v.error) == (1, 0)


def test_an_odrive_hears_no_fd_frame_and_no_short_one() -> None:
    drive = Drive(Kind.ODRIVE)
    drive.hears(N << 5 | 7, struct.pack("<I", 8), BRS)
    drive.hears(N << 5 | 7, b"\x08")
    drive.at(5 * MS)
    assert (drive.v.state, drive.v.unheard) == (1, 2)


def heartbeat(drive: Drive) -> tuple[int, int, int]:
    """Errors, axis state and procedure result as told by the last heartbeat."""
    drive.at(drive.t + 100 * MS)
    found = struct.unpack("<IBB", drive.sent()[-1].data[:6])
    return int(found[0]), int(found[1]), int(found[2])


def closed_loop(drive: Drive) -> None:
    drive.hears(N << 5 | 7, struct.pack("<I", 8))


def test_an_odrive_that_is_asked_to_idle_cancels_what_it_did() -> None:
    drive = odrive_enabled(timeout_ns=0)
    drive.hears(N << 5 | 7, struct.pack("<I", 1))
    assert (drive.v.state, drive.v.acts) == (1, 0)
    assert heartbeat(drive) == (0, 1, 2)
    drive.hears(N << 5 | 7, struct.pack("<I", 1))
    assert heartbeat(drive) == (0, 1, 0)


def test_a_request_for_closed_loop_is_busy_until_the_next_cycle_and_idle_ends_it() -> None:
    drive = Drive(Kind.ODRIVE, timeout_ns=0)
    closed_loop(drive)
    assert (drive.v.state, drive.v.result) == (1, 1)
    drive.at(drive.t + MS - 1)
    assert drive.v.state == 1
    drive.at(drive.t + 1)
    assert (drive.v.state, drive.v.result) == (8, 0)
    closed_loop(drive)
    assert drive.v.result == 0  # it is there
    drive = Drive(Kind.ODRIVE, timeout_ns=0)
    closed_loop(drive)
    drive.hears(N << 5 | 7, struct.pack("<I", 1))
    drive.at(5 * MS)
    assert drive.v.state == 1


@pytest.mark.parametrize(
    ("command", "data"), [(0x0C, bytes(8)), (0x0D, bytes(8)), (0x0E, bytes(4))]
)
def test_set_points_feed_an_odrive_and_nothing_else_does(command: int, data: bytes) -> None:
    drive, starved = odrive_enabled(), odrive_enabled()
    for k in range(1, 10):
        for one, what, words in ((drive, command, data), (starved, 0x0B, struct.pack("<II", 1, 1))):
            one.at(k * 10 * MS)
            one.hears(N << 5 | what, words)
    assert (drive.v.state, starved.v.state) == (8, 1)
    assert starved.v.error == 0x1000000


def test_an_odrive_starves_after_its_time_out_and_not_at_it() -> None:
    drive = odrive_enabled()
    drive.hears(N << 5 | 0x0E, struct.pack("<f", 1.0))
    drive.at(drive.t + 20 * MS)
    assert drive.v.state == 8
    drive.at(drive.t + 1)
    assert (drive.v.state, drive.v.result) == (1, 3)


@pytest.mark.parametrize("tau", [float("nan"), float("inf")])
def test_a_torque_that_is_no_number_is_0(tau: float) -> None:
    drive = odrive_enabled()
    drive.hears(N << 5 | 0x0E, struct.pack("<f", 2.0))
    assert drive.v.tau == 2.0
    drive.hears(N << 5 | 0x0E, struct.pack("<f", tau))
    assert drive.v.tau == 0.0


def test_torques_to_an_idle_odrive_are_refused() -> None:
    drive = Drive(Kind.ODRIVE)
    for tau, refused in ((0.0, 0), (1.0, 1), (-1.0, 2)):
        drive.hears(N << 5 | 0x0E, struct.pack("<f", tau))
        assert drive.v.refused == refused
    drive = odrive_enabled()
    drive.hears(N << 5 | 0x0E, struct.pack("<f", 1.0))
    assert drive.v.refused == 0


@pytest.mark.parametrize(("mode", "inputs", "acts"), [(1, 1, 1), (3, 1, 0), (1, 2, 0), (2, 6, 0)])
def test_an_odrive_follows_torques_in_torque_control_with_passthrough(
    mode: int, inputs: int, acts: int
) -> None:
    drive = odrive_enabled()
    drive.hears(N << 5 | 0x0B, struct.pack("<II", mode, inputs))
    assert drive.v.acts == acts


def test_an_odrive_stops_by_estop_until_its_errors_are_cleared() -> None:
    drive = odrive_enabled()
    drive.hears(N << 5 | 2, b"")
    assert heartbeat(drive) == (0x2000000, 1, 3)
    closed_loop(drive)
    assert heartbeat(drive) == (0x2000000, 1, 3)
    drive.hears(N << 5 | 0x18, b"\0")
    closed_loop(drive)
    drive.at(drive.t + 2 * MS)
    assert drive.v.state == 8


@pytest.mark.parametrize(("hot", "error"), [(1, 0x4000), (2, 0x2000)])
def test_an_odrive_that_is_hot_keeps_its_error_and_tells_its_temperature(
    hot: int, error: int
) -> None:
    drive = odrive_enabled()
    drive.fault(Fault.HOT, hot)
    drive.hears(N << 5 | 0x18, b"\0")
    assert heartbeat(drive)[0] == error
    drive.hears(N << 5 | 0x15, b"", 8)
    inverter, motor = struct.unpack("<ff", drive.sent()[-1].data)
    assert (inverter > motor) == (hot == 1) and min(inverter, motor) == 30.0


def test_an_odrive_tells_active_errors_and_why_it_disarmed() -> None:
    drive = odrive_enabled()
    drive.fault(Fault.TRIP, 0x400)
    drive.fault(Fault.TRIP, 0x100)
    drive.hears(N << 5 | 3, b"", 8)
    assert struct.unpack("<II", drive.sent()[-1].data) == (0x500, 0x100)


@pytest.mark.parametrize(
    ("command", "data"),
    [(0x0B, bytes(7)), (0x0C, bytes(7)), (0x0D, bytes(4)), (7, bytes(3)), (0x0E, bytes(3))],
)
def test_odrive_commands_that_are_too_short_are_not_heard(command: int, data: bytes) -> None:
    drive = odrive_enabled()
    fed = drive.v.fed_ns
    drive.at(drive.t + MS)
    drive.hears(N << 5 | command, data)
    assert (drive.v.unheard, drive.v.state, drive.v.acts, drive.v.fed_ns) == (1, 8, 1, fed)


@pytest.mark.parametrize(("command", "part"), [(0x09, 0), (0x1C, 1)])
def test_estimates_and_torques_come_when_asked(command: int, part: int) -> None:
    drive = Drive(Kind.ODRIVE)
    drive.hears(N << 5 | command, b"", 8)
    assert [drive.v.owed[k] for k in range(2)] == [part == 0, part == 1]
