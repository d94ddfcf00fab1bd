"""A running node and its safety functions: start, refusals and end. The test acts as its peers."""

from __future__ import annotations

import ctypes as c
import threading
import time

import numpy as np
import pytest

from bridge.deployment.system import load_system
from bridge.native import node as native
from bridge.native.bus import Bus
from bridge.native.frame import Frame, Ring
from bridge.native.message import Header
from bridge.native.safety import Command, LifeState, Status, Why
from bridge.records.records import reason_names, refusal
from bridge.wiring import outlets
from bridge.wiring.wiring import WiredNode
from cosim.base.clock import monotonic_ns
from cosim.base.errors import ScenarioError
from tests.bridge.bench import Bench, until
from tests.bridge.deployments import TELEOPERATION

APART = 'deploy.nodes.master_control.apart={of="master.q",other="slave.q",within="0.1 rad"}'
LAW = 'components.master_control.model="tests.bridge.laws:Law"'


def start(bench, lead=0.3):
    time.sleep(0.1)
    bench.control.start(monotonic_ns() + round(lead * 1e9))


def refused(bench):
    until(lambda: bench.struct.refusals)
    assert bench.struct.life.state in (LifeState.INACTIVE, LifeState.FAULT)
    assert bench.struct.start_ns == 0
    return Why(bench.struct.refused)


def in_words(bench):
    return refusal(reason_names(bench.struct.refused), bool(bench.struct.life.armed))


# ---- starting -------------------------------------------------------------------------------


def test_nobody_starts_without_its_peers(tmp_path):
    with Bench(tmp_path, there=False) as bench:
        start(bench)
        assert refused(bench) == Why.PEER | Why.STALE
        assert "peer" in in_words(bench)
        bench.there = True  # refused is not stuck
        bench.begin()
        assert bench.struct.life.state == LifeState.ACTIVE


def test_a_peer_that_is_simulated_is_none_for_real_drives(tmp_path):
    with Bench(tmp_path, real=True, simulated=True) as bench:
        time.sleep(0.1)
        bench.control.arm()
        assert refused(bench) == Why.PEER | Why.STALE
        assert not bench.struct.life.armed


def test_arming_waits_for_a_peer_that_is_late(tmp_path):
    with Bench(tmp_path, real=True, there=False) as bench:
        bench.control.arm()
        time.sleep(0.1)
        assert bench.struct.refusals == 0 and not bench.struct.life.armed
        bench.there = True
        until(lambda: bench.struct.life.armed)
        bench.begin()
        assert bench.struct.refusals == 0


@pytest.mark.parametrize("cancel", ["stop", "reset"])
def test_arming_that_waits_is_cancelled(cancel, tmp_path):
    with Bench(tmp_path, real=True, there=False) as bench:
        bench.control.arm()
        if cancel == "reset":
            bench.control.reset()
        else:
            native.functions().node_tell(c.byref(bench.struct), Command.STOP)
            until(lambda: not bench.struct.told)
        bench.there = True
        bench.heard()
        start(bench)
        assert refused(bench) == Why.COMMAND  # not armed


def test_real_drives_need_arming(tmp_path):
    with Bench(tmp_path, "run.stop=0.5", real=True) as bench:
        start(bench)
        assert refused(bench) == Why.COMMAND
        assert in_words(bench) == "not armed"
        bench.control.arm()
        bench.begin()
        assert bench.end() == native.FINISHED
    assert not np.any(bench.torques[-1])
    late = [np.abs(t).max() for t in bench.torques[-18:-1]]
    assert late == sorted(late, reverse=True)  # ramped down within the run
    assert not any(header.status & Status.SIMULATED for _, header in bench.beats)


def test_real_drives_that_no_guard_limits_end_without_a_ramp(tmp_path):
    """Memory behind the last message that a node sends is not read as a message."""
    with Bench(tmp_path, "run.stop=0.2", real=True) as bench:
        bench.struct.n_outlets = 0
        until(lambda: bench.struct.life.state == LifeState.INACTIVE)
        bench.control.arm()
        bench.begin()
        assert bench.end() == native.FINISHED
        assert not bench.struct.ending


