"""Drives with their own protocols: their node disables them when its torque has ended."""

from __future__ import annotations

import numpy as np
import pytest

from bridge.deployment.drive_sequences import commanded_drives
from bridge.drives.profile_files import load_profile
from bridge.native import node as native
from bridge.native.frame import Flags, Frame
from bridge.native.safety import DriveState, LifeState, Why
from bridge.records.node_lives import Life
from bridge.replay import replay, twin
from tests.bridge.deployment.test_foreign import damiao
from tests.bridge.deployments import CONFIGS, named, system_of
from tests.bridge.drives.emulated import REQUESTS, EmulatedDrive
from tests.bridge.drives.test_host import cia402
from tests.bridge.slots import Slots

DAMIAO = load_profile(CONFIGS / "drives" / "damiao.toml")
ENABLE, DISABLE, CLEAR = (bytes([255] * 7 + [last]) for last in (0xFC, 0xFD, 0xFB))
RAMP = "deploy.nodes.master_control.ramp='50 ms'"
DEAF = ("deploy.nodes.master_control.stale={}", "deploy.silence=0")  # it needs to hear nothing


def stopped(system, folder, tell=lambda slots: None, slots_before=20):
    """Rows, and the frames on the left bus, of a controller with an emergency stop in a slot."""
    with Slots(system, "master_control", folder) as slots:
        slots.begin()
        for _ in range(slots_before):
            slots.step()
        slots.struct.alarm = native.RAISED
        rows = slots.run(begin=False)
        return rows, [f for bus, f in slots.sent if bus == "left"]


def torque(frame):
    codec = DAMIAO.codec(DAMIAO.command, frame.id)
    return codec.decode(frame.payload)[1][0]


def test_an_emergency_stop_ramps_the_torque_to_0_and_then_disables_the_drives(tmp_path):
    rows, frames = stopped(named("can-damiao", "run.stop=0.5", RAMP, *DEAF), tmp_path)
    fault = int(np.flatnonzero(rows["state"] == LifeState.FAULT)[0])
    assert rows["state"][fault - 1] == LifeState.STOPPING
    first = next(i for i, f in enumerate(frames) if f.payload == DISABLE)
    torques, rest = frames[:first], frames[first:]
    assert [(f.id, f.payload) for f in rest[:2]] == [(1, DISABLE), (2, DISABLE)]
    assert all(f.payload == DISABLE for f in rest)  # no torque follows
    assert {f.id for f in torques[-2:]} == {1, 2}
    assert all(abs(torque(f)) < 0.003 for f in torques[-2:])  # the code next to 0
    told = np.flatnonzero(rows["flags"] & native.DISABLED)
    assert told[0] == fault and len(rest) == 2 * len(told)
    assert set(np.diff(told * 5)) == {100}  # ms: repeated as long as it is in FAULT


def test_a_node_that_never_stops_disables_nothing(tmp_path):
    with Slots(named("can-damiao", "run.stop=0.2", *DEAF), "master_control", tmp_path) as slots:
        rows = slots.run()
        assert not (rows["flags"] & (native.DISABLED | native.ENABLED)).any()
        assert DISABLE not in {f.payload for _, f in slots.sent}


def test_no_torque_follows_that_a_cia_402_drive_would_take_for_enabling(tmp_path):
    """Its command frame carries the controlword 0x0F: operation enabled."""
    _, frames = stopped(cia402(tmp_path, "run.stop=0.5"), tmp_path)
    commands = [f.payload for f in frames if f.id == 0x201]
    off = bytes.fromhex("06000A0000")
    first = commands.index(off)
    assert set(commands[first:]) == {off}
    assert commands[first - 1] == bytes.fromhex("0F000A0000")  # torque 0, while enabled


# ---- emulated drives ------------------------------------------------------------------------


def commands(system, n, tau=1.0):
    """A torque command for drive n, as its controller writes it."""
    return Frame.of(n, DAMIAO.codec(DAMIAO.command, n).encode([tau]))


def drive_states(system, folder, *frames):
    """States of the drive of motor 1 after each slot of its node; frames by slot."""
    with Slots(system, "master", folder) as slots:
        slots.begin()
        states, torques = [], []
        for k in range(12):
            h = slots.struct.h_ns * 1e-9
            for data in [f for slot, f in frames if slot == k]:
                slots.put("left", Frame.of(1, data), k * h)
            slots.put("left", commands(system, 1), k * h)
            row = slots.step()
            states.append(DriveState(slots.wired.drives[0].state))
            torques.append(row["signals"][slots.wired.inlet_bindings.inlets[0].target])
        invalid = slots.wired.receivers["master_tau_1"].invalid
        return states, torques, invalid


