"""Profiles of drives: every file loads, gives torque and state in SI, and its drive answers."""

from __future__ import annotations

from math import pi
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.can.codec_check import verify
from bridge.drives.profile_files import load_profile
from bridge.drives.profiles import DriveProfile, Joint
from bridge.native.safety import DriveState, Status
from cosim.base.errors import ScenarioError
from tests.bridge.drives.emulated import EmulatedDrive

FOLDER = Path(__file__).resolve().parents[3] / "configs" / "drives"
NAMES = sorted(path.stem for path in FOLDER.glob("*.toml"))
H, MS, NODE = 1e-3, 1_000_000, 3


def profile(name: str) -> DriveProfile:
    return load_profile(FOLDER / f"{name}.toml")


def enabled(name: str, joint: Joint | None = None) -> EmulatedDrive:
    drive = EmulatedDrive(profile(name), NODE, H, joint)
    for frame in drive.profile.frames("enable", NODE):
        drive.receive(*frame, 0)
    assert drive.state == DriveState.ENABLED
    return drive


def command(
    drive: EmulatedDrive, tau: float, status: int = 0, counter: int = 0
) -> tuple[int, bytes]:
    """The frame that asks for a torque at every joint, as a node sends it."""
    part = drive.profile.command
    codec = drive.profile.codec(part, NODE)
    gains = [drive._si[s][0] for s in part.tau]
    return codec.layout.identifier, codec.encode(tau / np.array(gains), status, 0, counter)


DAMIAO = ("damiao", "damiao_4340", "damiao_8009")


def test_the_profiles_are_there() -> None:
    assert ["cia402", *DAMIAO, "link", "link_fd", "odrive"] == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_codecs_are_those_of_cantools(name: str) -> None:
    found = profile(name)
    for part in (found.command, *found.feedback):
        verify(found.codec(part, 1))


@pytest.mark.parametrize("name", NAMES)
def test_every_joint_has_a_torque_a_position_and_a_velocity(name: str) -> None:
    found = profile(name)
    for port in ("q", "dq"):
        assert sum(len(getattr(part, port)) for part in found.feedback) == found.joints


@pytest.mark.parametrize("name", NAMES)
def test_its_drive_acts_and_answers_within_the_resolution_of_the_codec(name: str) -> None:
    """Command -> torque at the joint; joint -> frames -> the same state, through gear and all."""
    joint = Joint(gear=2.0, direction=-1, zero=0.25)
    drive = enabled(name, joint)
    drive.receive(*command(drive, 0.75), 0)
    q, dq = np.full(drive.joints, 0.5), np.full(drive.joints, -0.3)
    for k in range(15):
        drive.receive(*command(drive, 0.75, counter=k + 1), k * MS)
        torque, frames = drive.step(q, dq, k * MS)
    assert np.allclose(torque, 0.75, atol=5e-3)
    sent = dict(frames)
    expected = {"q": 0.5, "dq": -0.3, "tau": torque[0]}
    for part in drive.profile.feedback:
        codec = drive.profile.codec(part, NODE)
        _, values, _ = codec.decode(sent[codec.layout.identifier])
        for signal, spec, value in zip(part.signals, codec.signals, values, strict=True):
            gain, offset = drive.profile.conversion(part, signal, joint)
            port = next(p for p in expected if signal in getattr(part, p))
            lsb = 1e-6 if spec.kind == 2 else abs(gain * spec.scale)
            assert abs(gain * value + offset - expected[port]) <= lsb


@pytest.mark.parametrize("name", NAMES)
def test_silence_is_a_fault_that_needs_clear_and_enable(name: str) -> None:
    drive = enabled(name)
    one = np.ones(drive.joints)
    drive.receive(*command(drive, 1.0), 0)
    drive.step(one, one, 0)
    assert drive.state == DriveState.ENABLED
    drive.step(one, one, 100 * MS)
    assert drive.state == DriveState.FAULT
    for frame in drive.profile.frames("enable", NODE):
        drive.receive(*frame, 100 * MS)
    assert drive.state == DriveState.FAULT
    for sequence in ("clear", "enable"):
        for frame in drive.profile.frames(sequence, NODE):
            drive.receive(*frame, 100 * MS)
    cleared = DriveState.ENABLED if drive.profile.sequences["clear"] else DriveState.FAULT
    assert drive.state == cleared
    for frame in drive.profile.frames("disable", NODE):
        drive.receive(*frame, 100 * MS)
    assert drive.state in (DriveState.READY, DriveState.FAULT)


