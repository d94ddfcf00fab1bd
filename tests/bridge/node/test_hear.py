"""What a node makes of each frame of a service, on the simulated clock: SYNCs, heartbeats, NMT."""

from __future__ import annotations

import pytest

from bridge.native.message import Header
from bridge.native.safety import LifeState, Status, Why
from tests.bridge.deployments import document, named, system_of
from tests.bridge.slots import Slots

STOP, ARM, RESET = 2, 128, 129


@pytest.fixture
def node(tmp_path):
    """``master_control`` (number 2) of can.toml, which needs nobody else to go on."""
    found = document("can")
    found["nodes"]["master_control"] |= {"requires": [], "stale": {}}
    with Slots(system_of(found, tmp_path), "master_control", tmp_path) as slots:
        slots.begin()
        yield slots


def say(node, encoding, values, status=0, bus="left"):
    """A frame on a bus, heard in the next slot; its row."""
    frame = encoding.frame(values, Header(status=status))
    frame.t_ns = node.struct.slot * node.struct.h_ns
    node.rings[bus].put(frame)
    return node.step()


def test_syncs_are_counted_and_so_are_those_that_are_missing(node):
    """Their counter goes from 1 to 240 and from there to 1 (CiA 301, 7.2.5)."""
    sync = node.system.services["left"].sync
    heard = [(7, 0), (1, 233), (2, 0), (5, 2), (239, 233), (240, 0), (1, 0), (3, 1), (2, 238)]
    lost = 0
    for n, (counter, missing) in enumerate(heard, 1):
        say(node, sync, [counter])
        lost += missing
        assert (node.struct.syncs_received, node.struct.syncs_lost) == (n, lost), counter


def test_a_sync_feeds_its_watchdog_at_its_arrival(node):
    for _ in range(3):
        node.step()
        say(node, node.system.services["left"].sync, [1])
        arrived = (node.struct.slot - 1) * node.struct.h_ns
        assert node.struct.sync_watchdog.last_ns == arrived


@pytest.mark.parametrize("simulated_node", [False, True])
@pytest.mark.parametrize("simulated_peer", [False, True])
def test_only_among_simulated_nodes_is_a_simulated_peer_one(node, simulated_node, simulated_peer):
    node.struct.simulated = simulated_node
    beat = node.system.services["left"].heartbeats[1]
    status = Status.SIMULATED if simulated_peer else 0
    say(node, beat, [LifeState.ACTIVE, 0, 1, 0], status)
    peer = node.wired.peers["master"]
    there = simulated_node or not simulated_peer
    assert peer.state == (LifeState.ACTIVE if there else -1)


def test_each_heartbeat_is_that_of_its_peer(node):
    """Of the peers on each bus of the node: only the one that was heard has a new state."""
    peers = node.wired.peers
    heard = 0
    for bus in node.names:
        for number, beat in node.system.services[bus].heartbeats.items():
            name = next((name for name, peer in peers.items() if peer.number == number), None)
            if name is None:  # itself
                continue
            for peer in peers.values():
                peer.state = -1
            say(node, beat, [LifeState.ACTIVE, 0, 1, 0], Status.SIMULATED, bus)
            there = bus in node.system.buses_of(name)
            found = {n for n, peer in peers.items() if peer.state == LifeState.ACTIVE}
            assert found == ({name} if there else set()), (bus, name)
            heard += there
    assert heard > 1


@pytest.mark.parametrize("accepted", [False, True])
def test_samples_of_simulated_senders_are_counted_where_they_are_refused(node, accepted):
    encoding = node.system.messages["STATE_1"].encoding
    receiver = node.wired.receivers["STATE_1"]
    node.wired.inlet_bindings.receptions["STATE_1"].accept_simulated = accepted
    say(node, encoding, [0.0] * 4, LifeState.ACTIVE | Status.SIMULATED)
    assert (receiver.simulated, receiver.ok) == ((0, 1) if accepted else (1, 0))
    say(node, encoding, [0.0] * 4, LifeState.ACTIVE)
    assert receiver.simulated == (0 if accepted else 1)


def test_a_required_peer_that_has_begun_again_is_a_fault_of_its_node(node):
    beat, peer = node.system.services["left"].heartbeats[1], node.wired.peers["master"]
    for required, boots, why in [(0, 1, 0), (0, 2, 0), (1, 2, 0), (1, 3, Why.PEER), (1, 3, 0)]:
        peer.required = required
        row = say(node, beat, [LifeState.ACTIVE, 0, boots, 0])
        assert row["now"] & Why.PEER == why
        assert peer.boots == boots and not node.struct.unknown


