"""A node brings its drives up step by step, feeds them, obeys what they tell, and disables them."""

from __future__ import annotations

import ctypes as c
import re

import numpy as np
import pytest

from bridge.deployment.drive_sequences import commanded_drives
from bridge.native import node as native
from bridge.native.commanded import Failure
from bridge.native.frame import Frame
from bridge.native.safety import Command, LifeState, Why
from bridge.native.vendor import VendorFault
from bridge.node.missing_inputs import report_missing_inputs
from cosim.base.clock import monotonic_ns
from tests.bridge.bench import until
from tests.bridge.deployments import named
from tests.bridge.gates import Gate
from tests.bridge.node.motors import MS, Motors

ENABLE, DISABLE, CLEAR = (bytes([255] * 7 + [last]) for last in (0xFC, 0xFD, 0xFB))
JUMPS = "deploy.nodes.master_control.guard.q_jump=1000"  # motors are not where the scenario begins
DEAF = ("deploy.nodes.master_control.stale={}", "deploy.silence=0")
CALM = "deploy.nodes.master_control.overrun='20 s'"  # a busy machine is no reason to stop
STALE = 'deploy.nodes.master_control.stale={{"master_control.q"={{stop="{}"}}}}'
LONG = ("run.stop=30", JUMPS, CALM, *DEAF)
#: Deployment, number of its host, and identifiers of what feeds drive n of it.
DEPLOYMENTS = {
    "can-damiao": (0, lambda n: n),
    "can-cia402": (2, lambda n: 0x700 + 2),
    "six_axis": (0, lambda n: n << 5 | 0x0E),
}


def gate(name, folder, *settings):
    """The node ``master_control`` of a deployment, waiting."""
    found = Gate(named(name, *LONG, *settings), "master_control", folder, start=False)
    for struct in found.wired.commanded.structs:  # a busy machine may let motors wait
        struct.within_ns = max(struct.within_ns, 1000 * MS)
        for step in struct.steps[: struct.n_steps]:
            step.within_ns = max(step.within_ns, 1000 * MS)
    return found


def ready(node):
    return bool(native.functions().bringup_ready(c.byref(node.struct), monotonic_ns()))


def failures(node):
    return "; ".join(node.wired.commanded.given_up())


def begin(node):
    """ARM, and START when the drives are ready."""
    node.control.arm()
    until(lambda: ready(node))
    node.control.start(monotonic_ns() + 300 * MS)
    until(lambda: node.struct.begun and node.struct.slot > 5)


def payloads(motors, identifier, bus="left"):
    return [f.payload for f in list(motors.sent[bus]) if f.id == identifier]


@pytest.mark.parametrize("name", DEPLOYMENTS)
def test_drives_are_enabled_before_the_run_and_disabled_behind_it(name, tmp_path):
    host, _ = DEPLOYMENTS[name]
    with gate(name, tmp_path) as node, Motors(node, host, timeout=5.0) as motors:
        assert not any(own.acts for _, own in motors.motors) and not ready(node)
        begin(node)
        assert all(own.acts for _, own in motors.motors)
        assert node.struct.life.state == LifeState.ACTIVE
        node.control.quit()
        until(lambda: not any(own.acts for _, own in motors.motors))
        assert all(own.refused == 0 and own.trips == 0 for _, own in motors.motors)


@pytest.mark.parametrize("name", DEPLOYMENTS)
def test_they_are_fed_from_their_enabling_to_their_disabling(name, tmp_path):
    """In any two watchdog times there are two frames at least, in every phase of the node.

    Best of five: a busy machine delays some frames of a node without real-time permissions.
    """
    host, fed_by = DEPLOYMENTS[name]
    fewest = []
    for turn in range(5):
        folder = tmp_path / str(turn)
        folder.mkdir()
        with gate(name, folder) as node, Motors(node, host, timeout=5.0) as motors:
            begin(node)
            until(lambda node=node: node.struct.slot > 40)
            node.control.stop()
            until(lambda node=node: node.result is not None)
            drive = node.wired.commanded.drives[0]
            sent = np.array([f.t_ns for f in motors.sent[drive.bus] if f.id == fed_by(drive.node)])
        twice = 2e9 * drive.profile.timeout
        starts = np.arange(sent[0], sent[-1] - twice, twice / 10)
        found = np.searchsorted(sent, starts + twice) - np.searchsorted(sent, starts)
        fewest.append(int(found.min()))
        if fewest[-1] >= 2:
            return
    raise AssertionError(f"fewest frames in two watchdog times: {fewest}")


