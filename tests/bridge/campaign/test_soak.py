"""A soak: what is drawn, what fails a run, what is counted, and real runs."""

from __future__ import annotations

import subprocess
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from bridge.campaign import soak, soak_driver, soak_judgement, table
from bridge.campaign.soak_spec import FRAMES, LINKS, PROCESSES, draw, load_soak, text
from bridge.deployment.system import load_system
from bridge.faults.load import build
from bridge.native.safety import Why
from bridge.records.node_lives import Life
from bridge.records.records import Missed, Refused
from bridge.rehearsal import hosts, injector
from bridge.relay import namespaces
from cosim.base.copies import replace
from cosim.base.errors import RunError, ScenarioError
from cosim.loading.files import read_document
from cosim.record import seal, verify
from cosim.study.run_point import StudyRow
from cosim.study.runner import Observer
from cosim.study.store import Store
from tests.bridge.faulty import BOTH, SCENARIO, report, script, shown
from tests.bridge.rehearsing import COSIM, ROOT, environment
from tests.bridge.zenoh.rehearsed import prepared, sockets


@pytest.fixture(scope="module")
def system():
    return load_system(SCENARIO, "zenoh", ["run.step='5 ms'", "run.stop='10 s'"])


# ---- what is drawn ------------------------------------------------------------------------------


def test_what_is_drawn_depends_on_the_seed_and_the_run_only(system):
    given = load_soak(SCENARIO, None)
    first = [draw(given, system, BOTH, 3, k) for k in range(20)]
    assert first == [draw(given, system, BOTH, 3, k) for k in range(20)]
    assert first != [draw(given, system, BOTH, 4, k) for k in range(20)]
    assert len({str(document) for document in first}) == 20


def test_every_kind_is_drawn_and_is_a_script_that_ends_in_time(system, tmp_path):
    given, kinds = load_soak(SCENARIO, None), set()
    for k in range(60):
        document = draw(given, system, BOTH, 0, k)
        path = tmp_path / "script.toml"
        path.write_text(text(document))
        script = build(read_document(path), path)
        script.check(list(system.nodes), ["net"], ["xi_master", "xi_slave"])
        assert script == build(document, path)
        kinds |= {table["kind"] for table in document["fault"]}
        assert all(given.spec.first <= e.t <= given.spec.last + 1e-3 for e in script.events)
        assert all(given.spec.first <= f.t0 < f.t1 <= given.spec.last + 1e-3 for f in script.frames)
    assert kinds == {*FRAMES, *PROCESSES, *LINKS} == set(given.kinds)


def test_without_a_network_there_are_no_faults_of_one(system):
    given = load_soak(SCENARIO, None)
    drawn = [t["kind"] for k in range(40) for t in draw(given, system, (), 0, k)["fault"]]
    assert drawn and not set(drawn) & set(LINKS)


def test_faults_of_one_run_can_be_told_apart(system):
    given = load_soak(SCENARIO, None)
    for k in range(60):
        tables = draw(given, system, BOTH, 1, k)["fault"]
        reborn = [t["node"] for t in tables if t["kind"] == "restart"]
        assert len(reborn) == len(set(reborn))
        others = [t for t in tables if t["kind"] != "restart"]
        assert not {t.get("node") for t in others} & set(reborn)  # their counters die with them
        on_links = [t["kind"] for t in tables if t["kind"] in LINKS]
        assert len(on_links) == len(set(on_links))


HEAD = 'first = "1 s"\nlast = "2 s"\ntorque_max = 100\n'


@pytest.mark.parametrize(
    ("written", "said"),
    [
        ("[kinds.drop]\nfor = 1\n[kinds.fire]\nfor = 1", r"at kinds: unknown kind 'fire'"),
        ("[kinds.drop]\nfor = 1\nrate = 3", r"at kinds\.drop\.rate: unknown key; expected one of"),
        ("[kinds.drop]\nprobability = 1", r"at kinds\.drop: no for"),
        ('[kinds.drop]\nfor = ["2 s", "1 s"]', r"drop\.for: is 2 to 1; expected \[least, greatest"),
        ("[kinds.drop]\nfor = [1, 2, 3]", r"drop\.for: found 3 values"),
        ('[kinds.drop]\nfor = "1 kg"', r"drop\.for: "),
        ("kinds = {}", r"no \[kinds\.NAME\] table"),
        ("faults = [3, 1]\n[kinds.drop]\nfor = 1", r"at faults: is \[3, 1\]"),
    ],
)
def test_what_is_wrong_with_a_soaks_file_is_said(tmp_path, written, said):
    path = tmp_path / "soak.toml"
    path.write_text(HEAD + written)
    with pytest.raises(ScenarioError, match=said):
        load_soak(SCENARIO, path)