@pytest.mark.parametrize("name", ["link", "link_fd"])
def test_a_drive_of_our_own_protocol_refuses_a_rehearsal_and_foreign_bytes(name: str) -> None:
    drive = enabled(name)
    zero = np.zeros(drive.joints)
    drive.receive(*command(drive, 1.0, int(Status.SIMULATED)), 0)
    assert drive.refused == 1
    assert not drive.step(zero, zero, 0)[0].any()
    identifier, data = command(drive, 1.0)
    drive.receive(identifier, data[:-1] + bytes([data[-1] ^ 1]), 0)  # the CRC says so
    assert not drive.step(zero, zero, 0)[0].any()
    drive.receive(identifier, data, 0)
    assert drive.step(zero, zero, 0)[0].all()


def test_the_profiles_that_carry_no_status_cannot_refuse_a_rehearsal() -> None:
    assert {n for n in NAMES if profile(n).refuses_simulated} == {"link", "link_fd"}


# --- MIT: 12 bits without a zero -------------------------------------------------------------


def damiao_reads(code: int, low: float, high: float, bits: int) -> float:
    """How the drive's firmware makes a number of a code."""
    return code * (high - low) / (2**bits - 1) + low


def damiao_writes(x: float, low: float, high: float, bits: int) -> int:
    """How common drivers make a code of a number: truncated, not rounded."""
    return int((x - low) / (high - low) * (2**bits - 1))


def test_no_torque_is_not_none_over_mit() -> None:
    """We round 2047.5 to 2048, which the drive reads as +2.44 mN.m; others truncate to 2047."""
    found = profile("damiao")
    _, data = command(enabled("damiao"), 0.0)
    code = (data[6] & 15) << 8 | data[7]
    assert code == 2048
    assert damiao_writes(0.0, -10, 10, 12) == 2047
    assert damiao_reads(2048, -10, 10, 12) == pytest.approx(10 / 4095)
    assert damiao_reads(2047, -10, 10, 12) == pytest.approx(-10 / 4095)
    _, values, _ = found.codec(found.command, NODE).decode(data)
    assert values[0] == pytest.approx(10 / 4095)


@given(tau=st.floats(-12, 12))
def test_our_torque_is_the_nearest_code_of_the_drive(tau: float) -> None:
    found = profile("damiao")
    data = found.codec(found.command, NODE).encode([tau])
    read = damiao_reads((data[6] & 15) << 8 | data[7], -10, 10, 12)
    assert abs(read - np.clip(tau, -10, 10)) <= 0.5001 * 20 / 4095
    assert data[:6] == bytes([0x80, 0x00, 0x80, 0x00, 0x00, 0x00])  # q = dq = 0, no gains
    assert data[6] >> 4 == 0


def test_a_frame_with_gains_or_that_enables_is_no_torque_command() -> None:
    drive = enabled("damiao")
    identifier, data = command(drive, 1.0)
    drive.receive(identifier, data[:4] + bytes([1]) + data[5:], 0)  # kp > 0
    drive.receive(*drive.profile.frames("enable", NODE)[0], 0)  # would read as +10 N.m
    assert drive.step([0.0], [0.0], 0)[0][0] == 0.0


def test_velocity_feedback_is_coarse() -> None:
    """14.7 mrad/s: what xi is made of."""
    found = profile("damiao")
    assert found.layout(found.feedback[0], 1).signal("dq").scale == pytest.approx(60 / 4095)


# --- watchdogs inside drives -----------------------------------------------------------------


def test_a_watchdog_is_written_and_read_back() -> None:
    drive = EmulatedDrive(profile("damiao"), NODE, H)
    own = drive.profile.watchdog
    assert own.write is not None
    assert own.read is not None
    written = own.write.at(NODE, own.raw(0.05))
    assert written == (0x7FF, bytes.fromhex("03005509e8030000"))  # 1000 * 50 us
    drive.receive(*written, 0)
    assert drive.drive.struct.watchdog.timeout_ns == 50 * MS
    [answer] = drive.receive(*own.read.at(NODE), 0)
    assert answer == (0x13, bytes.fromhex("03003309e8030000"))
    assert own.wrong_value(0.05, NODE, *answer) == ""
    assert own.wrong_value(0.1, NODE, *answer) == "TIMEOUT (9) reads 0.05 s, not 0.1 s"
    off = bytes.fromhex("0300330900000000")
    assert own.wrong_value(0.1, NODE, 0x13, off) == "TIMEOUT (9) reads 0, off, not 0.1 s"