def test_the_frames_come_in_the_order_of_the_profile(tmp_path):
    with gate("can-damiao", tmp_path) as node, Motors(node, timeout=5.0) as motors:
        until(lambda: node.struct.beats > 2)
        assert motors.sent["left"] == []  # nothing before ARM
        node.control.arm()
        until(lambda: ready(node))
        registers = payloads(motors, 0x7FF)
        assert [r[2] for r in registers if r[0] == 1] == [0x55, 0x33]
        assert int.from_bytes(registers[0][4:], "little") * 50e-6 == pytest.approx(0.05)
        said = [p for p in payloads(motors, 1) if p[:7] == ENABLE[:7]]
        assert said == [CLEAR, ENABLE]
        assert motors[0].word == 1000  # the register TIMEOUT, in 50 us


def test_nothing_is_sent_to_a_drive_whose_watchdog_reads_another_value(tmp_path):
    with gate("can-damiao", tmp_path) as node, Motors(node) as motors:
        node.wired.commanded.structs[0].steps[0].frame.data[4] ^= 1  # another value is written
        node.control.arm()
        until(lambda: node.struct.life.state == LifeState.FAULT)
        assert Why.DRIVE in Why(node.struct.life.reasons)
        assert (
            "drive 1 on bus left is not enabled: its TIMEOUT (9) reads 0.05005 s, not 0.05 s"
            in failures(node)
        )
        assert ENABLE not in payloads(motors, 1)


def test_a_drive_that_is_not_there_is_named_with_what_was_expected(tmp_path):
    with gate("can-cia402", tmp_path) as node, Motors(node, host=2) as motors:
        motors.fault(1, VendorFault.UNPLUG)
        node.control.arm()
        until(lambda: node.struct.life.state == LifeState.FAULT)
        assert "drive 12 on bus left did not follow: expected" in failures(node)
        assert "it tells nothing" in failures(node)
        assert not motors[1].acts


def test_a_drive_that_refuses_its_enabling_is_named_with_its_error(tmp_path):
    with gate("can-damiao", tmp_path) as node, Motors(node, timeout=5.0) as motors:
        motors.fault(1, VendorFault.HOT, 2)
        node.control.arm()
        until(lambda: node.struct.life.state == LifeState.FAULT)
        assert "expected disabled or enabled, it tells ROTOR_OVER_TEMPERATURE" in failures(node)
        until(lambda: not motors[0].acts)


FAULTS = {
    "can-damiao": [(VendorFault.TRIP, 0xA, "OVER_CURRENT"), (VendorFault.OTHER_ID, 1, "told")],
    "can-cia402": [(VendorFault.TRIP, 0x2310, "fault"), (VendorFault.REBOOT, 0, "told nothing")],
    "six_axis": [(VendorFault.TRIP, 0x1000, "CURRENT_LIMIT"), (VendorFault.UNPLUG, 0, "nothing")],
}


@pytest.mark.parametrize(
    ("name", "fault"), [(name, fault) for name, all_ in FAULTS.items() for fault in all_]
)
def test_a_drive_that_leaves_enabled_stops_its_node(name, fault, tmp_path):
    kind, code, said = fault
    host, _ = DEPLOYMENTS[name]
    with gate(name, tmp_path) as node, Motors(node, host, timeout=5.0) as motors:
        begin(node)
        motors.fault(1, kind, code)
        until(lambda: node.struct.life.state == LifeState.FAULT)
        assert Why.DRIVE in Why(node.struct.life.reasons)
        assert said in failures(node)
        until(lambda: not motors[0].acts)
        rows = node.wired.journal.rows.copy()
        events = node.wired.commanded.events()
    lost = [e for e in events if e["phase"] == "failed"]
    assert lost and "bus left" in lost[0]["drive"]
    stopped = int((rows["reasons"] & Why.DRIVE != 0).argmax())
    assert rows["serving"][stopped] & 2 == 0  # none from the slot on that learns of it
    assert rows["serving"][stopped - 1] & 2 == 2


def test_start_waits_for_the_drives_and_is_refused_where_they_are_not_ready(tmp_path):
    with gate("can-damiao", tmp_path) as node, Motors(node) as motors:
        node.control.start(monotonic_ns() + 400 * MS)  # a rehearsal arms itself
        until(lambda: node.struct.begun and node.struct.slot > 5)
        assert motors[0].refused == 0 and node.struct.refusals == 0
    (tmp_path / "b").mkdir()
    with gate("can-damiao", tmp_path / "b") as node:  # no drive is there
        node.control.start(monotonic_ns() + 400 * MS)
        until(lambda: node.struct.refusals or node.struct.life.state == LifeState.FAULT)
        assert not node.struct.begun


