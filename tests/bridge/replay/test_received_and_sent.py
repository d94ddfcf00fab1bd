"""Received samples are recorded: a replay is exact for any peer, and reports foreign samples."""

from __future__ import annotations

import numpy as np
import pytest

from bridge.deployment.system import load_system
from bridge.native.frame import Frame
from bridge.native.journal import Journal
from bridge.native.message import Header
from bridge.native.node import THERE
from bridge.native.safety import LifeState
from bridge.recording.run_folder import write_tables, write_trajectories
from bridge.records.node_lives import Life
from bridge.replay import replay
from bridge.replay.diff import compare_runs
from bridge.replay.received_and_sent import History, _never_sent
from bridge.results.offline import run_offline
from bridge.results.outcome import deployment_facts
from bridge.results.report import fault_lines
from bridge.wiring.wiring import HEARD, heard_dtype, heard_rows
from cosim.base.errors import ScenarioError
from cosim.engine.simulate import metadata
from cosim.record import write_metadata
from tests.bridge.deployments import TELEOPERATION, document, named, run_twin, system_of
from tests.bridge.faulty import report
from tests.bridge.replay.test_replay import exact, go, make

STOP = "run.stop=3"


def twin_with(system, folder, at, do):
    """A twin in which `do` happens to its nodes, by name, at these times (s)."""
    folder.mkdir()
    wired = {n: make(system, n, folder / Life(n).file("journal"), 0.0) for n in system.nodes}
    try:
        for t in at:
            go(system, wired, t)
            do(t, wired)
        go(system, wired, system.plan.ticks * system.plan.h)
    finally:
        for node in wired.values():
            node.__exit__()
    return replay.load(folder)