@pytest.mark.parametrize("name", ["cia402", "damiao", "odrive"])
def test_a_watchdog_cannot_be_set_off(name: str) -> None:
    with pytest.raises(ScenarioError, match="is off, expected at least"):
        profile(name).watchdog.raw(0.0)


# --- units and errors ------------------------------------------------------------------------


def test_units_of_the_drives() -> None:
    odrive, cia402 = profile("odrive"), profile("cia402")
    assert odrive.conversion(odrive.feedback[0], "q") == (2 * pi, 0.0)
    geared = Joint(gear=9.0, direction=-1, zero=0.5)
    assert odrive.conversion(odrive.feedback[0], "q", geared) == pytest.approx((-2 * pi / 9, 0.5))
    assert odrive.conversion(odrive.command, "tau", geared) == (-9.0, 0.0)
    assert cia402.conversion(cia402.command, "tau") == (0.01, 0.0)  # % of 1 N.m
    assert cia402.conversion(cia402.feedback[0], "q")[0] == pytest.approx(2 * pi / 65536)
    codec = cia402.codec(cia402.command, NODE)
    assert codec.encode([12.3]) == bytes.fromhex("0f000a7b00")  # 123 / 1000 of the rated torque
    with pytest.raises(ScenarioError, match="gear"):
        odrive.conversion(odrive.command, "tau", Joint(gear=0.0))


def test_identifiers_of_nodes() -> None:
    found = {name: profile(name) for name in NAMES}
    ids = {n: p.layout(p.command, NODE).identifier for n, p in found.items()}
    assert ids == {
        "cia402": 0x203, **dict.fromkeys(DAMIAO, 0x003),
        "link": 0x1A3, "link_fd": 0x3A3, "odrive": 0x06E,
    }  # fmt: skip
    with pytest.raises(ScenarioError, match=r"link\.toml.*TAU_A_99"):
        found["link"].layout(found["link"].command, 99)


GOOD = (FOLDER / "damiao.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('dbc = "damiao.dbc"', 'dbc = "none.dbc"', r"p\.toml: dbc: .*none\.dbc"),
        ('dbc = "damiao.dbc"', "", r"p\.toml: dbc: is None, expected a DBC file"),
        ('message = "COMMAND"', 'message = "COMAND"', "did you mean COMMAND"),
        ('q = ["q"]', 'q = ["qq"]', "has no signal 'qq'"),
        ('tau = ["tau"]', "", r"p\.toml: command\.tau: has no signal"),
        ("FF FC", "FF XX", r"sequences\.enable\[0\]: data .*expected at most 8 bytes"),
        ("FF FC", "FF FF FC", "expected at most 8 bytes"),
        ("[limits]", "[limit]", r"has no 'limit', expected some of"),
        ('dq_max = "30 rad/s"', 'dq_max = "30 rad"', r"limits\.dq_max: \[rad\] cannot feed"),
        ("damping = 0.05", "damping = -1", r"drive\.damping: is -1"),
        ("title =", 'side = "left"\ntitle =', "side: is 'left'"),
        ("title =", "refuses_simulated = true\ntitle =", "has no status"),
        ("[command]", "[command", r"p\.toml: not valid TOML"),
        ("step = 1   ", "pace = 1   ", r"command: has no 'pace'"),
    ],
)
def test_errors_say_file_and_place(tmp_path: Path, old: str, new: str, message: str) -> None:
    (tmp_path / "damiao.dbc").write_bytes((FOLDER / "damiao.dbc").read_bytes())
    assert old in GOOD
    path = tmp_path / "p.toml"
    path.write_text(GOOD.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ScenarioError, match=message):
        load_profile(path)


def test_a_missing_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"none\.toml: no such file; expected the profile"):
        load_profile(tmp_path / "none.toml")


def test_a_profile_is_read_again_only_where_it_or_its_base_has_changed(tmp_path: Path) -> None:
    for file in ("damiao.toml", "damiao.dbc", "damiao_4340.toml", "damiao_4340.dbc"):
        (tmp_path / file).write_bytes((FOLDER / file).read_bytes())
    path = tmp_path / "damiao_4340.toml"
    first = load_profile(path)
    assert load_profile(path) is first
    base = tmp_path / "damiao.toml"
    base.write_text(base.read_text("utf-8").replace('register = "TIMEOUT (9)"', 'register = "T"'))
    assert load_profile(path).watchdog.register == "T"
