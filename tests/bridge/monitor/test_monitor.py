"""Snapshots agree with the journals, for runs that are active, finished or damaged."""

from __future__ import annotations

import os
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.monitor.journal_signals import JournalSignals, ages, lateness_names
from bridge.monitor.snapshot import SPAN, WAITING, snapshot
from bridge.monitor.view import TextTable, View, line, tables, view
from bridge.native.journal import Journal, JournalError
from bridge.native.safety import LifeState, Why
from bridge.recording.journal_tail import JournalTail
from bridge.recording.live_run import LiveRun, find_run, read_facts
from bridge.records.node_lives import Life
from bridge.rehearsal.supervisor import NODES
from bridge.safety.limits import explain
from cosim.base.errors import ScenarioError
from cosim.measure import declared_metrics
from cosim.measure.metrics import evaluate
from tests.bridge.watching import folder_of, own_pid, talk

ROW = np.dtype([("t_ns", "<i8"), ("q", "<f8", (3,))])
NOW = 10**10


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    place = tmp_path_factory.mktemp("made") / "run"
    return place, folder_of(place)


@pytest.fixture
def run(made, tmp_path):
    """A copy of the run, to be broken."""
    return Path(shutil.copytree(made[0], tmp_path / "run"))


# ---- reading a journal that grows ----


def test_rows_are_read_while_they_are_written(tmp_path):
    journal = Journal.create(tmp_path / "j", ROW, 100)
    with JournalTail(tmp_path / "j") as tail:
        for k in range(40):
            journal.append(k * 10, [k, 0, 0])
            assert len(tail) == k + 1
        assert not tail.closed
        assert tail.newest(3)["t_ns"].tolist() == [370, 380, 390]
        assert tail.rows(38, 50)["t_ns"].tolist() == [380, 390]
        assert tail.since("t_ns", 25)["t_ns"].tolist() == [370, 380, 390]
        journal.close()
        assert tail.closed
        assert tail.newest(1000)["q"][:, 0].tolist() == list(range(40))


def test_a_file_that_is_cut_or_made_anew_below_the_reader_gives_less_and_does_not_kill(tmp_path):
    journal = Journal.create(tmp_path / "j", ROW, 50_000)
    journal.append(1, [0, 0, 0])
    with JournalTail(tmp_path / "j") as tail:
        with (tmp_path / "j").open("r+b") as file:
            file.truncate(70)
        assert len(tail.newest(10)) == 0
        (tmp_path / "j").write_bytes(b"")
        assert len(tail) == 0 and len(tail.newest(5)) == 0


@pytest.mark.parametrize("content", [b"", b"cosim", b"x" * 200, b"cosimjnl" + b"\xff" * 56])
def test_what_is_no_journal_is_said(tmp_path, content):
    (tmp_path / "j").write_bytes(content)
    with pytest.raises(JournalError, match="j: "):
        JournalTail(tmp_path / "j")
    with pytest.raises(JournalError, match="No such file"):
        JournalTail(tmp_path / "none")


@given(times=st.lists(st.integers(0, 10**6), min_size=1, max_size=3000), span=st.integers(1, 10**6))
def test_since_is_the_rows_of_the_span(tmp_path_factory, times, span):
    path = tmp_path_factory.mktemp("since") / "j"
    times.sort()
    with Journal.create(path, ROW, len(times)) as journal:
        for t in times:
            journal.append(t, [0, 0, 0])
    with JournalTail(path) as tail:
        expected = [t for t in times if t > times[-1] - span]
        assert tail.since("t_ns", span)["t_ns"].tolist() == expected


# ---- the snapshot ----