def test_arms_too_far_apart_do_not_start(tmp_path):
    bench = Bench(tmp_path, APART, "deploy.nodes.master_control.apart.within=0.05")
    bench.elsewhere = [0.0, 0.0]
    with bench:
        start(bench)
        assert refused(bench) == Why.APART
        bench.elsewhere = None
        bench.begin()


def test_an_encoder_that_jumps_before_the_start_is_a_fault(tmp_path):
    with Bench(tmp_path) as bench:
        bench.heard()
        bench.q = [1.0, 0.2]
        until(lambda: bench.struct.life.state == LifeState.FAULT)
        start(bench)
        assert refused(bench) & Why.JUMP
        bench.control.reset()
        bench.begin()


def test_more_joints_than_a_guard_takes_are_refused(monkeypatch, tmp_path):
    monkeypatch.setattr(outlets, "JOINTS", 1)
    with pytest.raises(ScenarioError, match="2 joints, expected at most 1"):
        Bench(tmp_path)


# ---- ending ---------------------------------------------------------------------------------


def test_a_rehearsal_has_its_torque_until_the_end_and_none_after_it(tmp_path):
    with Bench(tmp_path, "run.stop=0.2") as bench:
        bench.begin()
        assert bench.end() == native.FINISHED
        ended = monotonic_ns() - bench.struct.start_ns
        rows = bench.wired.journal.rows
        for before, after in (("woke", "received"), ("received", "done")):
            assert (rows[f"{before}_ns"] <= rows[f"{after}_ns"]).all()
        assert rows["done_ns"].max() <= ended
        assert 0 < bench.struct.send_ns < ended  # all the time that it took to send
    assert len(bench.wired.journal.path.read_bytes())
    assert not np.any(bench.torques[-1])
    assert np.any(bench.torques[-2])
    assert bench.beats[-1][0][0] == LifeState.FINISHED


@pytest.mark.parametrize("how", ["quit", "stop"])
def test_the_last_torque_is_zero(tmp_path, how):
    with Bench(tmp_path) as bench:
        bench.begin()
        getattr(bench.control, how)()
        assert bench.end() == native.STOPPED
    assert np.any(bench.torques)
    assert not np.any(bench.torques[-1])
    assert bench.beats[-1][0][0] == (LifeState.FAULT if how == "quit" else LifeState.INACTIVE)


def test_a_component_that_fails_is_let_down(tmp_path):
    with Bench(tmp_path, LAW, "components.master_control.parameters.t_bad=0.2") as bench:
        bench.begin()
        assert bench.end() > 0
    norms = [float(np.abs(t).max()) for t in bench.torques]
    top = max(i for i, n in enumerate(norms) if n == max(norms))
    ramp = norms[top:]
    assert ramp == sorted(ramp, reverse=True)
    assert len(set(ramp)) > 10
    assert ramp[-1] == 0.0
    assert bench.struct.life.state == LifeState.FAULT
    assert bench.struct.life.reasons & Why.COMPONENT


def test_nan_of_a_component_is_a_failure_of_it(tmp_path):
    settings = [f"components.master_control.parameters.{k}" for k in ("t_bad=0.1", "nan=1")]
    with Bench(tmp_path, LAW, *settings, "run.stop=0.5") as bench:
        bench.begin()
        assert bench.end() > 0
    assert bench.struct.life.reasons & Why.COMPONENT
    assert np.isfinite(bench.torques).all()
    assert not np.any(bench.torques[-1])


# ---- heartbeats, peers, emergency stop ------------------------------------------------------


def test_heartbeats_count_and_say_that_they_are_simulated(tmp_path):
    with Bench(tmp_path, boots=5000) as bench:
        until(lambda: len(bench.beats) > 20)
    counters = [header.counter for _, header in bench.beats]
    assert counters[:20] == [k % 16 for k in range(20)]
    assert all(header.status == Status.SIMULATED for _, header in bench.beats)
    assert {values[2] for values, _ in bench.beats} == {5000 % 4096}


