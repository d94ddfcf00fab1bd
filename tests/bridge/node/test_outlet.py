"""Messages of an outlet: their status, numbers and times, and torques for drives that are off."""

from __future__ import annotations

import ctypes as c

import pytest

from bridge.native.commanded import Phase
from bridge.native.safety import LifeState, Status, Why
from tests.bridge.deployments import document, named, system_of
from tests.bridge.node.test_service import slot
from tests.bridge.slots import Slots

ACTIVE, INACTIVE, STOPPING = LifeState.ACTIVE, LifeState.INACTIVE, LifeState.STOPPING


def control(folder, **guard):
    """``master_control`` of can.toml, which sends LINK_2 in each slot of 5 ms."""
    found = document("can")
    found["nodes"]["master_control"] |= {"requires": [], "stale": {}}
    found["nodes"]["master_control"]["guard"] |= guard
    return Slots(system_of(found, folder), "master_control", folder)


def lives(node, state, *, armed=0, reasons=0):
    life = node.struct.life
    life.state, life.armed, life.reasons = state, armed, reasons
    life.ramp, life.ramp_ticks = 98, 100


def said(node):
    """(values, header) of LINK_2 in the next slot, and its row."""
    encoding = node.system.messages["LINK_2"].encoding
    frames = slot(node).get(encoding.message.id, [])
    decoded = [encoding.decode(frame.payload)[1:] for frame in frames]
    return decoded, node.wired.journal.rows[-1]


STATUS = [  # life, begun, armed, reasons -> status
    (ACTIVE, 1, 1, 0, ACTIVE | Status.DEADMAN), (ACTIVE, 1, 0, 0, ACTIVE),
    (INACTIVE, 1, 0, 0, STOPPING), (INACTIVE, 0, 0, 0, INACTIVE),
    (INACTIVE, 0, 1, 0, INACTIVE | Status.DEADMAN), (STOPPING, 1, 0, 0, STOPPING),
    (LifeState.FAULT, 1, 0, Why.ESTOP, LifeState.FAULT | Status.ESTOP),
    (LifeState.FAULT, 1, 0, Why.STALE, LifeState.FAULT | Status.STALE),
    (LifeState.FAULT, 1, 0, Why.PEER | Why.GUARD, LifeState.FAULT),
    (LifeState.FAULT, 1, 0, Why.ESTOP | Why.STALE, LifeState.FAULT | Status.ESTOP | Status.STALE),
    (LifeState.FINISHED, 1, 0, 0, LifeState.FINISHED),
]  # fmt: skip


@pytest.mark.parametrize("simulated", [0, 1])
@pytest.mark.parametrize(("life", "begun", "armed", "reasons", "status"), STATUS)
def test_a_status_tells_life_arming_and_reasons(
    tmp_path, life, begun, armed, reasons, status, simulated
):
    """Samples belong to the run from its start on, also if the node is INACTIVE again."""
    with control(tmp_path) as node:
        node.begin()
        node.struct.simulated, node.struct.begun = simulated, begun
        lives(node, life, armed=armed, reasons=reasons)
        ((_, header),), row = said(node)
        limited = Status.SATURATED if row["guard"] else 0
        assert header.status == status | limited | (Status.SIMULATED if simulated else 0)


@pytest.mark.parametrize(("tau_max", "limited"), [("100 N.m", False), ("1e-9 N.m", True)])
def test_a_status_tells_that_a_guard_limits(tmp_path, tau_max, limited):
    with control(tmp_path, tau_max=tau_max, rate_max="1e9 N.m/s") as node:
        node.begin()
        found = [said(node) for _ in range(6)]
        told = [bool(sent[0][1].status & Status.SATURATED) for sent, _ in found]
        assert told == [bool(row["guard"]) for _, row in found]
        assert any(told) is limited


@pytest.mark.parametrize("every", [1, 3])
@pytest.mark.parametrize("phase", [0, 700_000])
def test_numbers_and_times_are_those_of_the_slots_that_send(tmp_path, every, phase):
    with control(tmp_path) as node:
        node.begin()
        s = node.struct
        s.phase_ns = phase
        for outlet in s.outlets[: s.n_outlets]:
            outlet.every = every
        before = [outlet.sent for outlet in s.outlets[: s.n_outlets]]
        found = [said(node)[0] for _ in range(7)]
        assert [len(sent) for sent in found] == [k % every == 0 for k in range(7)]
        numbers = [(header.counter, header.t_us) for sent in found for _, header in sent]
        times = [(5_000_000 * k + phase) // 1000 for k in range(0, 7, every)]
        assert numbers == list(enumerate(times))
        after = [outlet.sent for outlet in s.outlets[: s.n_outlets]]
        assert [b - a for a, b in zip(before, after, strict=True)] == [len(times)] * len(after)


def test_a_frame_is_sent_at_the_deadline_of_its_slot(tmp_path):
    with control(tmp_path) as node:
        node.begin()
        node.struct.phase_ns = 700_000
        identifier = node.system.messages["LINK_2"].encoding.message.id
        times = [frame.t_ns for _ in range(3) for frame in slot(node)[identifier]]
        assert times == [700_000, 5_700_000, 10_700_000]


@pytest.mark.parametrize("phase", list(Phase))
def test_a_drive_that_does_not_serve_is_sent_no_torque(tmp_path, phase):
    """Its torques are 0 in the journal; the other drive of the node gets its own."""
    with Slots(named("can-damiao"), "master_control", tmp_path) as node:
        node.begin()
        s, drives = node.struct, node.wired.commanded.structs
        for drive in drives:
            drive.n_told = 0
        for inlet in s.inlets[: s.n_inlets]:
            inlet.stop_ns = 0
        sent = {1: [], 2: []}
        for _ in range(8):
            lives(node, ACTIVE, armed=1)
            s.life.now = 0
            drives[0].phase, drives[0].let_down = phase, 1
            drives[1].phase = Phase.SERVING
            frames = slot(node)
            for number, found in sent.items():
                found.append(len(frames.get(number, [])))
        assert sent[2] == [1] * 8
        if phase is Phase.SERVING:
            assert sent[1] == [1] * 8
        else:
            outlets = [o for o in s.outlets[: s.n_outlets] if o.commanded]
            assert not any((c.c_double * outlets[0].width).from_address(outlets[0].values))


@pytest.mark.parametrize(("reasons", "off"), [(Why.DRIVE, True), (Why.DRIVE | Why.PEER, True),
                                              (Why.PEER, False), (0, False)])  # fmt: skip
def test_a_drive_of_our_own_protocol_that_is_off_gets_no_torque(tmp_path, reasons, off):
    """Also while its node ramps down."""
    with control(tmp_path) as node:
        node.begin()
        for _ in range(20):
            said(node)
        torques = []
        for _ in range(5):
            lives(node, STOPPING, reasons=reasons)
            ((values, _),), _ = said(node)
            torques.append(any(values[:2]))
        assert torques == [not off] * 5
