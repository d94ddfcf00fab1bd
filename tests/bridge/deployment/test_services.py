"""Services belong to their own bus, and a frame is a service only in the right format."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from bridge.native.bus import FORMAT, Accept
from bridge.native.frame import Flags, Frame
from bridge.native.message import Decoded, Header
from bridge.native.safety import LifeState, Why
from cosim.base.errors import ScenarioError
from tests.bridge.deployments import document, named, system_of
from tests.bridge.slots import Slots

NMT, ESTOP, SYNC, HEARTBEAT, STATE, STRANGER = 0x000, 0x001, 0x080, 0x701, 0x4A1, 0x123
FORMATS = [
    Flags(sum(flags))
    for n in range(4)
    for flags in itertools.combinations((Flags.FD, Flags.REMOTE, Flags.EXTENDED), n)
]
STOP, ARM, RESET, START = 2, 128, 129, 1


def alone(folder, *settings):
    """``master_control`` of can.toml, which needs nobody else to go on."""
    found = document("can")
    found["nodes"]["master_control"] |= {"requires": [], "stale": {}}
    return system_of(found, folder, *settings)


# ---- the format of a frame --------------------------------------------------------------------


def payloads(system):
    """Of a good frame of each kind: what it has to be to be taken."""
    service = system.services["left"]
    header = Header(status=LifeState.ACTIVE | 128)
    return {
        NMT: service.nmt.encode([STOP, 0]),
        ESTOP: service.estop.encode([1, 0]),
        SYNC: service.sync.encode([1]),
        HEARTBEAT: service.heartbeats[1].encode([LifeState.ACTIVE, 0, 1, 1]),
        STATE: system.messages["STATE_1"].encoding.frame([0.0] * 4, header).payload,
        STRANGER: bytes(8),
    }


def taken(slots, row):
    """Identifiers of the frames that the node has obeyed or counted in this slot."""
    receiver, peer = slots.wired.receivers["STATE_1"], slots.wired.peers["master"]
    found = {
        NMT: row["commands"] != 0,
        ESTOP: row["now"] & Why.ESTOP != 0,
        SYNC: slots.struct.syncs_received > 0,
        HEARTBEAT: peer.state >= 0,
        STATE: receiver.ok + receiver.repeated + receiver.length > 0,
    }
    slots.struct.syncs_received, peer.state = 0, -1
    receiver.ok = receiver.repeated = receiver.length = 0
    return {number for number, yes in found.items() if yes}


def wanted(number, flags, longer):
    """What is to be obeyed or counted, by the rules of docs/can.md."""
    if flags & (Flags.REMOTE | Flags.EXTENDED):
        return False
    if number == ESTOP:
        return True  # classic or CAN FD, of any length
    if number == STATE:
        return flags == Flags.FD  # of another length: counted as that
    return number != STRANGER and not flags and longer == 0


def test_a_frame_is_taken_in_the_right_format_only(tmp_path):
    """All combinations of identifier, remote, 11 or 29 bits, classic or CAN FD, and length."""
    system = alone(tmp_path)
    table = list(itertools.product(payloads(system).items(), FORMATS, (-1, 0, 3, 50)))
    with Slots(system, "master_control", tmp_path) as slots:
        slots.begin()
        bus, foreign = slots.buses["left"].struct, 0
        for k, ((number, payload), flags, longer) in enumerate(table):
            data = (payload + bytes(64))[: min(64, len(payload) + longer)]
            slots.put("left", Frame.of(number, data, flags), 0.005 * k)
            expected = {number} if wanted(number, flags, longer) else set()
            assert taken(slots, slots.step()) == expected, (hex(number), flags, longer)
            known = number != STRANGER and not flags & (Flags.REMOTE | Flags.EXTENDED)
            known = known and (number == ESTOP or (flags == Flags.FD) == (number == STATE))
            foreign += not known  # it is seen, and counted as nothing of ours
            assert bus.foreign + slots.struct.unknown == foreign
    assert len(table) == 6 * 8 * 4


def test_what_a_node_accepts_is_told_to_its_buses():
    system = named("can")
    found = {(a.id, a.flags, a.flag_mask) for a in system.accepts("master", "left")}
    assert (0x3A2, Flags.FD, FORMAT) in found  # LINK_2
    assert (NMT, 0, FORMAT) in found and (SYNC, 0, FORMAT) in found
    assert (ESTOP, 0, FORMAT & ~Flags.FD) in found
    assert all(a.mask == 0xFFFFFFFF for a in system.accepts("master", "left"))


def test_the_kernel_is_asked_for_format_and_remote_frames():
    from bridge.can import socket

    data = socket._rule(Accept(0x123))
    assert data == (0x123).to_bytes(4, "little") + (0xDFFFFFFF).to_bytes(4, "little")
    long = socket._rule(Accept(0x18FF0000, 0x1FFF0000, Flags.EXTENDED))
    assert long == (0x98FF0000).to_bytes(4, "little") + (0xDFFF0000).to_bytes(4, "little")


# ---- whose services -----------------------------------------------------------------------------


def numbers(slots, bus):
    """Identifiers sent on a bus, and how often."""
    found = [f.id for b, f in slots.sent if b == bus]
    return {number: found.count(number) for number in set(found)}


def test_on_a_bus_of_drives_there_is_nothing_but_their_frames(tmp_path):
    """Also in an emergency: the ESTOP of the link is torque 0 for the motors, not a frame there."""
    system = named("can-damiao", "run.stop=0.6")
    estop = system.services["link"].estop
    with Slots(system, "master_control", tmp_path) as slots:
        for k in range(40):
            slots.put("link", estop.frame([4, 2], Header()), 0.02 + k * 0.001)
        rows = slots.run()
        motors, link = numbers(slots, "left"), numbers(slots, "link")
        command = system.messages["master_tau_1"].encoding
        said = [f.payload for b, f in slots.sent if b == "left" and f.id == 1]
        torques = [v[0] for ok, v, _ in map(command.decode, said) if ok is Decoded.OK]
    assert motors.keys() == {1, 2}
    assert link[ESTOP] == 10 and link[SYNC] and link[0x702]
    assert rows["state"][-1] == LifeState.FAULT and rows["scale"][-1] == 0.0
    assert abs(torques[-1]) < 0.01 and said[-1] == b"\xff" * 7 + b"\xfd"  # disabled at last


def test_a_motor_s_frame_of_identifier_1_is_no_emergency_stop(tmp_path):
    system = named("can-damiao", "run.stop=0.1")
    with Slots(system, "master_control", tmp_path) as slots:
        slots.put("left", Frame.of(ESTOP, bytes(5)), 0.02)
        slots.put("left", Frame.of(NMT, bytes([STOP, 0])), 0.02)
        rows = slots.run()
    assert not (rows["reasons"] & (Why.ESTOP | Why.COMMAND)).any()


def test_each_bus_has_its_own_identifiers(tmp_path):
    """One node on two buses: it obeys and says on each what that bus has."""
    other = tmp_path / "other.dbc"
    text = Path(document("can")["buses"]["right"]["dbc"]).read_text()
    for old, new in ((0x001, 0x010), (0x000, 0x020)):
        text = text.replace(f"BO_ {old} ", f"BO_ {new} ").replace(f"VAL_ {old} ", f"VAL_ {new} ")
    other.write_text(text)
    found = document("can")
    found["buses"]["right"]["dbc"] = str(other)
    found["nodes"]["master_control"] |= {"requires": [], "stale": {}}
    system = system_of(found, tmp_path, "run.stop=0.3")
    with Slots(system, "master_control", tmp_path) as slots:
        slots.put("right", Frame.of(ESTOP, bytes(5)), 0.05)  # not there
        slots.put("right", Frame.of(0x020, bytes([STOP, 0])), 0.05)
        rows = slots.run()
    assert rows["reasons"][-1] == Why.COMMAND
    with Slots(system, "master_control", tmp_path) as slots:
        slots.put("right", Frame.of(0x010, bytes(5)), 0.05)
        slots.run()
        assert numbers(slots, "left")[0x001] == 10 == numbers(slots, "right")[0x010]
        assert 0x010 not in numbers(slots, "left") and 0x001 not in numbers(slots, "right")


def test_a_bus_has_the_services_that_its_deployment_lists(tmp_path):
    found = document("can")
    found["buses"]["right"]["services"] = ["estop"]
    with pytest.raises(ScenarioError, match="slave sends heartbeats on no bus of slave_control"):
        system_of(found, tmp_path)
    found["nodes"]["slave_control"]["requires"] = []
    system = system_of(found, tmp_path, "run.stop=0.05")
    assert list(system.services["right"].named()) == ["ESTOP"]
    assert system.peers_of("slave") == ()
    with Slots(system, "slave_control", tmp_path) as slots:
        slots.run()
        assert numbers(slots, "right").keys() == {0x3A4}
        assert numbers(slots, "left").keys() == {0x704}


@pytest.mark.parametrize(
    ("bus", "listed", "sentence"),
    [
        ("left", ["estop"], r"estop on a bus with a drive's own frames \(master_tau_1\)"),
        ("link", ["estop", "alarm"], "Invalid enum value 'alarm'"),
    ],
)
def test_services_that_cannot_be_are_refused(bus, listed, sentence):
    with pytest.raises(ScenarioError, match=sentence):
        named("can-damiao", f"deploy.buses.{bus}.services={listed}")


def test_a_service_the_dbc_file_does_not_have_is_refused():
    with pytest.raises(ScenarioError, match="no message SYNC in a DBC file for sync"):
        named("can-damiao", 'deploy.buses.link.dbc=""', 'deploy.buses.link.services=["sync"]')