# ---- hosts --------------------------------------------------------------------------------------


def test_nodes_that_share_a_can_bus_share_a_host(system):
    assert hosts.groups(system) == {"master": ("master",), "slave": ("slave",)}
    mixed = hosts.groups(load_system(SCENARIO, "mixed"))
    assert mixed == {"master": ("master", "master_control"), "slave": ("slave", "slave_control")}
    assert list(hosts.groups(load_system(SCENARIO, "can"))) == ["master"]


def test_nodes_find_each_other_by_the_addresses_of_their_hosts(system):
    addresses = {"master": "10.0.0.1", "slave": "10.0.0.2"}
    said = hosts.settings(system, hosts.groups(system), addresses, "")
    again = load_system(SCENARIO, "zenoh", said).deployment.buses["net"].options
    tcp, udp = again["listen"]["slave"]
    assert tcp.startswith("tcp/10.0.0.2:7461?rel=1") and udp == "udp/10.0.0.2:7461?rel=0"
    assert again["insecure"]
    fixed = load_system(SCENARIO, "zenoh", ['deploy.buses.net.options.connect="tcp/127.0.0.1:1"'])
    with pytest.raises(ScenarioError, match="connects to a fixed address"):
        hosts.settings(fixed, hosts.groups(fixed), addresses, "")


# ---- what fails a run ---------------------------------------------------------------------------


def life(name, code=0):
    return SimpleNamespace(start=SimpleNamespace(life=Life.parse(name)), code=code)


def ended(system, folder, lives, script_=None, faults=()):
    """A run whose processes ended so; everybody finished."""
    run = shown(system, folder)
    (folder / "nodes").mkdir()
    outcome = SimpleNamespace(
        folder=folder, rows=run.rows, reports=run.reports, notes=[], replayed=None,
        faults=[
            SimpleNamespace(kind=kind, missing=(), targets=(), t0=4.0, t1=4.0) for kind in faults
        ],
    )  # fmt: skip
    judged = SimpleNamespace(failures=())
    return SimpleNamespace(
        system=system, script=script_ or script(), outcome=outcome, judged=judged, lives=lives
    )


BOTH_LIVES = (life("master"), life("slave"))
WELL = {"torque": 50.0, "together": 0.01}


def wrong(folder, done, **measures):
    return list(soak_judgement.judge_soak_run(job(folder).soak, done, {**WELL, **measures}).reasons)


def test_a_process_that_crashed_fails_a_run_and_one_that_was_killed_does_not(system, tmp_path):
    restart = script({"kind": "restart", "node": "slave", "at": 2, "for": 0.5})
    lives = [life("master"), life("slave", -9)]
    done = ended(system, tmp_path, lives, restart, ["restart"])
    assert wrong(tmp_path, done) == []
    done.script = script()
    assert wrong(tmp_path, done) == ["slave ended with exit code -9"]
    (tmp_path / "nodes" / "master.err").write_text("Traceback (most recent call last):\nOh: no\n")
    assert wrong(tmp_path, done)[0] == "master crashed: Oh: no"
    done.lives.append(life("slave@2"))
    assert "slave@2 has left no journal" in wrong(tmp_path, done)
    done.outcome.notes.append(Refused(t=3.0, life=Life("slave", 2), reasons=("apart",)))
    assert "slave@2 has left no journal" not in wrong(tmp_path, done)