def test_nodes_are_those_of_the_journals(made):
    place, system = made
    with LiveRun.open(place) as watched:
        found = snapshot(watched, NOW)
    assert [n.life for n in found.nodes] == [Life(n) for n in system.nodes]
    assert found.t == pytest.approx(2.0) and found.length == pytest.approx(2.0)
    assert not found.running
    for node in found.nodes:
        rows = Journal.open(place / NODES / node.life.file("journal"))
        last = rows[-round(SPAN / system.nodes[node.life.node].h) :]
        lateness = last["woke_ns"] - last["deadline_ns"]
        assert node.slot == rows["slot"][-1]
        assert node.late is not None
        assert (node.late.count, node.late.maximum) == (len(last), lateness.max())
        assert node.state == LifeState(int(rows["state"][-1])).name.lower()


def test_inputs_have_the_ages_of_the_journals(made):
    place, system = made
    with LiveRun.open(place) as watched:
        found = snapshot(watched, NOW)
    views = {x.target: x for x in found.inlets}
    for name, plan in system.nodes.items():
        rows = Journal.open(place / NODES / f"{name}.journal")[-round(SPAN / plan.h) :]
        for i, inlet in enumerate(plan.inlets):
            held = rows["inlets"][:, i]
            held = held[held["held"] >= 0]
            view = views[inlet.target.name]
            assert view.age[1] == pytest.approx(held["age_ns"].max() * 1e-6)
            assert view.network[0] == pytest.approx(np.median(held["transit_ns"]) * 1e-6)


def test_metrics_are_those_of_the_last_second(made):
    place, system = made
    with LiveRun.open(place) as watched:
        found = {r.name: r.value for r in snapshot(watched, NOW).metrics}
        whole = JournalSignals(system, watched.everything())
    q = [whole.array(f"{arm}.q") for arm in ("master", "slave")]
    assert found["sync_error"] == np.abs(q[0][-1] - q[1][-1]).max()
    torques = np.hstack([whole.array(f"{arm}_control.tau") for arm in ("master", "slave")])
    assert found["peak_torque"] == np.abs(torques[-1000:]).max()


def test_signals_hold_as_in_the_run_folder(made, tmp_path):
    from bridge.recording.run_folder import write_trajectories
    from cosim.record import Run

    place, system = made
    with LiveRun.open(place) as watched:
        rows = watched.everything()
    held = JournalSignals(system, rows)
    write_trajectories(system, {Life(node): r for node, r in rows.items()}, tmp_path)
    run = Run.open(tmp_path)
    assert np.array_equal(held.t, run.t)
    for name in ("master.q", "slave_control.tau", "master.tau_h"):
        assert np.array_equal(held.array(name), run.array(name))
        assert held.unit(name) == run.unit(name) and held.entries(name) == run.entries(name)
    assert evaluate(declared_metrics.metrics(system.scenario), held) == evaluate(
        declared_metrics.metrics(system.scenario), run
    )
    assert held.unit(lateness_names(["master"])[0]) == "ms"
    assert np.nanmax(held.array(ages(["master.tau"])[0])) > 0
    with pytest.raises(ScenarioError, match=r"no node has a signal 'master\.qq'"):
        held.array("master.qq")


def test_where_a_node_did_no_slot_there_is_a_gap_if_wanted(made):
    place, system = made
    with LiveRun.open(place) as watched:
        rows = watched.everything()
    control = rows["slave_control"]
    rows["slave_control"] = np.concatenate([control[:100], control[150:300]])
    q, gap = (
        JournalSignals(system, rows, gaps=g).array("slave_control.tau")[:, 0] for g in (False, True)
    )
    nothing = [*range(500, 750), *range(1500, 2000)]
    assert np.flatnonzero(np.isnan(gap)).tolist() == nothing
    assert not np.isnan(q).any() and len(set(q[500:750])) == 1
    assert np.array_equal(np.delete(q, nothing), np.delete(gap, nothing))


