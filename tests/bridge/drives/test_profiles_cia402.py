"""A CiA 402 drive configured and commanded over a bus, against a node of `canopen`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest

from bridge.drives import cia402
from bridge.drives.profile_files import load_profile
from bridge.drives.profiles import DriveProfile
from cosim.base.errors import CosimError, ScenarioError

canopen = pytest.importorskip("canopen")
from canopen import objectdictionary as od  # noqa: E402

NODE, HOST = 5, 1
SIZES = {8: od.UNSIGNED8, 16: od.UNSIGNED16, 32: od.UNSIGNED32}


@pytest.fixture(name="profile")
def profile_() -> DriveProfile:
    return load_profile(Path(__file__).resolve().parents[3] / "configs/drives/cia402.toml")


def dictionary() -> Any:
    """What a drive has of CiA 301 and CiA 402-2 for cyclic torque."""
    made = od.ObjectDictionary()
    single = {0x6040: 16, 0x6041: 16, 0x6060: 8, 0x6064: 32, 0x606C: 32, 0x6071: 16,
              0x6076: 32, 0x6077: 16, 0x1001: 8, 0x1017: 16}  # fmt: skip
    for index, bits in single.items():
        variable = od.ODVariable(f"{index:04X}", index)
        variable.data_type, variable.default = SIZES[bits], 0
        made.add_object(variable)
    records = {0x1016: {0: 8, 1: 32}}
    for communication, mapping, _, objects in cia402.PDOS:
        records[communication] = {0: 8, 1: 32, 2: 8}
        records[mapping] = {0: 8, **dict.fromkeys(range(1, len(objects) + 1), 32)}
    for index, members in records.items():
        record = od.ODRecord(f"{index:04X}", index)
        for sub, bits in members.items():
            variable = od.ODVariable(f"{index:04X}sub{sub}", index, sub)
            variable.data_type, variable.default = SIZES[bits], 0
            record.add_member(variable)
        made.add_object(record)
    return made


def connected(channel: str) -> Any:
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.02  # s it takes to disconnect
    network.connect(interface="virtual", channel=channel)
    return network


class DriveNode:
    """The drive's end: a local node with the objects of a drive."""

    def __init__(self, channel: str) -> None:
        self.network = connected(channel)
        self.node = self.network.create_node(NODE, dictionary())
        self.node.sdo[0x6076].raw = 1000  # mN.m

    def held(self, index: int, sub: int = 0) -> int:
        return int.from_bytes(self.node.get_data(index, sub), "little")


@pytest.fixture(name="drive")
def drive_(request: pytest.FixtureRequest) -> Iterator[DriveNode]:
    drive = DriveNode(request.node.name)
    yield drive
    drive.network.disconnect()


@pytest.fixture(name="sdo")
def sdo_(request: pytest.FixtureRequest, drive: DriveNode) -> Iterator[Any]:
    network = connected(request.node.name)
    yield network.add_node(NODE, od.ObjectDictionary()).sdo
    network.disconnect()


def test_a_drive_is_configured(drive: DriveNode, sdo: Any, profile: DriveProfile) -> None:
    cia402.configure(sdo, profile, NODE, HOST, 0.05)
    assert drive.held(0x6060) == 10
    assert drive.held(0x1016, 1) == HOST << 16 | 50
    assert drive.held(0x1600, 3) == 0x6071_00_10
    assert [drive.held(record, 1) for record in (0x1400, 0x1800, 0x1801)] == [0x205, 0x185, 0x285]


def test_the_pdos_mapped_are_those_of_the_dbc(profile: DriveProfile) -> None:
    """Objects in the order and with the bits of the signals; identifiers as well."""
    parts = (profile.command, *profile.feedback)
    for (_, _, cob_id, objects), part in zip(cia402.PDOS, parts, strict=True):
        layout = profile.layout(part, NODE)
        assert layout.identifier == cob_id + NODE
        places = [(signal.start, signal.length) for signal in layout.signals]
        starts = [sum(bits for _, bits in objects[:n]) for n in range(len(objects))]
        assert places == [(a, bits) for a, (_, bits) in zip(starts, objects, strict=True)]


def test_a_pdo_of_ours_arrives_in_the_drive_s_objects(
    request: pytest.FixtureRequest, drive: DriveNode, sdo: Any, profile: DriveProfile
) -> None:
    cia402.configure(sdo, profile, NODE, HOST, 0.05)
    drive.node.rpdo.read()
    codec = profile.codec(profile.command, NODE)
    gain, _ = profile.conversion(profile.command, "tau")
    with can.Bus(interface="virtual", channel=request.node.name) as bus:
        bus.send(
            can.Message(
                arbitration_id=codec.layout.identifier, data=codec.encode([0.123 / gain]),
                is_extended_id=False,
            )
        )  # fmt: skip
        assert drive.node.rpdo[1].wait_for_reception(timeout=60)
    received = drive.node.rpdo[1]
    assert [variable.raw for variable in received.map] == [0x0F, 10, 123]


def test_another_rated_torque_is_refused(drive: DriveNode, sdo: Any, profile: DriveProfile) -> None:
    drive.node.sdo[0x6076].raw = 2000
    with pytest.raises(CosimError, match=r"rated torque \(0x6076\) is 2 N.m, expected 1 N.m"):
        cia402.configure(sdo, profile, NODE, HOST, 0.05)


def test_what_does_not_hold_what_was_written_is_refused(profile: DriveProfile) -> None:
    class Forgetful:
        def upload(self, index: int, subindex: int) -> bytes:
            return (1000 if index == 0x6076 else 0).to_bytes(4, "little")

        def download(self, index: int, subindex: int, data: bytes) -> None:
            pass

    with pytest.raises(CosimError, match=r"object 0x6060:0 reads 0x0, expected 0xa"):
        cia402.configure(Forgetful(), profile, NODE, HOST, 0.05)
    with pytest.raises(ScenarioError, match="is off"):
        cia402.configure(Forgetful(), profile, NODE, HOST, 0.0)
