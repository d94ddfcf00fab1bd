"""Messages that are required before a start, and missing messages while a node runs."""

import ctypes as c
from pathlib import Path

import numpy as np
import pytest

from bridge.cli.node import waiting_for_a_restart
from bridge.deployment.system import load_system
from bridge.native import node as native
from bridge.native.bus import Bus
from bridge.native.frame import Flags, Ring
from bridge.native.message import Header
from bridge.native.safety import LifeState, Status
from bridge.node import missing_inputs
from bridge.node.run import _end_and_reason
from bridge.records.records import LifeEnd
from bridge.replay import twin
from bridge.wiring.wiring import WiredNode
from cosim.base.clock import monotonic_ns, sleep, stopwatch
from tests.bridge.bench import Bench
from tests.bridge.deployments import TELEOPERATION, named
from tests.bridge.slots import Slots

STEP = "run.step='5 ms'"


class Slave:
    """The master's node over Zenoh on rings; the test is the slave, whose ξ it needs."""

    def __init__(self, folder, *settings):
        self.system = load_system(TELEOPERATION, "zenoh", ["run.stop='2 s'", *settings])
        self.rx, self.tx = Ring(4096), Ring(4096)
        self.wired = WiredNode(
            self.system, "master", {"net": Bus.from_rings(self.rx, self.tx, 0)}, folder / "journal",
            native.SIMULATED,
        )  # fmt: skip
        self.struct = self.wired.struct

    def say(self, life, k=0, t=0.0, xi=0.0):
        codec = self.system.messages["xi_slave"].encoding
        header = Header(counter=k, status=life | Status.SIMULATED, t_us=round(t * 1e6))
        self.rx.put(codec.frame([xi, xi], header, round(t * 1e9)))


def slots(master, n):
    struct = master.struct
    limits = ((struct.slot + np.arange(n)) * struct.h_ns).astype(np.int64)
    assert native.functions().node_follow(c.byref(struct), limits.ctypes.data, n) == 0


@pytest.fixture
def master(tmp_path):
    made = Slave(tmp_path, "deploy.silence='0.3 s'")
    with made.wired:
        made.struct.life.state, made.struct.begun = LifeState.ACTIVE, 1
        yield made


def test_a_message_is_unheard_until_a_preview_of_it_has_come(tmp_path):
    made = Slave(tmp_path)
    with made.wired:
        assert missing_inputs.missing_before_start(made.wired) == ["xi_slave from slave"]
        made.say(LifeState.INACTIVE)
        slots(made, 1)
        assert missing_inputs.missing_before_start(made.wired) == []


def test_without_a_limit_of_silence_nothing_is_awaited(tmp_path):
    made = Slave(tmp_path, "deploy.silence=0")
    with made.wired:
        assert missing_inputs.missing_before_start(made.wired) == []
        slots(made, 1500)
        assert (
            missing_inputs.silent_messages(made.wired)
            == missing_inputs.never_received(made.wired)
            == []
        )


def test_a_life_that_heard_a_message_and_then_no_more_says_so_at_its_end(tmp_path):
    """Though it may wait for ever: the whole rest of a run was lost, and it "finished"."""
    made = Slave(tmp_path, "deploy.silence=0", "run.stop=9")
    with made.wired:
        made.struct.life.state, made.struct.begun = LifeState.ACTIVE, 1
        for k in range(40):
            made.say(LifeState.ACTIVE, k, k * 5e-3)
        slots(made, 5000)
        assert missing_inputs.silent_at_end(made.wired) == []
        slots(made, 4000)
        assert missing_inputs.silent_messages(made.wired) == []
        assert missing_inputs.silent_at_end(made.wired) == ["xi_slave from slave for 8.8 s"]
        end, error = _end_and_reason(made.wired, native.FINISHED)
        assert end is LifeEnd.DEAF and "for 8.8 s" in error
        made.wired.peers["slave"].state = LifeState.FINISHED
        assert _end_and_reason(made.wired, native.FINISHED) == (LifeEnd.FINISHED, "")


def test_an_input_may_be_waited_for_without_an_end(tmp_path):
    never = 'deploy.nodes.master.stale={"master_control.xi_in"={stop=0}}'
    made = Slave(tmp_path, "deploy.silence='0.3 s'", never)
    with made.wired:
        assert missing_inputs.missing_before_start(made.wired) == []
        made.struct.life.state = LifeState.ACTIVE
        slots(made, 1000)
        assert made.struct.life.state == LifeState.ACTIVE


