"""Lives of nodes: their text form, their files, and node names that look like lives."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.deployment.system import load_system
from bridge.monitor.snapshot import snapshot
from bridge.recording.live_run import LiveRun
from bridge.recording.run_folder import write_trajectories
from bridge.records.node_lives import ByLife, Life, files, frame_files, lives_of
from bridge.records.records import (
    Done,
    Gone,
    LifeEnd,
    Missed,
    Note,
    Refused,
    Remark,
    Statement,
    reason_names,
    refusal,
)
from bridge.rehearsal.settings import ScheduledEvent
from bridge.rehearsal.supervisor import Rehearsal, Settings
from bridge.replay import replay, twin
from bridge.replay.diff import compare_runs
from bridge.results.outcome import complete, lines
from cosim.record import Run
from tests.bridge.deployments import TELEOPERATION, document, written

NAMES = {
    "master": "arm",
    "slave": "arm.2",
    "master_control": "arm.control",
    "slave_control": "плечо 2",
}
lives = st.builds(Life, st.text(max_size=20), st.integers(1, 50))


@given(lives)
def test_the_text_of_a_life_is_read_back(life):
    assert Life.parse(str(life)) == life
    assert "/" not in str(life) and "\0" not in str(life)


@given(lives, st.text(max_size=10), lives, st.text(max_size=10))
def test_two_lives_never_have_the_same_files(a, bus, b, other):
    kinds = ("journal", "json", "faults", "err")
    mine, theirs = ([life.file(k) for k in kinds] for life in (a, b))
    assert a == b or not {*mine, a.frames(bus)} & {*theirs, b.frames(other)}
    assert (a.frames(bus) == b.frames(other)) == ((a, bus) == (b, other))


@pytest.mark.parametrize("text", ["x@one", "x@1", "x@02", "x@", "a b/c", "x@2@3", "%61"])
def test_what_is_no_life(text):
    with pytest.raises(ValueError, match=r"not a valid name of a life|invalid literal"):
        Life.parse(text)


def test_files_of_lives(tmp_path):
    for name in (
        "a.journal",
        "a@2.journal",
        "a@10.journal",
        "a.2.journal",
        "x@y.journal",
        "a.json",
    ):
        (tmp_path / name).touch()
    for name in ("a.left.frames", "a.b%2Ec.frames", "a.b.c.frames"):
        (tmp_path / name).touch()
    found = files(tmp_path, "journal")
    assert list(found) == [Life("a"), Life("a", 2), Life("a", 10), Life("a.2")]
    assert lives_of(found, "a") == [Life("a"), Life("a", 2), Life("a", 10)]
    assert list(frame_files(tmp_path, "b.c")) == [Life("a")]
    assert list(frame_files(tmp_path, "c")) == [Life("a.b")]
    assert ByLife({Life("a", 2): 7})["a@2"] == 7


NOTES = [
    (Done(t=2.0014, action="kill", target="arm.2", index=3), "t = 2.001 s: kill arm.2"),
    (Remark(t=0.5, remark="by hand"), "t = 0.500 s: by hand"),
    (
        Gone(t=1.0, life=Life("arm.2"), end=LifeEnd.KILLED, code=-9, detail="killed by SIGKILL"),
        "t = 1.000 s: node arm.2 has ended: killed by SIGKILL",
    ),
    (
        Missed(t=9.0, life=Life("arm", 2)),
        "t = 9.000 s: node arm@2 was not ready before the end",
    ),
    (
        Refused(t=3.0, life=Life("arm", 2), reasons=("apart",)),
        "t = 3.000 s: node arm@2 refuses to start: the arms are too far apart to start",
    ),
]


@pytest.mark.parametrize(("note", "text"), NOTES)
def test_notes_are_records_and_have_a_text(note, text):
    import msgspec

    assert str(note) == text
    assert msgspec.json.decode(json.dumps(note.facts()), type=Note) == note


@pytest.mark.parametrize(
    ("bits", "armed", "said"),
    [
        (1, False, "not armed"),
        (1, True, "not in this state"),
        (1 | 1024, False, "the arms are too far apart to start"),
        (1 << 30, True, "not in this state"),
    ],
)
def test_why_a_start_was_refused(bits, armed, said):
    assert refusal(reason_names(bits), armed) == said


def test_a_statement_is_read_as_it_was_written(tmp_path):
    said = Statement(life=Life("a.b", 3), end=LifeEnd.FAULT, reasons=("peer",), injected={2: 5})
    said.write(tmp_path)
    assert Statement.read(tmp_path, Life("a.b", 3)) == said
    assert Statement.read(tmp_path, Life("a.b")) is None
    assert "required peer" in said.why


# ---- nodes whose names look like lives, or need more than ASCII ---------------------------------


@pytest.fixture
def deployment(tmp_path, request):
    """``can.toml`` with other names of its nodes, on buses that do not leave the process."""
    found = document()
    found["nodes"] = {
        NAMES[name]: {**spec, "requires": [NAMES[r] for r in spec.get("requires", [])]}
        for name, spec in found["nodes"].items()
    }
    found["sync"] = NAMES[found["sync"]]
    for name, bus in found["buses"].items():
        bus |= {"interface": "virtual", "channel": f"{request.node.name} {name}"}
    return written(found, tmp_path)


SHORT = ('run.step="5 ms"', "run.stop=0.6")
LONGER = (*SHORT[:1], "run.stop=6", 'deploy.nodes."arm.control".overrun="2 s"')


def tau(folder):
    run = Run.open(folder)
    return {n: run.column(n) for n in run.names if n.endswith(("control.tau[0]", "control.tau[1]"))}


@pytest.mark.slow
def test_a_rehearsal_with_such_names_is_whole(deployment, tmp_path):
    system = load_system(TELEOPERATION, str(deployment), LONGER)
    again = [
        ScheduledEvent(
            0.2,
            "gone",
            lambda r: (r.expected.add("arm.2"), r.current["arm.2"].send_command("quit")),
        ),
        ScheduledEvent(0.3, "back", lambda r: r.restart("arm.2"), restarts_node=True),
    ]
    settings = Settings(
        TELEOPERATION, deployment, LONGER, warm_up=0.0, realtime=False, events=again
    )
    folder = tmp_path / "run"
    with Rehearsal(system, settings, folder) as rehearsal:
        rehearsal.run()
    facts = {"settings": list(LONGER)}
    outcome = complete(system, folder, rehearsal.ended, facts, formats=("log",))
    assert {life.node for life in outcome.rows} == set(NAMES.values())
    assert Life("arm.2", 2) in outcome.rows
    assert outcome.replayed is not None and outcome.replayed.first is None, outcome.replay_error
    assert all(np.abs(values).max() > 1.0 for values in tau(folder).values())
    assert {str(life) for life in outcome.rows} == set(
        json.loads((folder / "run.json").read_text())["rehearsal"]["nodes"]
    )
    assert any(text.startswith("arm.control ") for text in lines(system, outcome))
    assert (folder / "buses" / "left.log").stat().st_size > 0
    with LiveRun.open(folder) as watched:
        seen = snapshot(watched, 10**9)
    assert [view.life.node for view in seen.nodes] == list(system.nodes)
    assert [view.life for view in seen.nodes if view.life.node == "arm.2"] == [Life("arm.2", 2)]
    assert all(view.network[0] >= 0.0 for view in seen.inlets)


def test_the_names_of_nodes_change_nothing_of_a_twin(deployment, tmp_path):
    renamed = load_system(TELEOPERATION, str(deployment), SHORT)
    plain = load_system(TELEOPERATION, "can", SHORT)
    for name, system in (("renamed", renamed), ("plain", plain)):
        nodes = tmp_path / name / "nodes"
        nodes.mkdir(parents=True)
        twin.simulate(system, nodes)
        rows = replay.load(nodes)
        write_trajectories(system, rows, tmp_path / name)
        (tmp_path / name / "again").mkdir()
        assert (
            replay.replay(
                system,
                rows,
                replay.received_by_life(tmp_path / name / "nodes"),
                tmp_path / name / "again",
            ).first
            is None
        )
    assert compare_runs(tmp_path / "renamed", tmp_path / "plain").verdict == "identical"
    assert max(np.abs(v).max() for v in tau(tmp_path / "renamed").values()) > 1.0
