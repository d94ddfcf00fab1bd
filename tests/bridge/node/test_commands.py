"""Commands of one slot: a STOP or an emergency stop is executed alone, others in their order."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from bridge.native import node as native
from bridge.native import safety
from bridge.native.frame import Frame
from bridge.native.message import Header
from bridge.native.safety import Command, LifeState, Why
from bridge.records.node_lives import Life
from bridge.replay import replay, twin
from bridge.safety.limits import step
from cosim.base.clock import monotonic_ns
from tests.bridge.bench import Bench, until
from tests.bridge.deployments import document, named, system_of
from tests.bridge.slots import Slots

ARM, START, STOP, RESET = Command.ARM, Command.START, Command.STOP, Command.RESET
NMT = {START: 1, STOP: 2, ARM: 128, RESET: 129}
TO_ALL, TO_IT = 0, 2


def digits(*commands):
    """As the journal has them."""
    return sum(int(command) << 3 * k for k, command in enumerate(commands))


@pytest.fixture(name="slots")
def slots_(tmp_path):
    """``master_control`` of can.toml, ACTIVE, and without need of anybody else."""
    found = document("can")
    found["nodes"]["master_control"] |= {"requires": [], "stale": {}}
    with Slots(system_of(found, tmp_path), "master_control", tmp_path) as slots:
        slots.begin()
        slots.step()
        yield slots


def hear(slots, *commands, to=TO_IT, estop=None):
    """All in the next slot, an emergency stop before the command of that index; its row."""
    t = slots.struct.slot * slots.struct.h
    for k, command in enumerate((*commands, None)):
        if k == estop:
            slots.put("left", Frame.of(0x001, bytes(5)), t)
        if command is not None:
            nmt = slots.system.services["left"].nmt
            slots.put("left", nmt.frame([NMT[command], to], Header()), t)
    return slots.step()


def afterwards(slots):
    """The row when a ramp is over."""
    for _ in range(slots.struct.life.ramp_ticks + 1):
        row = slots.step()
    return row


@pytest.mark.parametrize("to", [TO_ALL, TO_IT])
@pytest.mark.parametrize("other", [ARM, RESET, START, STOP])
@pytest.mark.parametrize("stop_first", [True, False])
def test_a_stop_is_not_lost_beside_another_command(slots, other, stop_first, to):
    both = (STOP, other) if stop_first else (other, STOP)
    row = hear(slots, *both, to=to)
    assert row["state"] == LifeState.STOPPING and row["reasons"] == Why.COMMAND
    assert row["commands"] == digits(*both)
    last = afterwards(slots)
    assert last["state"] == LifeState.INACTIVE and last["scale"] == 0.0
    assert not slots.struct.life.armed


@pytest.mark.parametrize("others", [(RESET,), (ARM,), (RESET, ARM, START)])
@pytest.mark.parametrize("last", [True, False])
def test_an_emergency_stop_cancels_the_commands_of_its_slot(slots, others, last):
    row = hear(slots, *others, estop=len(others) if last else 0)
    assert row["state"] == LifeState.STOPPING and row["reasons"] & Why.ESTOP
    assert row["commands"] == digits(*others)
    assert afterwards(slots)["state"] == LifeState.FAULT
    row = hear(slots, *others, estop=len(others) if last else 0)  # in FAULT, too
    assert row["state"] == LifeState.FAULT and slots.struct.life.refused == Why.ESTOP


@pytest.mark.parametrize(
    ("commands", "state", "armed"),
    [
        ((RESET, ARM, START), LifeState.ACTIVE, True),
        ((ARM, RESET, START), LifeState.INACTIVE, False),
        ((START, ARM, RESET), LifeState.INACTIVE, False),
        ((RESET, START, ARM), LifeState.INACTIVE, True),
    ],
)
def test_other_commands_are_executed_in_the_order_heard(slots, commands, state, armed):
    hear(slots, estop=0)
    assert afterwards(slots)["state"] == LifeState.FAULT
    row = hear(slots, *commands)
    assert (row["state"], bool(slots.struct.life.armed)) == (state, armed)
    assert row["commands"] == digits(*commands)


def test_ten_commands_have_room_and_a_stop_always(slots):
    row = hear(slots, *[ARM] * 14, STOP, *[RESET] * 5)
    assert row["commands"] == digits(*[ARM] * 9, STOP)
    assert row["state"] == LifeState.STOPPING


def test_commands_of_its_owner_come_behind_those_heard(slots):
    native.functions().node_tell(slots.struct, START)
    native.functions().node_tell(slots.struct, STOP)
    assert hear(slots, ARM)["commands"] == digits(ARM, START, STOP)
    assert slots.struct.stopping and slots.struct.told == 0


def test_threads_that_tell_at_once_lose_no_stop(slots):
    tell = native.functions().node_tell
    for _ in range(200):
        threads = [threading.Thread(target=tell, args=(slots.struct, x)) for x in (ARM, STOP)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert slots.struct.told in (digits(ARM, STOP), digits(STOP, ARM))
        slots.struct.told = 0


def test_an_unknown_command_among_others_is_a_fault_of_the_node():
    life = safety.LifeStruct(state=LifeState.ACTIVE, armed=1, ramp_ticks=4, commands=digits(ARM, 6))
    assert step(life) == LifeState.STOPPING
    assert life.reasons == Why.COMPONENT


def test_what_was_commanded_is_replayed(tmp_path):
    system = named("can", "run.stop=0.4")
    nmt = system.services["left"].nmt

    def prepare(node):
        if node.name == "master_control":
            for command in (ARM, STOP, RESET):
                node._buses[0].rx.put(nmt.frame([NMT[command], TO_ALL], Header()))

    (tmp_path / "twin").mkdir()
    with twin.wired_nodes(system, tmp_path / "twin", prepare) as nodes:
        twin.run(system, nodes)
    rows = replay.load(tmp_path / "twin")
    mine = rows[Life("master_control")]
    row = mine[0]
    assert (row["commands"], row["state"]) == (digits(ARM, STOP, RESET), LifeState.STOPPING)
    assert not np.any(mine["sent"][-1][:2])
    found = replay.replay(system, rows, replay.received_by_life(tmp_path / "twin"), tmp_path)
    assert found.first is None and found.greatest == 0.0


def test_a_drive_in_fault_is_cleared_and_enabled_in_one_slot(tmp_path):
    system = named("can", "run.stop=1")
    with Slots(system, "master", tmp_path) as slots:
        slots.begin()
        slots.step()
        hear(slots, estop=0)
        assert afterwards(slots)["state"] == LifeState.FAULT
        (drive,) = slots.wired.drives
        assert drive.state == 3  # FAULT
        assert hear(slots, RESET, ARM, START, to=TO_ALL)["state"] == LifeState.ACTIVE
        assert drive.state == 2  # ENABLED


# ---- START --------------------------------------------------------------------------------------


def heard(bench, *commands):
    """Commands with one time of arrival."""
    now = monotonic_ns()
    for command in commands:
        frame = bench.system.services["left"].nmt.frame([NMT[command], 0], Header(), now)
        bench.put("left", frame)


def test_a_start_that_is_refused_sets_no_t0(tmp_path):
    with Bench(tmp_path, there=False) as bench:
        time.sleep(0.05)
        heard(bench, START)
        until(lambda: bench.struct.refusals)
        until(lambda: bench.struct.start_ns == 0)
        bench.there = True
        first = bench.struct.nmt_ns
        bench.heard()
        heard(bench, START)  # the next one has its own time
        until(lambda: bench.struct.begun)
        assert bench.struct.start_ns == bench.struct.nmt_ns > first


@pytest.mark.parametrize("commands", [(START, STOP), (STOP, START)])
def test_a_stop_cancels_a_start_and_its_t0(tmp_path, commands):
    bench = Bench(tmp_path)
    heard(bench, *commands)  # before the node looks: both are of one slot
    with bench:
        until(lambda: bench.struct.nmt_ns)
        bench.heard()
        time.sleep(0.3)
        assert not bench.struct.begun and bench.struct.start_ns == 0
        assert not bench.struct.refusals
        heard(bench, START)
        until(lambda: bench.struct.begun)
        assert bench.struct.start_ns == bench.struct.nmt_ns


def test_a_stop_cancels_a_start_that_waits(tmp_path):
    with Bench(tmp_path) as bench:
        bench.heard()
        bench.control.start(time.monotonic_ns() + 30_000_000_000)
        until(lambda: bench.struct.start_ns)
        heard(bench, STOP)
        until(lambda: bench.struct.start_ns == 0)