def test_the_counters_of_a_peer_that_has_begun_again_are_new(node):
    beat = node.system.services["left"].heartbeats[1]
    receivers = node.wired.receivers
    for boots, state, forgotten in [
        (1, LifeState.UNCONFIGURED, False),
        (2, LifeState.ACTIVE, True),
        (2, LifeState.ACTIVE, False),
        (3, LifeState.ACTIVE, True),
    ]:
        for receiver in receivers.values():
            receiver.sequence = 7
        say(node, beat, [state, 0, boots, 0])
        found = {name for name, receiver in receivers.items() if receiver.sequence == -1}
        assert found == ({"STATE_1"} if forgotten else set())


@pytest.mark.parametrize("number", [0, 1, 2, 3])
@pytest.mark.parametrize("command", [STOP, ARM, RESET, 77])
def test_a_command_is_for_its_node_or_for_all(node, number, command):
    row = say(node, node.system.services["left"].nmt, [command, number])
    assert (row["commands"] != 0) == (number in (0, 2) and command != 77)


def test_a_peer_that_waits_asks_a_node_that_runs_for_the_time_origin(node):
    beat = node.system.services["left"].heartbeats[1]
    table = [(0, LifeState.INACTIVE, 0), (1, LifeState.ACTIVE, 0), (1, LifeState.INACTIVE, 1)]
    for begun, state, asked in [*table, (1, LifeState.ACTIVE, 1)]:  # asked once is asked
        node.struct.begun = begun
        say(node, beat, [state, 0, 1, 0])
        assert node.struct.epoch.asked == asked


@pytest.mark.parametrize("damaged", [False, True])
def test_a_protected_emergency_stop_that_is_damaged_is_counted_as_unknown(tmp_path, damaged):
    system = named("zenoh")
    with Slots(system, "master", tmp_path) as slots:
        slots.begin()
        frame = system.services["net"].estop.frame([1, 0], Header())
        frame.data[frame.length - 1] ^= damaged
        slots.put("net", frame, 0.0)
        row = slots.step()
        assert bool(row["now"] & Why.ESTOP) is not damaged
        assert slots.struct.unknown == damaged


def test_a_bus_without_emergency_stops_has_none(tmp_path):
    found = document("can")
    found["buses"]["left"]["services"].remove("estop")
    with Slots(system_of(found, tmp_path), "master", tmp_path) as slots:
        slots.begin()
        assert not say(slots, slots.system.services["left"].sync, [1])["now"] & Why.ESTOP
        assert slots.struct.syncs_received == 1


@pytest.mark.parametrize("start", [0, 5_000_000_000])
@pytest.mark.parametrize(("later", "heard"), [(0, [0, 1, 1]), (1, [0, 0, 1])])
def test_a_frame_is_heard_in_the_first_slot_that_is_not_before_it(node, start, later, heard):
    """Times of frames (ns) are on the clock of the bus, those of slots from the start on."""
    s = node.struct
    s.start_ns = start
    frame = node.system.services["left"].sync.frame([1], Header())
    frame.t_ns = start + s.h_ns + s.phase_ns + later
    node.rings["left"].put(frame)
    assert [(node.step(), s.syncs_received)[1] for _ in range(3)] == heard


@pytest.mark.parametrize(("max_age", "stale"), [(0, 0), (5000, 0), (4999, 1)])
def test_a_sample_older_than_its_reception_allows_is_counted_and_not_taken(node, max_age, stale):
    """Of the number and stamp 0, 5000 ns after the start; an age of 0 ns allows any."""
    reception = node.wired.inlet_bindings.receptions["STATE_1"]
    reception.max_age_ns, node.struct.phase_ns = max_age, 5000
    frame = node.system.messages["STATE_1"].encoding.frame(
        [0.0] * 4, Header(status=LifeState.ACTIVE | Status.SIMULATED)
    )
    frame.t_ns = 5000
    node.rings["left"].put(frame)
    node.step()
    assert node.wired.receivers["STATE_1"].stale == stale
    assert reception.newest == (-1 if stale else 0)