def test_a_node_that_hears_nothing_stops_and_says_what_it_misses(master):
    slots(master, 300)
    assert (
        master.struct.life.state == LifeState.ACTIVE
        and missing_inputs.silent_messages(master.wired) == []
    )
    slots(master, 10)
    assert master.struct.life.state in (LifeState.STOPPING, LifeState.FAULT)
    assert missing_inputs.silent_messages(master.wired) == ["xi_slave from slave for 0.31 s"]
    assert missing_inputs.never_received(master.wired) == ["xi_slave from slave"]


def test_what_was_heard_once_is_missed_from_then_on(master):
    for k in range(40):
        master.say(LifeState.ACTIVE, k, k * 5e-3)
    slots(master, 200)
    assert missing_inputs.never_received(master.wired) == []
    slots(master, 290)
    assert master.struct.life.state == LifeState.ACTIVE
    slots(master, 20)
    assert master.struct.life.state != LifeState.ACTIVE


def test_who_has_finished_is_not_missed(master):
    slots(master, 400)
    assert missing_inputs.silent_messages(master.wired)
    master.wired.peers["slave"].state = LifeState.FINISHED
    assert missing_inputs.silent_messages(master.wired) == []


def test_a_drive_that_joins_a_run_does_not_wait_for_a_controller_in_fault(tmp_path):
    with Slots(named("can", STEP, "run.stop=2"), "master", tmp_path) as slots:
        slots.begin()
        assert missing_inputs.missing_before_start(slots.wired) == ["LINK_2 from master_control"]
        codec = slots.system.messages["LINK_2"].encoding
        for k in range(60):
            header = Header(
                counter=k, status=LifeState.FAULT | Status.SIMULATED, t_us=k * 5000 + 500
            )
            slots.put("left", codec.frame([0.0] * 4, header), k * 5e-3 + 6e-4)
            slots.step()
        assert slots.wired.receivers["LINK_2"].ok > 50
        assert (
            missing_inputs.missing_before_start(slots.wired)
            == missing_inputs.never_received(slots.wired)
            == []
        )


def test_torques_of_a_node_in_fault_are_heard(tmp_path):
    """They move no drive and feed no watchdog, but the drive is not deaf."""
    settings = (STEP, "run.stop=2", "deploy.silence='0.5 s'")
    system = named("can", *settings)
    with twin.wired_nodes(system, tmp_path) as nodes:
        nodes["master_control"].struct.alarm = 1  # an emergency stop in its first slot
        twin.run(system, nodes)
        assert nodes["master_control"].struct.life.state == LifeState.FAULT
        assert nodes["master"].receivers["LINK_2"].ok > 300
        assert missing_inputs.silent_messages(nodes["master"]) == []


def test_a_node_whose_peer_waits_for_its_start_is_not_deaf(master):
    slots(master, 310)
    assert missing_inputs.silent_messages(master.wired)
    master.say(LifeState.INACTIVE, 0, 0.31)
    slots(master, 1)
    assert missing_inputs.silent_messages(master.wired) == []
    slots(master, 310)
    assert missing_inputs.silent_messages(master.wired) == ["xi_slave from slave for 0.311 s"]


def test_who_is_heard_but_refused_is_not_said_to_be_silent_only(master):
    for k in range(70):
        master.say(LifeState.ACTIVE, k, k * 5e-3, xi=1e6)
    slots(master, 320)
    (said,) = missing_inputs.silent_messages(master.wired)
    assert said.startswith("xi_slave from slave for 0.3") and "range)" in said


def test_a_supervisor_is_told_what_is_missing_and_then_that_it_is_ready(tmp_path, monkeypatch):
    monkeypatch.setattr(missing_inputs, "REPEAT", 0.02)
    made, said = Slave(tmp_path), []
    with (
        made.wired,
        missing_inputs.report_missing_inputs(made.wired, said.append, lambda: {"event": "ready"}),
    ):
        within(lambda: len(said) > 1)
        assert said[0] == {"event": "waiting", "for": ["xi_slave from slave"]}
        made.say(LifeState.INACTIVE)
        slots(made, 1)
        within(lambda: said[-1] == {"event": "ready"})


def test_a_supervisor_is_told_once_what_is_heard_no_more(master):
    said = []
    with missing_inputs.report_missing_inputs(
        master.wired, said.append, lambda: {"event": "ready"}
    ):
        slots(master, 310)
        within(lambda: len(said) > 1)
        sleep(0.1)
    assert [event["event"] for event in said] == ["ready", "deaf"]
    assert "xi_slave from slave" in said[1]["to"][0]


def within(true, seconds=20.0):
    elapsed = stopwatch()
    while not true():
        assert elapsed() < seconds
        sleep(0.005)