def test_who_stopped_needs_a_fault_that_explains_it_and_no_torque(system, tmp_path):
    done = ended(system, tmp_path, BOTH_LIVES, faults=["drop"])
    done.outcome.reports[0] = report(Life("master"), "fault")
    done.outcome.rows["master"]["reasons"] = Why.OVERRUN
    assert wrong(tmp_path, done, together=9.0) == ["master stopped: overrun"]
    done.outcome.faults[0].kind = "freeze"
    assert wrong(tmp_path, done, together=9.0) == []  # who stopped need not arrive
    done.outcome.rows["master"]["scale"][-1] = 0.5
    assert wrong(tmp_path, done) == ["master stopped, with torque at 50%"]


def test_a_drive_that_heard_nothing_explains_a_stop(system, tmp_path):
    """Lost frames trip the watchdog of a drive, and the node that commands it obeys its state."""
    done = ended(system, tmp_path, BOTH_LIVES, faults=["drop"])
    done.outcome.reports[0] = report(Life("master"), "fault")
    done.outcome.rows["master"]["reasons"] = Why.DRIVE
    assert wrong(tmp_path, done, together=9.0) == []


def test_nodes_that_miss_one_that_is_started_too_late_are_of_time(system, tmp_path):
    done = ended(system, tmp_path, BOTH_LIVES, faults=["restart"])
    deaf = msgspec.structs.replace(
        done.outcome.reports[0].statement, error="receives nothing from X of slave for 10 s"
    )
    done.outcome.reports[0] = replace(done.outcome.reports[0], statement=deaf)
    assert wrong(tmp_path, done) == ["master: receives nothing from X of slave for 10 s"]
    measures = {**WELL, "late_p99_ms": 0.1}
    soak = job(tmp_path).soak
    assert list(soak_judgement._timed(soak, done, measures)) == []
    done.outcome.notes.append(Missed(t=12.0, life=Life("slave", 2), detail="opens its buses"))
    assert list(soak_judgement._broken_invariants(soak, done, measures)) == []
    assert len(list(soak_judgement._timed(soak, done, measures))) == 1


def test_arms_that_work_and_have_the_time_come_together(tmp_path):
    longer = load_system(SCENARIO, "zenoh", ["run.step='5 ms'", "run.stop='20 s'"])
    done = ended(longer, tmp_path, BOTH_LIVES, faults=["drop"])
    assert wrong(tmp_path, done) == []
    assert wrong(tmp_path, done, together=0.4) == ["0.4 apart, 16.0 s after the last fault"]
    assert wrong(tmp_path, done, together=np.nan) == ["nan apart, 16.0 s after the last fault"]
    done.outcome.faults[0].t1 = 12.0
    assert wrong(tmp_path, done, together=0.4) == []
    assert wrong(tmp_path, done, torque=101.0) == ["a torque of 101 N.m"]
    done.outcome.rows["slave"]["signals"][-1, 0] = np.inf
    assert wrong(tmp_path, done) == ["slave ended with signals that are not numbers"]


# ---- what is counted ----------------------------------------------------------------------------


def rows():
    good = {"s": 20.0, "drop.injected": 2.0, "drop.seen": 1.0, "drop.idle": 1.0, "torque": 50.0}
    bad = {"s": 20.0, "freeze.injected": 1.0, "freeze.unseen": 1.0, "torque": 7.0, "crashes": 1.0}
    return [
        StudyRow(
            "00000",
            {"faults": "drop, drop", "verdict": "passed"},
            (),
            True,
            measures=good,
            wall=21.0,
        ),
        StudyRow(
            "00001",
            {"faults": "freeze", "verdict": "failed"},
            (),
            False,
            "slave crashed",
            measures=bad,
            wall=22.0,
        ),
    ]


def job(folder, seed=0):
    deployment = ROOT / "configs" / "deploy" / "zenoh.toml"
    given = load_soak(SCENARIO, None)
    return soak.SoakSetup(
        scenario=SCENARIO, deployment=deployment, changes=(), folder=folder, soak=given, seed=seed
    )