def hear(node, number, values, t):
    """Sample `number` of STATE_1 arrives at `t` ns; the node does its slots up to then."""
    carried = node.system.messages["STATE_1"]
    header = Header(number, LifeState.ACTIVE | Status.SIMULATED, number * carried.period_ns // 1000)
    frame = carried.encoding.frame(values, header)
    frame.t_ns = t
    node.rings["left"].put(frame)
    while node.struct.slot * node.struct.h_ns + node.struct.phase_ns < t - node.struct.start_ns:
        node.step()
    node.step()


@pytest.mark.parametrize("gap", [1, 2, 7])
@pytest.mark.parametrize("early", [0, 3_000_000])
@pytest.mark.parametrize("start", [0, 7_000_000_000])
def test_a_value_changes_as_fast_as_it_may_in_the_time_since_the_last_one(node, gap, early, start):
    """Samples closer than a period count as one apart; the second comes `early` ns too soon."""
    reception = node.wired.inlet_bindings.receptions["STATE_1"]
    receiver, period = node.wired.receivers["STATE_1"], reception.period_ns
    reception.limits[1].rate = 10.0
    node.struct.start_ns = start
    first, late = [0.0, 0.5, 0.0, 0.0], 4_000_000  # ns, of each but what is early
    arrived = 3 * period + late
    hear(node, 3, first, start + arrived)
    assert (reception.newest, receiver.rate) == (3, 0)
    since = max(period, gap * period - early) * 1e-9
    for n, by in enumerate((1.02, -1.02), 1):
        values = [0.0, 0.5 + by * 10.0 * since, 0.0, 0.0]
        hear(node, 3 + gap, values, start + arrived + gap * period - early)
        assert (reception.newest, receiver.rate) == (3, n)
    hear(node, 3 + gap, [0.0, 0.5 + 0.98 * 10.0 * since, 0.0, 0.0],
         start + arrived + gap * period - early)  # fmt: skip
    assert (reception.newest, receiver.rate) == (3 + gap, 2)


def test_the_first_value_may_be_any_in_its_range(node):
    reception = node.wired.inlet_bindings.receptions["STATE_1"]
    for limit in reception.limits[:4]:
        limit.rate = 1e-3
    hear(node, 0, [1.0, 1.0, 0.5, 0.5], 0)
    assert (reception.newest, node.wired.receivers["STATE_1"].rate) == (0, 0)


def jumps(system, folder, message, values):
    """Whether values heard before the run begins are a jump for ``master_control``."""
    encoding = system.messages[message].encoding
    status = LifeState.INACTIVE | Status.SIMULATED
    with Slots(system, "master_control", folder) as slots:
        slots.struct.start_ns = 1_000_000_000
        for n, value in enumerate(values):
            frame = encoding.frame([value] * encoding.message.n_fields, Header(status=status))
            slots.put("left", frame, n * 1e-3)
        return bool(slots.step()["now"] & Why.JUMP)


@pytest.mark.parametrize(("joint", "limit"), [(1, 0.3), (2, 0.1)])
def test_a_jump_before_the_start_is_measured_with_the_limit_of_its_joint(tmp_path, joint, limit):
    """Each drive of CiA 402 has a torque message, a guard and an encoder of its own."""
    limits = 'deploy.nodes.master_control.guard.q_jump=["0.3 rad", "0.1 rad"]'
    system = named("can-cia402", limits)
    for moved in (limit, -limit):
        assert jumps(system, tmp_path, f"master_state_{joint}", [0.4, 0.4 + 1.1 * moved])
        assert not jumps(system, tmp_path, f"master_state_{joint}", [0.4, 0.4 + 0.9 * moved])
    assert not jumps(system, tmp_path, f"master_speed_{joint}", [0.0, 5.0])


@pytest.mark.parametrize("limit", [0.5, 0.4375, None])
def test_a_jump_before_the_start_is_more_than_the_limit_if_there_is_one(tmp_path, limit):
    found = document("can")
    found["nodes"]["master_control"]["guard"] |= {"q_jump": limit}
    if limit is None:
        del found["nodes"]["master_control"]["guard"]["q_jump"]
    system = system_of(found, tmp_path)
    for values in ([0.25, 0.75], [0.75, 0.25]):
        assert jumps(system, tmp_path, "STATE_1", values) == (limit == 0.4375)


@pytest.mark.parametrize("state", [state for state in LifeState if state > LifeState.INACTIVE])
def test_a_sample_of_a_node_in_fault_is_one_unless_it_is_a_torque(tmp_path, node, state):
    """A drive that hears nothing but torques of a FAULT brakes: they feed nothing."""
    status = state | Status.SIMULATED
    say(node, node.system.messages["STATE_1"].encoding, [0.0] * 4, status)
    reception = node.wired.inlet_bindings.receptions["STATE_1"]
    assert (reception.newest, reception.of_fault) == (0, 0)
    (tmp_path / "arm").mkdir()
    with Slots(named("can", "run.stop=1"), "master", tmp_path / "arm") as arm:
        arm.struct.n_peers = 0
        arm.begin()
        say(arm, arm.system.messages["LINK_2"].encoding, [0.0] * 4, status)
        torque = arm.wired.inlet_bindings.receptions["LINK_2"]
        fault = state is LifeState.FAULT
        assert (torque.newest, torque.of_fault) == ((-1, 1) if fault else (0, 0))
        assert arm.wired.receivers["LINK_2"].ok == 1


@pytest.mark.parametrize("begun", [0, 1])
@pytest.mark.parametrize("command", [1, STOP, ARM, RESET, 77])
def test_a_start_is_late_in_a_run_and_no_other_command_is(node, begun, command):
    node.struct.begun = begun
    say(node, node.system.services["left"].nmt, [command, 0])
    assert node.struct.late_starts == (command == 1 and begun)