def test_who_is_required_and_not_there_is_named(tmp_path):
    made = Slave(tmp_path, 'deploy.nodes.master.requires=["slave"]')
    with made.wired:
        assert "a heartbeat of slave" in missing_inputs.missing_before_start(made.wired)
        peer = made.wired.peers["slave"]
        peer.state, peer.heartbeat.last_ns = LifeState.INACTIVE, monotonic_ns()
        assert "a heartbeat of slave" not in missing_inputs.missing_before_start(made.wired)
        peer.state = 6  # three bits have room for more than there are
        (said,) = (s for s in missing_inputs.missing_before_start(made.wired) if "heartbeat" in s)
        assert said == "a heartbeat of slave in another state than 6"
        peer.state = LifeState.FAULT
        assert (
            "a heartbeat of slave in another state than FAULT"
            in missing_inputs.missing_before_start(made.wired)
        )


def came_instead(bench, values, header=None, change=lambda frame: None, times=5):
    """What a waiting controller misses, after so many frames of its drive."""
    codec = bench.system.messages["STATE_1"].encoding
    header = header or Header(status=LifeState.INACTIVE | Status.SIMULATED)
    for _ in range(times):
        frame = codec.frame([*values, 0.0, 0.0], header, monotonic_ns())
        change(frame)
        bench.put("left", frame)
    seen = bench.wired.inlet_bindings.receptions["STATE_1"], bench.wired.receivers["STATE_1"]
    within(lambda: seen[0].early + seen[0].early_range + seen[0].misfits + seen[1].crc == times)
    return next(s for s in missing_inputs.missing_before_start(bench.wired) if "STATE_1" in s)


def flip(frame):
    frame.data[frame.length - 1] ^= 1


def in_another_format(frame):
    frame.flags ^= Flags.FD


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ({"values": (8.0, 0.0)}, "(came and was refused: range)"),
        ({"values": (0.0, 0.0), "change": flip}, "(came and was refused: crc)"),
        (
            {"values": (0.0, 0.0), "change": in_another_format},
            "(came and was refused: another frame format)",
        ),
        (
            {"values": (0.0, 0.0), "header": Header(status=LifeState.FAULT | Status.SIMULATED)},
            "(samples came, of a run whose t = 0 nobody has told; master is in FAULT: "
            "RESET and START it)",
        ),
        (
            {"values": (0.0, 0.0), "header": Header(status=LifeState.ACTIVE | Status.SIMULATED)},
            "(samples came, of a run whose t = 0 nobody has told; master is in ACTIVE)",
        ),
    ],
)
def test_frames_that_came_and_do_not_count_are_named_before_a_start(tmp_path, what, said):
    """ "has not received from STATE_1" was said while thousands of its frames came."""
    ranges = 'deploy.signals.q.range="6 rad"'
    with Bench(tmp_path, "deploy.silence=10", ranges, there=False) as bench:
        assert came_instead(bench, **what) == f"STATE_1 from master {said}"
        bench.there = True
        within(lambda: "STATE_1" not in str(missing_inputs.missing_before_start(bench.wired)))


def test_a_node_that_needs_to_hear_nothing_says_that_a_run_is_on_which_nobody_announces(tmp_path):
    """With ``silence = 0`` it was ready at once, and waited without a word for a START."""
    said = []
    alone = ("deploy.nodes.master_control.requires=[]", "deploy.nodes.master_control.stale={}")
    with Bench(tmp_path, *alone, there=False) as bench:
        bench.struct.epoch.follows = 1
        with missing_inputs.report_missing_inputs(
            bench.wired, said.append, lambda: {"event": "ready"}
        ):
            codec = bench.system.messages["STATE_1"].encoding
            header = Header(status=LifeState.FAULT | Status.SIMULATED)
            bench.put("left", codec.frame([0.0] * 4, header, monotonic_ns()))
            within(lambda: len(said) == 2)
    assert [event["event"] for event in said] == ["ready", "waiting"]
    assert "STATE_1 from master" in said[1]["for"][0] and "is in FAULT" in said[1]["for"][0]


@pytest.mark.parametrize(
    ("said", "changes", "expected"),
    [
        ("", [], ["deploy.silence=60"]),
        ("silence = 10\n", [], []),
        ("", ["deploy.silence=0"], []),
        ("", ["deploy.patience=5"], ["deploy.silence=60"]),
    ],
)
def test_a_node_started_by_hand_outlives_a_peer_that_is_started_again(
    tmp_path: Path, said: str, changes: list[str], expected: list[str]
) -> None:
    (tmp_path / "d.toml").write_text(said + "[buses.a]\n")
    assert waiting_for_a_restart(tmp_path / "d.toml", changes) == expected
