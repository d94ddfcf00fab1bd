"""An ODrive in C: heartbeats, requests, remote frames."""

from __future__ import annotations

import struct

import pytest

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