def test_frames_not_heard_are_counted_and_buses_have_a_load(made, run):
    _, system = made
    talk(run / NODES, system, "LINK_2", lost=10)
    with LiveRun.open(run) as watched:
        found = snapshot(watched, NOW)
    view = next(x for x in found.inlets if x.source == "master_control.tau")
    assert (view.lost, view.sent) == (20, 200)
    bus = {b.name: b for b in found.buses}
    assert bus["left"].frames == pytest.approx(200, abs=5)
    assert 0.005 < bus["left"].load < 0.05  # 200 FD frames of 24 bytes at 1/5 Mbit/s
    assert np.isnan(bus["right"].load)


def row_of(path):
    """The type of the rows of a journal."""
    with JournalTail(path) as tail:
        return tail.row


def test_what_stopped_a_node_is_said(run):
    row = row_of(run / NODES / "slave.journal")
    path = run / NODES / "slave.journal"
    kept = Journal.open(path).copy()
    kept["state"][-1], kept["reasons"][-1] = LifeState.STOPPING, Why.PEER
    kept["woke_ns"][-1] += 7_000_000
    with Journal.create(path, row, len(kept)) as journal:
        for values in kept:
            journal.append(*values)
    with LiveRun.open(run) as watched:
        found = snapshot(watched, NOW)
    node = next(n for n in found.nodes if n.life == Life("slave"))
    assert node.state == "stopping" and node.reasons == explain(Why.PEER)
    assert node.missed == 1
    nodes = tables(found)[0]
    assert [nodes.rows[i][0] for i in nodes.marked] == ["slave"]
    assert "slave stopping (1 missed)" in line(found)


def test_a_second_life_of_a_node_is_the_one_shown(run):
    shutil.copy(run / NODES / "slave.journal", run / NODES / "slave@2.journal")
    shutil.copy(run / NODES / "slave.journal", run / NODES / "slave@10.journal")
    with LiveRun.open(run) as watched:
        assert watched.lives_of("slave") == [Life("slave"), Life("slave", 2), Life("slave", 10)]
        assert [n.life for n in snapshot(watched, NOW).nodes][1] == Life("slave", 10)
    path = run / NODES / "slave@11.journal"
    with (
        Journal.create(path, row_of(run / NODES / "slave.journal"), 10),
        LiveRun.open(run) as watched,
    ):
        found = snapshot(watched, NOW)
        assert (found.nodes[1].life, found.nodes[1].state) == (Life("slave", 11), WAITING)
        assert any(x.name == "slave.q" for x in found.signals)  # of the life before


# ---- broken and partial folders ----


def test_a_journal_that_is_broken_is_said_and_the_others_are_shown(run):
    (run / NODES / "slave.journal").write_bytes(b"cosimjnl")
    with LiveRun.open(run) as watched:
        found = snapshot(watched, NOW)
    assert "begins with" in found.unreadable["slave.journal"]
    assert [n.life for n in found.nodes if n.state == WAITING] == [Life("slave")]
    assert all(np.isnan(r.value) for r in found.metrics if r.name == "sync_error")
    assert tables(found)[-1].rows[0][0] == "slave.journal"


def test_journals_of_another_system_are_refused(run):
    path = run / NODES / "slave.journal"
    shutil.copy(run / NODES / "slave_control.journal", path)
    with pytest.raises(ScenarioError, match=r"signals of shape \(19,\); slave has 15"):
        LiveRun.open(run)


def test_nodes_without_a_slot_yet(run):
    for path in (run / NODES).glob("*.journal"):
        row = row_of(path)
        Journal.create(path, row, 10).close()
    with LiveRun.open(run) as watched:
        found = snapshot(watched, NOW)
    assert {n.state for n in found.nodes} == {WAITING} and found.t == 0.0
    assert "master no slot yet" in line(found)
    assert not found.signals