def test_a_restart_after_a_fault_brings_them_up_again(tmp_path):
    with gate("can-damiao", tmp_path) as node, Motors(node, timeout=5.0) as motors:
        begin(node)
        motors.fault(0, VendorFault.TRIP, 0x8)
        until(lambda: node.struct.life.state == LifeState.FAULT and not motors[1].acts)
        count = len(motors.sent["left"])
        for command in (Command.RESET, Command.ARM, Command.START):
            native.functions().node_tell(c.byref(node.struct), command)
        until(lambda: node.struct.life.state == LifeState.ACTIVE)
        said = [f.payload for f in motors.sent["left"][count:] if f.id == 1]
        assert said.index(CLEAR) < said.index(ENABLE)
        gone = next(e["t"] for e in node.wired.commanded.events() if e["phase"] == "failed")
        between = [
            f.payload
            for f in motors.sent["left"][:count]
            if f.id == 1 and f.t_ns > node.struct.start_ns + gone * 1e9
        ]
        assert between and set(between) == {DISABLE}
        assert all(own.acts for _, own in motors.motors)
        assert motors[1].refused == 0
        assert Failure(node.wired.commanded.structs[0].failure) is Failure.NOT


def test_positions_have_to_be_those_of_now(tmp_path):
    with gate("can-cia402", tmp_path) as node, Motors(node, host=2, timeout=5.0) as motors:
        node.control.arm()
        until(lambda: ready(node))
        q = node.wired.inlet_bindings.inlets[0]
        start = c.c_double.from_address(q.initial).value
        assert start != -1.0471975511965976  # the scenario's
        motors.ended.set()  # nothing is told any more
        until(lambda: not ready(node))


def test_a_refused_start_names_the_drive_that_told_no_position(tmp_path):
    """Drives rest from then on, so what they lacked is kept."""
    said = []
    with gate("can-cia402", tmp_path) as node, Motors(node, host=2, timeout=5.0) as motors:
        node.control.arm()
        until(lambda: ready(node))
        motors.ended.set()
        until(lambda: not ready(node))
        with report_missing_inputs(node.wired, said.append, dict):
            node.control.start(monotonic_ns() + 200 * MS)
            until(lambda: any(e.get("event") == "refused" for e in said))
    why = next(e["why"] for e in said if e.get("event") == "refused")
    assert re.search(r"drive 11 (\(and 12\) )?on bus left has told no position for \d+ ms", why), (
        why
    )
    assert "brought up" not in why


def test_a_position_that_is_new_enough_for_the_run_is_so_for_the_start(tmp_path):
    patient = STALE.format("20 s")
    with gate("can-cia402", tmp_path, patient) as node, Motors(node, host=2, timeout=5.0):
        for struct in node.wired.commanded.structs:
            struct.within_ns = 30_000 * MS
        node.control.arm()
        until(lambda: ready(node))
        ask, at = native.functions().bringup_ready, monotonic_ns()
        found = [bool(ask(c.byref(node.struct), at + s * 1000 * MS)) for s in (8, 25, 40)]
        assert found == [True, False, False]


def test_the_answer_of_a_register_is_no_position_and_no_state(tmp_path):
    """It has the identifier of the feedback, and would be read as -12.48 rad, and as disabled."""
    answer = bytes.fromhex("01003309E8030000")
    with gate("can-damiao", tmp_path) as node, Motors(node, timeout=5.0):
        receiver = node.wired.receivers["master_state_1"]
        node.control.arm()
        until(lambda: ready(node))
        assert receiver.range == 0 and not node.struct.life.now & Why.JUMP  # before the start
        node.control.start(monotonic_ns() + 300 * MS)
        until(lambda: node.struct.begun and node.struct.slot > 5)
        node.put("left", Frame.of(0x11, answer))
        seen = node.struct.slot
        until(lambda: node.struct.slot > seen + 5)
        assert node.struct.life.state == LifeState.ACTIVE and receiver.range == 0


def test_all_drives_of_shipped_profiles_tell_states_and_expect_them():
    for name in DEPLOYMENTS:
        system = named(name)
        for drive in commanded_drives(system.deployment, system.nodes["master_control"]):
            assert drive.profile.status.message and drive.steps()
