"""Identifiers are unique: messages, services, and all frames to and from drives."""

from __future__ import annotations

import pytest

from bridge.drives.profile_files import load_profile
from bridge.preflight import deployment
from bridge.preflight.identifiers import claims, collisions
from tests.bridge.deployment.test_foreign import damiao
from tests.bridge.deployments import CONFIGS, document, named, system_of
from tests.bridge.drives.test_host import cia402

DRIVES = CONFIGS / "drives"
FILES = sorted(path.stem for path in (CONFIGS / "deploy").glob("*.toml"))
OWN = """VERSION ""

NS_ :

BS_:

BU_: A

BO_ {number} OWN: 8 A
 SG_ s1 : 0|16@1- (0.001,0) [-32|32] "" A
 SG_ s2 : 16|16@1- (0.001,0) [-32|32] "" A
"""


def said(system):
    """Sentences of what collides."""
    return [f"{f.where}: {f.reason}" for f in collisions(system)]


def taken(system, bus):
    return {claim.identifier for claim in claims(system, bus)}


def own(folder, number):
    """can-damiao.toml with a message of ours among the motors' frames."""
    path = folder / f"{number}.dbc"
    path.write_text(OWN.format(number=number))
    found = damiao()
    found["buses"]["left"]["dbc"] = str(path)
    found["messages"]["OWN"] = {"bus": "left", "carries": ["master_control.s"]}
    return system_of(found, folder)


@pytest.mark.parametrize("name", FILES)
def test_the_deployments_that_come_with_it_pass_without_a_warning(name):
    found = deployment.check(named(name))
    assert [f for f in found if f.severity != "note"] == []


def test_all_frames_of_drives_are_known():
    """Damiao: commands, feedback and answers, and registers that all motors share."""
    assert taken(named("can-damiao"), "left") == {0x001, 0x002, 0x011, 0x012, 0x7FF}


def test_drives_of_two_protocols_share_no_identifier(tmp_path):
    """A profile without the base of the others is another maker's, whatever its bytes are."""
    (tmp_path / "other.toml").write_bytes((DRIVES / "damiao.toml").read_bytes())
    (tmp_path / "damiao.dbc").write_bytes((DRIVES / "damiao.dbc").read_bytes())
    found = damiao(profile=str(tmp_path / "other.toml"))
    found["messages"]["master_state_1"]["profile"] = str(tmp_path / "other.toml")
    sentences = said(system_of(found, tmp_path))
    assert any("identifier 0x7ff is used by register frames" in sentence for sentence in sentences)


def test_all_frames_of_canopen_drives_and_of_their_host_are_known(tmp_path):
    """PDOs, NMT and SYNC; EMCY, SDO and heartbeat of each drive; the heartbeat of the host."""
    system = cia402(tmp_path)
    bases = (0x200, 0x180, 0x280, 0x080, 0x580, 0x600, 0x700)
    drives = {base + n for base in bases for n in (1, 2)}
    assert taken(system, "left") == {0x000, 0x080, 0x702} | drives
    assert taken(system, "right") == {0x000, 0x080, 0x704} | drives
    title = load_profile(DRIVES / "cia402.toml").title
    assert said(system) == [  # node 2 commands a drive that has number 2
        f"bus left: identifier 0x702 is used by the heartbeat of drive 2 ({title}) and by the "
        "CANopen heartbeat of master_control"
    ]
    assert "identifier" in {f.rule for f in deployment.check(system) if f.severity == "error"}


@pytest.mark.parametrize(
    ("service", "signals", "party"),
    [
        ("ESTOP", ["node", "reasons"], "0x001 is used by {} and by ESTOP, a service of the bus"),
        ("NMT", ["command", "node"], "0x000 is used by {} and by NMT, a service of the bus"),
        ("HEARTBEAT_1", ["state", "boots"], "0x701 is used by {} and by HEARTBEAT_1 of master"),
    ],
)
def test_a_message_with_the_identifier_of_a_service_is_refused(tmp_path, service, signals, party):
    found = document("can")
    found["messages"]["EXTRA"] = {
        "bus": "left", "name": service, "signals": signals, "carries": ["master_control.s"],
    }  # fmt: skip
    system = system_of(found, tmp_path)
    sentence = f"bus left: identifier {party.format('message EXTRA of master_control')}"
    assert said(system) == [sentence]
    assert [f.reason for f in deployment.check(system) if f.severity == "error"] == [
        sentence.removeprefix("bus left: ")
    ]


@pytest.mark.parametrize(
    ("number", "party"),
    [(0x7FF, "register frames to drive 1"), (0x012, "message master_state_2 of master")],
)
def test_a_message_with_an_identifier_of_a_drive_is_refused(tmp_path, number, party):
    """Also one that no message of the deployment has."""
    found = said(own(tmp_path, number))
    assert len(found) == 1 and f"identifier {number:#05x} is used by " in found[0]
    assert party in found[0] and "message OWN of master_control" in found[0]
    assert said(own(tmp_path, 0x300)) == []


def test_a_command_with_the_identifier_of_another_drive_s_feedback_is_refused(tmp_path):
    assert said(system_of(damiao(drive=0x11), tmp_path)) == [
        "bus left: identifier 0x011 is used by message master_state_1 of master and by message "
        "master_tau_1 of master_control"
    ]


def test_what_drives_say_unasked_is_known(tmp_path):
    """ODrive: 32 n + 1 is its heartbeat, which no message of a deployment names."""
    found = damiao(profile=str(DRIVES / "odrive.toml"), drive=3)
    assert 32 * 3 + 1 in taken(system_of(found, tmp_path), "left")


def test_two_messages_to_one_drive_are_refused(tmp_path):
    (error,) = [
        f for f in deployment.check(system_of(damiao(drive=2), tmp_path)) if f.severity == "error"
    ]
    assert error.reason.startswith("identifier 0x002 is used by message")