def test_a_silent_node_of_a_run_that_goes_on_is_marked(tmp_path):
    folder_of(tmp_path / "run", pid=own_pid())
    path = tmp_path / "run" / NODES / "master.journal"
    rows = Journal.open(path).copy()
    writer = Journal.create(path, rows.dtype, len(rows) + 10)  # not closed: it goes on
    for values in rows:
        writer.append(*values)
    with LiveRun.open(tmp_path / "run") as watched:
        found = snapshot(watched, 5 * 10**9 + int(rows["done_ns"][-1]) + 3 * 10**9)
        node = next(n for n in found.nodes if n.life == Life("master"))
        assert found.running and node.quiet == pytest.approx(3.0)
        assert "silent for 3.0 s" in tables(found)[0].rows[0][-1]
        writer.close()
        assert not snapshot(watched, NOW).running


# ---- which run ----


def test_the_newest_run_that_goes_on_is_found(made, tmp_path):
    runs = tmp_path / "runs"
    for name, pid in (("old", own_pid()), ("new", 0)):
        shutil.copytree(made[0], runs / name)
        facts = (runs / name / "rehearsal.json").read_text()
        (runs / name / "rehearsal.json").write_text(facts.replace('"pid": 0', f'"pid": {pid}'))
    (runs / "empty").mkdir()
    assert find_run(runs).name == "old"
    (runs / "old" / "run.json").write_text('{"status": "running"}')  # as from its start on
    assert find_run(runs).name == "old"
    (runs / "old" / "run.json").write_text('{"status": "finished"}')
    os.utime(runs / "new")
    assert find_run(runs).name == "new"
    assert read_facts(runs / "new").settings == ("run.stop=2",)


def test_no_run_is_a_sentence(tmp_path):
    for runs in (tmp_path, tmp_path / "none"):
        with pytest.raises(ScenarioError, match="no run with journals of nodes in this folder"):
            find_run(runs)
    with pytest.raises(ScenarioError, match="there is no such run folder"):
        LiveRun.open(tmp_path / "none")
    with pytest.raises(ScenarioError, match="no journals of nodes"):
        LiveRun.open(tmp_path)


@pytest.mark.parametrize("text", [None, "{", "{}", "[]", '{"scenario": 3}'])
def test_a_folder_that_does_not_say_what_ran(run, text):
    (run / "rehearsal.json").unlink()
    if text is not None:
        (run / "rehearsal.json").write_text(text)
    with pytest.raises(ScenarioError, match="has no data of a rehearsal"):
        LiveRun.open(run)
    if text is None:
        (run / "run.json").write_text("{}")
        with pytest.raises(ScenarioError, match="--scenario and --deploy"):
            LiveRun.open(run)


@given(content=st.binary(max_size=300))
def test_any_bytes_are_a_journal_or_an_error(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "fuzzed.journal"
    version = struct.pack("<8sII", b"cosimjnl", 1, 8)
    path.write_bytes(version + content)
    try:
        with JournalTail(path) as tail:
            tail.newest(10)
    except JournalError as error:
        assert "fuzzed.journal" in str(error)


# ---- a narrow terminal ----


@pytest.mark.parametrize("width", [40, 60])
def test_a_narrow_terminal_hides_no_fault(width):
    nodes = TextTable(
        "nodes",
        ("node", "state", "slot", "late p50", "p99", "max us", "missed", "notes"),
        [
            ("master", "active", "4999", "12", "40", "85", "0", ""),
            ("slave_control", "fault", "412", "12", "40", "985", "7", "stale input; 3 injected"),
        ],
        frozenset({1}),
    )
    shown = list(View("run-1: t = 2.00 of 5 s; runs", "", [nodes]).lines(width))
    assert all(len(text) <= width for text, _ in shown)
    assert shown[0][0].startswith("run-1: ")
    red = " ".join(" ".join(text.split()) for text, marked in shown if marked)
    assert red.startswith("look at nodes: slave_control ")
    assert red.endswith("slave_control fault 412 12 40 985 7 stale input; 3 injected")
    wide = [text for text, _ in View("head", "", [nodes]).lines()]
    assert wide[-1].endswith("7  stale input; 3 injected")


def test_the_view_names_the_run(made):
    with LiveRun.open(made[0]) as watched:
        assert view(snapshot(watched, NOW)).head.startswith("run: t = ")