@pytest.fixture
def system():
    return named("can-damiao", "run.stop=0.1", "run.step='5 ms'")


def test_an_emulated_drive_obeys_the_frames_of_its_protocol(system, tmp_path):
    states, torques, invalid = drive_states(system, tmp_path, (3, DISABLE), (8, ENABLE))
    on, off = DriveState.ENABLED, DriveState.READY
    assert states == [on] * 3 + [off] * 6 + [on] * 3  # enabled at its next cycle
    assert torques[4:8] == [0.0] * 4 and abs(torques[11] - 1.0) < 0.01
    assert invalid == 0


def test_a_torque_from_before_it_was_enabled_does_not_act(system, tmp_path):
    with Slots(system, "master", tmp_path) as slots:
        slots.begin()
        place, seen = slots.wired.inlet_bindings.inlets[0].target, []
        told = {0: commands(system, 1), 2: DISABLE, 4: ENABLE, 6: commands(system, 1)}
        for k in range(8):
            one = told.get(k)
            if one is not None:
                frame = one if isinstance(one, Frame) else Frame.of(1, one)
                slots.put("left", frame, k * slots.struct.h_ns * 1e-9)
            seen.append(slots.step()["signals"][place] > 0.5)
        assert seen == [False, True, True, False, False, False, False, True]  # of the slot before


def test_a_drive_hears_both_formats_but_no_frame_without_bit_rate_switch(tmp_path):
    fd = named(
        "can-damiao", "run.stop=0.1", "deploy.motors.master.fd=true", "deploy.buses.left.fd=true"
    )
    flags = Flags.FD | Flags.BRS
    sequences = commanded_drives(fd.deployment, fd.nodes["master_control"])[0].frames(*REQUESTS)
    assert [x.flags for x in sequences] == [flags] * 3
    for form, heard in ((Flags.FD, False), (0, True), (flags, True)):
        with Slots(fd, "master", tmp_path) as slots:
            slots.begin()
            slots.step()  # it answers the last command of its bring-up
            slots.put("left", Frame.of(1, DISABLE, form), 0.0005)
            slots.run(begin=False)
            assert (slots.wired.drives[0].state == DriveState.READY) == heard
            assert [f.flags for _, f in slots.sent if f.id == 0x11] == [flags] * heard


def test_a_frame_that_asks_for_more_than_torque_is_no_torque(system, tmp_path):
    gains = bytes.fromhex("7FFF7FF0A0FF" + "FFFF")  # a position gain
    states, torques, invalid = drive_states(system, tmp_path, (3, gains))
    assert set(states) == {DriveState.ENABLED} and invalid == 1
    assert max(torques) < 1.1


def test_a_drive_goes_on_when_the_node_of_its_plant_is_in_fault(system, tmp_path):
    """It has power of its own, and obeys the node that commands it."""
    with Slots(system, "master", tmp_path) as slots:
        slots.begin()
        slots.struct.life.now |= Why.PEER
        while slots.struct.life.state != LifeState.FAULT:
            at = slots.struct.slot * slots.struct.h_ns * 1e-9
            slots.put("left", commands(system, 1), at)
            slots.step()
        assert slots.wired.drives[0].state == DriveState.ENABLED
        slots.put("left", Frame.of(1, DISABLE), slots.struct.slot * slots.struct.h_ns * 1e-9)
        slots.step()
        assert slots.wired.drives[0].state == DriveState.READY


def test_a_run_whose_drives_are_disabled_and_enabled_replays_to_the_bit(tmp_path):
    system = system_of(damiao(), tmp_path, "run.stop=0.6", "run.step='5 ms'")
    with twin.wired_nodes(system, tmp_path) as nodes:
        nodes["master_control"].struct.alarm = native.RAISED
        twin.run(system, nodes)
    rows = replay.load(tmp_path)
    asked = rows[Life("master")]["inlets"]["requests"]
    acts = asked & 1
    assert set(np.unique(acts)) == {0, 1} and acts[0].all()
    (tmp_path / "again").mkdir()
    found = replay.replay(system, rows, replay.received_by_life(tmp_path), tmp_path / "again")
    assert (found.greatest, found.first) == (0.0, None)


def test_its_own_sequences_disable_the_emulated_drive_of_every_profile(tmp_path):
    for name in ("damiao", "odrive", "cia402"):
        profile = load_profile(CONFIGS / "drives" / f"{name}.toml")
        drive = EmulatedDrive(profile, 1, 1e-3)
        for sequence, state in (("enable", DriveState.ENABLED), ("disable", DriveState.READY)):
            for identifier, data in profile.frames(sequence, 1):
                drive.receive(identifier, data, 0)
            assert drive.state == state