def forge(system, message, to, t, values):
    """A frame of a message with a correct checksum and the next counter, put before node `to`."""
    carried = system.messages[message]
    number = round(t * 1e9 - carried.offset_ns) // carried.period_ns + 1
    sampled = number * carried.period_ns + carried.offset_ns
    header = Header(number, LifeState.ACTIVE, sampled // 1000)
    frame = carried.encoding.frame(np.asarray(values), header, round(t * 1e9))
    bus = system.buses_of(to.name).index(carried.bus)
    assert to._buses[bus].rx.put(Frame.of(frame.id, frame.payload, frame.flags, frame.t_ns))
    return number


@pytest.fixture
def forged(tmp_path):
    """(system, rows, forged numbers): at ten times somebody else speaks before the slave."""
    system, numbers = named("can", STOP), []

    def speak(t, wired):
        numbers.append(forge(system, "LINK_2", wired["slave_control"], t, [1.0, -2.0, 3.0, 4.0]))

    rows = twin_with(system, tmp_path / "twin", np.arange(10, 20) / 10 + 0.0022, speak)
    return system, rows, numbers


def test_a_run_with_a_forging_peer_replays_to_the_bit_and_the_peer_is_found(forged, tmp_path):
    system, rows, numbers = forged
    found = replay.replay(system, rows, replay.received_by_life(tmp_path / "twin"), tmp_path)
    assert exact(found), str(found.first)
    (altered,) = found.altered
    assert (altered.life, altered.message) == (Life("slave_control"), "LINK_2")
    assert (altered.count, altered.misnumbered, altered.unsent) == (len(numbers), 0, 0)
    assert (altered.number, altered.index, altered.heard) == (numbers[0], 0, 1.0)
    assert abs(altered.sent - 1.0) > 1e-3
    assert "did not come from the recorded sender or were altered" in str(altered)
    assert f"sample {numbers[0]}, value 0: heard 1, sent" in str(altered)


def test_a_run_without_strangers_has_none(tmp_path):
    system = named("can", STOP)
    rows = run_twin(system, tmp_path / "twin")
    found = replay.replay(system, rows, replay.received_by_life(tmp_path / "twin"), tmp_path)
    assert exact(found) and found.altered == () and found.alone == ()


def test_a_sample_nobody_sent_is_found_where_its_sender_was_away(tmp_path):
    system = named("can", STOP)
    (tmp_path / "twin").mkdir()
    rows = run_twin(system, tmp_path / "twin")
    master = rows[Life("master_control")]
    rows[Life("master_control")] = master[: len(master) // 3]
    rows[Life("master_control", 2)] = master[len(master) // 2 :]
    heard = replay.received_by_life(tmp_path / "twin")
    heard[Life("master_control", 2)] = heard["master_control"]
    found = replay.replay(system, rows, heard, tmp_path)
    gap = [a for a in found.altered if a.message == "LINK_2"]
    away = (len(master) // 2 - len(master) // 3) * system.nodes["master_control"].h
    assert gap and all(away / 0.005 - 30 < a.unsent <= away / 0.005 for a in gap)
    assert "never sent" in str(gap[0])


def test_a_sample_that_is_later_than_a_turn_of_its_counter_replays_too(tmp_path):
    """XI_2 counts to 16, a sample every 5 ms, and its stamp to 65 ms: it comes 0.15 s late."""
    system, waiting, been, taken = named("can-damiao", STOP), [], set(), Frame()

    def late(t, wired):
        node = wired["slave_control"]
        ring = node._buses[system.buses_of("slave_control").index("link")].rx
        while ring.get(taken):
            after = 150_000_000 if 1.0 < t < 2.0 and taken.payload not in been else 0
            waiting.append(Frame.of(taken.id, taken.payload, taken.flags, taken.t_ns + after))
            been.add(taken.payload)
        while waiting and waiting[0].t_ns < (t + 0.005) * 1e9:
            assert ring.put(waiting.pop(0))

    rows = twin_with(system, tmp_path / "twin", np.arange(1, 600) * 0.005 + 0.001, late)
    found = replay.replay(system, rows, replay.received_by_life(tmp_path / "twin"), tmp_path)
    assert exact(found), str(found.first)
    assert found.altered == ()


def test_a_sample_under_a_wrong_number_is_told_from_a_stranger(tmp_path):
    system = named("can-damiao", STOP)
    rows = run_twin(system, tmp_path / "twin")
    heard = replay.received_by_life(tmp_path / "twin")
    mine = heard["slave_control"].copy()
    late = (mine["message"] == system.received_by("slave_control").index("XI_2")) & (
        (mine["sequence"] >= 100) & (mine["sequence"] < 130)
    )
    mine["sequence"][late] += 48  # three turns of its counter
    heard[Life("slave_control")] = mine
    (altered,) = replay.replay(system, rows, heard, tmp_path).altered
    assert altered.message == "XI_2" and altered.misnumbered == altered.count == 30
    assert "older samples under a wrong number" in str(altered)


def recorded(system, folder):
    rows = run_twin(system, folder / "nodes")
    write_trajectories(system, rows, folder)
    write_tables(system, rows, folder)
    facts = metadata(system.scenario, system.plan) | deployment_facts(system, {"settings": []})
    write_metadata(folder, facts)
    return rows


def test_a_gateway_run_with_a_tripped_watchdog_is_identical_also_as_one_offline_run(tmp_path):
    changed = document("gateway")
    changed["messages"]["LINK_4"]["period"] = "250 ms"
    changed["nodes"]["slave_control"]["requires"] = []
    run = tmp_path / "run"
    run.mkdir()
    system = system_of(changed, tmp_path, STOP)
    rows = recorded(system, run)
    assert rows["slave"]["state"][-1] == LifeState.FAULT
    found = replay.replay(system, rows, replay.received_by_life(run / "nodes"), tmp_path)
    assert exact(found), str(found.first)
    assert found.altered == ()
    assert compare_runs(run, run_offline(system, run, rows)).verdict == "identical"


# ---- the journal of what was heard --------------------------------------------------------------


def test_a_history_that_begins_late_has_its_samples_by_their_numbers():
    history = History(1, 4, first=100)
    history.values[:, 0], history.there[:] = [1.0, 2.0, 3.0, 4.0], THERE
    numbers = np.array([99, 100, 103, 104])
    assert history.known(numbers).tolist() == [False, True, True, False]
    assert history.at(numbers[1:3]).ravel().tolist() == [1.0, 4.0]


def test_its_room_is_that_of_the_plan_with_a_margin():
    system = load_system(TELEOPERATION, "can", ["run.stop=8"])
    for node in system.nodes:
        sent = sum(8e9 / system.messages[m].period_ns for m in system.received_by(node))
        assert 1.2 * sent < heard_rows(system, node) < 1.3 * sent + 500


def test_a_full_journal_is_counted_and_its_inputs_are_taken_as_recorded(tmp_path, monkeypatch):
    system = named("can", STOP)
    monkeypatch.setattr("bridge.wiring.wiring.heard_rows", lambda system, name: 100)
    dropped = {}

    def look(t, wired):
        dropped.update({name: node.heard.dropped for name, node in wired.items()})

    rows = twin_with(system, tmp_path / "twin", [2.9], look)
    assert all(n > 100 for n in dropped.values())
    heard = replay.received_by_life(tmp_path / "twin")
    assert {len(r) for r in heard.values()} == {100}
    found = replay.replay(system, rows, heard, tmp_path)
    assert exact(found), str(found.first)
    assert set(found.alone) == {"STATE_1", "STATE_3", "LINK_2", "LINK_4"}


def test_samples_that_were_not_recorded_are_in_the_report():
    said = report(Life("slave"), heard_dropped=12, journal_dropped=3)
    assert [text.split(maxsplit=2)[2] for text in fault_lines([said])] == [
        "slave: 3 slots not recorded", "slave: 12 samples heard not recorded",
    ]  # fmt: skip


def test_numbers_that_no_run_has_are_said(tmp_path):
    system = named("can", STOP)
    rows = run_twin(system, tmp_path / "twin")
    heard = replay.received_by_life(tmp_path / "twin")
    for number in (-1, 1 << 40):
        damaged = heard["slave"].copy()
        damaged["sequence"][7] = number
        with pytest.raises(ScenarioError, match=r"of LINK_4 heard; a run has at most .* damaged"):
            replay.replay(system, rows, {**heard, Life("slave"): damaged}, tmp_path)


def test_a_journal_that_is_missing_or_of_another_deployment_is_said(tmp_path):
    system = named("can", STOP)
    rows = run_twin(system, tmp_path / "twin")
    path = tmp_path / "twin" / Life("slave").file(HEARD)
    other = named("zenoh", STOP)
    path.unlink()
    with pytest.raises(ScenarioError, match=r"no samples recorded for slave; .*slave\.heard"):
        replay.replay(system, rows, replay.received_by_life(tmp_path / "twin"), tmp_path)
    row = heard_dtype(other, "slave")
    with Journal.create(path, row, 1):
        pass
    with pytest.raises(ScenarioError, match="samples of other messages recorded for slave"):
        replay.replay(system, rows, replay.received_by_life(tmp_path / "twin"), tmp_path)


# ---- numbers that were never sent ----------------------------------------------------------------


@pytest.mark.parametrize("node", ["master", "master_control"])  # slots of 1 ms, and of 5 ms
@pytest.mark.parametrize(
    "lives", [[(0, 99)], [(3, 99)], [(0, 49), (120, 199)], [(0, 20), (23, 23), (151, 190)], []]
)
def test_a_number_is_never_sent_if_no_life_had_its_slot(node, lives):
    """Slot by slot, against sets; after the end of a life come some more, of its ramp (0.1 s)."""
    system = named("can", STOP)
    message = {"master": "STATE_1", "master_control": "LINK_2"}[node]
    every = {"master": 5, "master_control": 1}[node]  # slots between two samples
    slots, recorded = [(a * every, b * every) for a, b in lives], {}
    for boot, (first, last) in enumerate(slots, 1):
        rows = np.zeros(last - first + 1, [("slot", "<i8")])
        rows["slot"] = np.arange(first, last + 1)
        recorded[Life(node, boot)] = rows
    more = (2 + 20) * every  # 0.1 s are 20 samples
    sent = {s // every for a, b in slots for s in range(a, b + more + 1) if s % every == 0}
    end = slots[-1][1] // every if slots else -1
    numbers = np.arange(260)
    expected = [j <= end and j not in sent for j in numbers]
    assert _never_sent(system, recorded, message, numbers).tolist() == expected