def test_a_required_peer_that_goes_silent_stops_the_node(tmp_path):
    with Bench(tmp_path, 'deploy.nodes.master_control.within="1 s"', "run.stop=60") as bench:
        bench.begin()
        bench.there = False
        until(lambda: bench.struct.life.state == LifeState.FAULT)
        assert bench.struct.life.reasons & Why.PEER


def test_a_peer_that_has_restarted_may_count_anew(tmp_path):
    with Bench(tmp_path, "run.stop=60") as bench:
        bench.begin()
        receiver = bench.wired.receivers["LINK_4"]
        codec = bench.system.messages["LINK_4"].encoding
        t_us = (monotonic_ns() - bench.struct.start_ns) // 1000
        status = LifeState.ACTIVE | Status.SIMULATED
        header = Header(counter=t_us // 5000, status=status, t_us=t_us)
        bench.beat(4)
        bench.put("right", codec.frame([0.0] * 4, header, monotonic_ns()))
        until(lambda: receiver.ok == 1)
        assert receiver.sequence == t_us // 5000
        bench.boots[4] = 2
        bench.beat(4)
        until(lambda: receiver.sequence == -1)
        assert bench.struct.life.state == LifeState.ACTIVE


def estop(bench, bus="left"):
    encoding = bench.system.services[bus].estop
    frame = Frame.of(encoding.message.id, bytes(5), encoding.message.flags, monotonic_ns())
    bench.put(bus, frame)


def test_an_emergency_stop_is_obeyed_and_passed_on_to_all_buses(tmp_path):
    with Bench(tmp_path, "run.stop=60") as bench:
        bench.begin()
        estop(bench, "right")
        until(lambda: bench.struct.life.state == LifeState.FAULT)
        assert bench.struct.life.reasons == Why.ESTOP
        until(lambda: bench.struct.alarms == 0)
        until(lambda: min(bench.estops("left"), bench.estops("right")) >= 10)
        time.sleep(0.05)
        assert bench.estops("left") == bench.estops("right") == 10


def test_an_emergency_stop_of_its_own_is_repeated_until_reset(tmp_path):
    with Bench(tmp_path, "run.stop=60") as bench:
        bench.begin()
        bench.control.estop()
        until(lambda: bench.estops() > 25)
        bench.control.reset()
        until(lambda: bench.struct.life.state == LifeState.INACTIVE)
        bench.control.rearm()
        until(lambda: bench.struct.life.state == LifeState.ACTIVE)
        told = bench.estops()
        until(lambda: np.any(bench.torques[-1]))
        assert bench.estops() <= told + 1


def test_an_emergency_stop_before_the_start_keeps_it_from_starting(tmp_path):
    with Bench(tmp_path) as bench:
        estop(bench)
        until(lambda: bench.struct.life.state == LifeState.FAULT)
        start(bench)
        assert refused(bench) & Why.ESTOP


def test_on_a_bus_with_protection_what_is_no_emergency_stop_is_none(tmp_path):
    """A network may deliver a message under another one's name."""
    system = load_system(TELEOPERATION, "zenoh", ["run.stop=1"])
    beat = system.services["net"].heartbeats[system.deployment.nodes["slave"].number]
    rx, tx = Ring(64), Ring(64)
    buses = {"net": Bus.from_rings(rx, tx, 0)}
    with WiredNode(system, "master", buses, tmp_path / "journal", native.WALL, boots=1) as wired:
        node = wired.struct
        live = threading.Thread(target=native.functions().node_live, args=(c.byref(node),))
        live.start()
        try:
            number = system.services["net"].estop.message.id
            rx.put(Frame.of(number, beat.encode([2, 0, 1, 1]), 0, monotonic_ns()))
            until(lambda: node.unknown == 1)
            assert node.life.reasons == 0
            data = system.services["net"].estop.encode([2, Why.ESTOP])
            rx.put(Frame.of(number, data, 0, monotonic_ns()))
            until(lambda: node.life.state == LifeState.FAULT)
            assert node.life.reasons == Why.ESTOP
        finally:
            node.quit = 1
            live.join()