def test_runs_that_are_there_are_not_made_again(tmp_path):
    soak_driver.soak(job(tmp_path), 0, 1)
    with Store(tmp_path, soak_driver.UNITS) as store:
        for row in rows():
            store.append(row)
    begun = []
    records = soak_driver.soak(job(tmp_path), 2, 1, observer=Observer(begun=begun.append))
    assert [(b.points, b.found, b.to_run) for b in begun] == [(2, 2, 0)]
    assert [r["run"] for r in records] == ["00000", "00001"]
    assert (tmp_path / soak_driver.TABLE).is_file()
    with pytest.raises(ScenarioError, match="was started with another seed, 0; expected 1"):
        soak_driver.soak(job(tmp_path, seed=1), 2, 1)


def test_a_table_by_kind_and_what_was_wrong(tmp_path):
    test_runs_that_are_there_are_not_made_again(tmp_path)
    records = soak_driver.soak(job(tmp_path), 2, 1)
    found = {row[0]: row[1:5] for row in table.kinds(records)}
    assert found["drop"] == ["2", "1", "1", "0"]
    assert found["freeze"] == ["1", "0", "0", "1"]
    assert found["all"] == ["3", "1", "1", "1"]
    facts = dict(table.facts(records))
    assert facts["runs"] == "2, 0.01 h"
    assert (facts["crashes"], facts["greatest torque"]) == ("1", "50.0 N.m")
    assert table.failures(records) == ["00001 (freeze): failed: slave crashed"]
    assert "slave crashed" in table.markdown(records, "Title")


@pytest.mark.slow
def test_a_run_waits_for_nodes_of_which_none_is_left(tmp_path):
    given = script(*(
        {"kind": "restart", "node": node, "at": 0.5, "for": 0.3} for node in ("master", "slave")
    ))  # fmt: skip
    changes = ["run.step='5 ms'", "run.stop='4 s'", *sockets(("master", "slave"), tmp_path)]
    system, running = prepared("teleoperation", "zenoh", changes, tmp_path / "run")
    running.settings = replace(running.settings, events=injector.events(given, system))
    with running:
        ended = running.run()
    assert [p.start.life for p in ended.lives] == [
        Life(node, boot) for boot in (1, 2) for node in ("master", "slave")
    ]
    assert [n.describe() for n in ended.notes[2:4]] == ["start master", "start slave"]


@pytest.mark.slow
def test_two_runs_with_processes_and_a_network(tmp_path):
    if why := hosts.missing():
        pytest.skip(f"no hosts here: {why}")
    words = ["soak", SCENARIO, "--hours", "0.0025", "--run", "5 s", "--parallel", "2"]
    words += ["--folder", tmp_path / "soak", "--faults", tmp_path / "soak.toml"]
    given = (ROOT / "configs" / "faults" / "soak.toml").read_text()
    given = given.replace('last = "9 s"', 'last = "3 s"').replace("[1, 4]", "[3, 3]")
    given = given.replace("../zenoh", str(ROOT / "configs" / "zenoh"))
    (tmp_path / "soak.toml").write_text(given)

    def run():
        return subprocess.run(
            [*COSIM, *map(str, words)],
            capture_output=True, text=True, cwd=ROOT, env=environment(), timeout=120,
        )  # fmt: skip

    done = run()
    assert done.returncode == 0, done.stdout + done.stderr
    assert "2 runs; 2 to run" in done.stdout and "passed" in done.stdout
    assert not list((tmp_path / "soak" / "runs").iterdir())  # all was well: nothing to keep
    again = run()
    assert "2 runs; 2 there already; 0 to run" in again.stdout
    assert namespaces.abandoned() == []


# ---- the folder of a run ------------------------------------------------------------------------


def test_a_run_that_is_kept_has_sums_of_all_its_files_also_of_those_that_came_last(tmp_path):
    """Records of packets are complete only when the hosts have gone, after the run was judged."""
    job = SimpleNamespace(folder=tmp_path, soak=load_soak(SCENARIO, None), seed=0, keep=False)
    job.changes = ()

    def run(folder):
        (folder / "packets").write_text("some")
        seal(folder)
        (folder / "packets").write_text("all of them")
        (folder / "late").write_text("a file of its own")
        raise RunError("it stopped")

    row = soak.judge_row(job, 3, run)
    assert row.reason == "no run: it stopped"
    folder = tmp_path / "runs" / "00003"
    verify(folder)
    assert "  late\n" in (folder / "SHA256SUMS").read_text()
