"""The end of a node on the wall clock: its ramp, its last messages, and what it says of itself."""

from __future__ import annotations

import pytest

from bridge.native import node as native
from bridge.native.safety import LifeState, Why
from tests.bridge.deployments import document
from tests.bridge.node.test_last_torque import frames
from tests.bridge.node.test_late_slots import Live

LAST, FAILS = 19, 6  # slots of a run
LIFE = 7  # of a status


def heartbeats(node):
    """The life cycle and the reasons in each, the oldest first."""
    codec = node.system.services["left"].heartbeats[2]
    found = [f for f in frames_once(node) if f.id == codec.message.id]
    said = [codec.decode(f.payload)[1] for f in found]
    return [(LifeState(int(v[0])), Why(int(v[1]))) for v in said]


def frames_once(node):
    if not hasattr(node, "taken"):
        node.taken = frames(node)
        assert not any(ring.dropped for ring in node.sent.values())
    return node.taken


def torques(node, outlet=0):
    """(frame, torques, header) of each message of an outlet with a guard, without previews."""
    s = node.struct
    planned = zip(node.wired.plan.outlets, s.outlets[: s.n_outlets], strict=True)
    guarded = [(plan, entry) for plan, entry in planned if entry.guard]
    plan, entry = guarded[outlet]
    codec = node.system.messages[plan.message].encoding
    found = []
    for frame in frames_once(node):
        if frame.id == codec.message.id:
            _, values, header = codec.decode(frame.payload)
            if header.status & LIFE != LifeState.INACTIVE:
                tau = values[entry.guarded : entry.guarded + entry.joints]
                found.append((frame, tau, header))
    return found


class Failing(Live):
    """Its components fail in slot `FAILS`."""

    def run(self, engine, ticks):
        result = super().run(engine, ticks)
        return 7 if self.struct.slot == FAILS else result


@pytest.mark.parametrize("every", [1, 2, 3])
def test_a_failure_lets_the_torque_down_in_equal_steps(tmp_path, every):
    """By one part of the ramp a slot, as messages are due, from the torque that was sent last."""
    scales = []

    def each(node):
        s = node.struct
        for outlet in s.outlets[: s.n_outlets]:
            outlet.every = every
        s.life.ramp_ticks = 8
        scales.append(s.life.scale)

    node = Failing(tmp_path, each)
    rows = node.live()
    assert node.result == 7 and len(rows) == FAILS + 1 and set(scales) == {1.0}
    said = torques(node)
    before = [tau for _, tau, h in said if h.status & LIFE == LifeState.ACTIVE]
    assert len(before) == FAILS // every + 1 and any(before[-1])
    given = rows["sent"][FAILS][node.struct.outlets[0].guarded :]
    ramp = [k for k in range(FAILS + 1, FAILS + 9) if k % every == 0]
    expected = [given[0] * (8 - (k - FAILS)) / 8 for k in ramp]
    found = [tau[0] for _, tau, _ in said[len(before) : -1]]
    assert found == pytest.approx(expected, abs=1e-4)
    numbers = [header.counter for _, _, header in said]
    assert numbers[:-1] == list(range(len(said) - 1))
    assert numbers[-1] == (FAILS + 8) // every + 1
    assert not any(said[-1][1]) and said[-1][2].status & LIFE == LifeState.FAULT
    assert node.struct.slot == FAILS + 9
    assert heartbeats(node)[-1] == (LifeState.FAULT, Why.COMPONENT)


@pytest.mark.parametrize("first", ["master_control", "slave_control"])
def test_a_failure_lets_the_torques_of_all_arms_down(tmp_path, first):
    """Two controllers in a node, one behind the other, each with an outlet of its own."""
    found = document("can-classic")
    del found["nodes"]["slave_control"]
    second = {"master_control": "slave_control", "slave_control": "master_control"}[first]
    found["nodes"]["master_control"]["components"] = [first, second]

    def each(node):
        node.struct.life.ramp_ticks = 8

    node = Failing(tmp_path, each, found=found)
    node.live()
    for outlet in (0, 1):
        said = [tau for _, tau, _ in torques(node, outlet)]
        assert len(said) == FAILS + 1 + 8 + 1
        given, ramp = said[FAILS], said[FAILS + 1 : -1]
        assert any(given) and not any(said[-1])
        for part, tau in zip(range(7, -1, -1), ramp, strict=True):
            assert list(tau) == pytest.approx([x * part / 8 for x in given], abs=2e-2)


def test_a_ramp_that_is_left_ends_at_once(tmp_path):
    node = Failing(tmp_path, lambda node: None)
    step = node.run

    def run(engine, ticks):
        node.struct.quit = node.struct.slot == FAILS
        return step(engine, ticks)

    node.run = run
    node.live()
    said = torques(node)
    assert node.struct.slot == FAILS + 2  # one slot of the ramp
    assert [any(tau) for _, tau, _ in said[-2:]] == [True, False]
    assert said[-1][2].status & LIFE == LifeState.STOPPING  # in this state drives take it
    assert heartbeats(node)[-1] == (LifeState.FAULT, Why.COMPONENT | Why.COMMAND)


@pytest.mark.parametrize("every", [1, 3, 4])
def test_the_last_message_has_the_number_behind_those_sent(tmp_path, every):
    def each(node):
        for outlet in node.struct.outlets[: node.struct.n_outlets]:
            outlet.every = every

    node = Live(tmp_path, each)
    node.live()
    numbers = [header.counter for _, _, header in torques(node)]
    assert numbers == list(range(LAST // every + 2))


@pytest.mark.parametrize(
    ("state", "ending", "result", "said"),
    [
        (LifeState.ACTIVE, 0, native.FINISHED, LifeState.FINISHED),
        (LifeState.INACTIVE, 1, native.FINISHED, LifeState.FINISHED),
        (LifeState.INACTIVE, 0, native.FAULT, LifeState.INACTIVE),
        (LifeState.FAULT, 0, native.FAULT, LifeState.FAULT),
        (LifeState.FAULT, 1, native.FAULT, LifeState.FAULT),
        (LifeState.STOPPING, 0, native.FAULT, LifeState.FAULT),
    ],
)
def test_behind_the_last_slot_the_result_is_that_of_its_life(tmp_path, state, ending, result, said):
    def each(node):
        s = node.struct
        if s.slot == s.slots - 1:
            s.life.state, s.ending = state, ending

    node = Live(tmp_path, each)
    rows = node.live()
    assert (node.result, len(rows)) == (result, LAST + 1)
    assert heartbeats(node)[-1][0] == said


@pytest.mark.parametrize(
    ("state", "said", "last", "why"),
    [
        (LifeState.ACTIVE, LifeState.STOPPING, LifeState.FAULT, Why.COMMAND),
        (LifeState.STOPPING, LifeState.STOPPING, LifeState.FAULT, Why.COMMAND),
        (LifeState.FAULT, LifeState.FAULT, LifeState.FAULT, Why(0)),
    ],
)
def test_a_node_that_is_left_stops_its_drives(tmp_path, state, said, last, why):
    """Its last torque is 0, in a state in which drives take it, and then it is in FAULT."""

    def each(node):
        if node.struct.slot == FAILS:
            node.struct.life.state, node.struct.quit = state, 1

    node = Live(tmp_path, each)
    rows = node.live()
    assert (node.result, len(rows)) == (native.STOPPED, FAILS + 1)
    _, tau, header = torques(node)[-1]
    assert not any(tau) and header.status & LIFE == said
    assert heartbeats(node)[-1] == (last, why)
    assert (node.struct.life.armed, node.struct.life.scale) == (0, 0.0)


def test_the_last_torque_of_a_rehearsal_holds_for_its_slot(tmp_path):
    """Zero comes no sooner than the next torque would have come."""
    node = Live(tmp_path, lambda node: None)
    node.live()
    s = node.struct
    frame, tau, _ = torques(node)[-1]
    assert not any(tau)
    assert frame.t_ns >= s.start_ns + s.phase_ns + s.slots * s.h_ns


@pytest.mark.parametrize("last", [FAILS, LAST])
def test_what_is_behind_the_table_of_outlets_is_not_sent(tmp_path, last):
    """The node is told of one outlet less than there are when its slots are over."""

    def each(node):
        if node.struct.slot == last:
            node.struct.n_outlets -= 1
            node.struct.quit = last < LAST

    node = Live(tmp_path, each)
    hidden = node.struct.outlets[node.struct.n_outlets - 1]
    assert hidden.guard
    node.live()
    assert hidden.sent == last + 1  # in slots, by the plan


@pytest.mark.parametrize("fails", [False, True])
def test_heartbeats_go_on_while_the_torque_goes_down(tmp_path, fails):
    """Every second slot, and once at the end."""

    def each(node):
        s = node.struct
        s.heartbeat_slots, s.life.ramp_ticks = (2, 8)
        if s.slot == 0:
            node.beats = s.beats

    node = (Failing if fails else Live)(tmp_path, each)
    node.live()
    slots = FAILS + 9 if fails else LAST + 1
    # a slot that fails says nothing more
    assert node.struct.beats - node.beats == (slots + 1) // 2 + 1
