"""A soak: what is drawn, what of it a report has to show, what is counted, and two real runs."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bridge import happen, hosts, soak, soak_drive, soak_table
from bridge.evidence import find
from bridge.evidence_links import Network
from bridge.faults import build
from bridge.journal import Journal
from bridge.native import faults as native
from bridge.native.faults import INJECTED
from bridge.native.frame import Frame
from bridge.native.safety import Why
from bridge.relay import namespaces
from bridge.relay.router import PACKET, TCP, UDP
from bridge.signs import SIGNS, Shown
from bridge.soak_spec import FRAMES, LINKS, PROCESSES, draw, load_soak, text
from bridge.system import load_system
from bridge.wiring import row_dtype
from cosim.errors import ScenarioError
from cosim.scenario import read_document
from cosim.sweep.perform import Row
from cosim.sweep.store import Store
from tests.bridge.rehearsing import COSIM, ROOT, environment
from tests.bridge.zenoh.rehearsed import prepared, sockets

SCENARIO = ROOT / "configs" / "teleoperation.toml"
BOTH = ("master>slave", "slave>master")


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
        assert all(given.first <= e.t <= given.last + 1e-3 for e in script.events)
        assert all(given.first <= f.t0 < f.t1 <= given.last + 1e-3 for f in script.frames)
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
        ("[kinds.drop]\nfor = 1\n[kinds.flood]\nfor = 1", r"at kinds: unknown kind 'flood'"),
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
    with pytest.raises(ScenarioError, match="connects to an address of its own"):
        hosts.settings(fixed, hosts.groups(fixed), addresses, "")


# ---- what a report has to show ------------------------------------------------------------------

COUNTS = dict.fromkeys(("ok", "lost", "crc", "length", "invalid", "range"), 0)
COUNTS |= {"repeated": 0, "reordered": 0}


def script(*tables):
    return build({"fault": list(tables)}, Path("script.toml"))


def shown(system, folder, counts=None, end="finished", notes=()):
    """A run of 10 s in which the master heard every sample."""
    rows = {name: np.zeros(plan.slots, row_dtype(plan)) for name, plan in system.nodes.items()}
    for r in rows.values():
        r["slot"] = np.arange(len(r))
        r["inlets"]["newest"][:, 0] = r["slot"]
    said = {"end": end, "messages": {"xi_slave": {**COUNTS, **(counts or {})}}, "syncs": {}}
    reports = [
        SimpleNamespace(life=life, said=said if life == "master" else {"end": "finished"})
        for life in system.nodes
    ]
    return Shown(system, rows, reports, folder, list(notes))


def injected(system, folder, n, kind, t=2.0, copies=1, changed=False, wait=0.0):
    """The record of `n` frames of xi_slave at the master, 5 ms apart."""
    rows = np.zeros(n, INJECTED)
    rows["t_ns"] = (t + 0.005 * np.arange(n)) * 1e9
    rows["through_ns"] = rows["t_ns"] + round(wait * 1e9)
    rows["id"] = system.messages["xi_slave"].encoding.message.id
    rows["kinds"], rows["copies"], rows["crc_after"] = 1 << kind, copies, changed
    with Journal.create(folder / "master.faults", INJECTED, max(n, 1)) as journal:
        for row in rows:
            journal.append(*row)


def drop(**more):
    return {"kind": "drop", "node": "master", "message": "xi_slave", "from": 1, "to": 5, **more}


@pytest.mark.parametrize(
    ("frames", "counts", "verdict"),
    [(40, {"lost": 41}, "seen"), (40, {"lost": 3}, "unseen"), (0, {"lost": 9}, "idle")],
)
def test_frames_that_were_dropped_have_to_be_counted_as_lost(
    system, tmp_path, frames, counts, verdict
):
    injected(system, tmp_path, frames, native.DROP, copies=0)
    (found,) = find(script(drop()), shown(system, tmp_path, counts))
    assert (found.verdict, found.done) == (verdict, frames)
    assert found.kind in found.text() and found.facts()["verdict"] == verdict


@pytest.mark.parametrize(
    ("kind", "number", "counts", "done"),
    [
        ("corrupt", native.CORRUPT, {"crc": 20}, {"changed": True}),
        ("corrupt", native.CORRUPT, {"length": 1, "crc": 19}, {"changed": True}),
        ("duplicate", native.DUPLICATE, {"repeated": 12, "reordered": 8}, {"copies": 2}),
        ("reorder", native.REORDER, {"reordered": 18}, {}),
        ("burst", native.BURST, {"lost": 20}, {"copies": 0}),
    ],
)
def test_each_kind_has_counters_of_its_own(system, tmp_path, kind, number, counts, done):
    injected(system, tmp_path, 20, number, **done)
    more = {"probability": 0.5}
    given = script(drop(kind=kind, **more))
    assert find(given, shown(system, tmp_path, counts))[0].verdict == "seen"
    others = {"ok": 99, "simulated": 5}
    assert find(given, shown(system, tmp_path, others))[0].verdict == "unseen"


def test_a_delay_shows_in_the_time_on_the_way(system, tmp_path):
    injected(system, tmp_path, 20, native.DELAY, wait=0.3)
    given, run = script(drop(kind="delay", by=0.3)), shown(system, tmp_path)
    assert find(given, run)[0].verdict == "unseen"
    run.rows["master"]["inlets"]["transit_ns"][450:460, 0] = 301_000_000
    assert find(given, run)[0].shown == ("master xi_slave: up to 301 ms on the way",)


def test_a_frame_that_another_fault_has_hidden_is_none_of_this_one(system, tmp_path):
    injected(system, tmp_path, 20, native.DUPLICATE, copies=0)  # dropped by a later rule
    (found,) = find(script(drop(kind="duplicate")), shown(system, tmp_path))
    assert found.verdict == "idle"


def test_a_frozen_node_is_late(system, tmp_path):
    given = script({"kind": "freeze", "node": "slave", "at": 2, "for": 0.5})
    run = shown(system, tmp_path, notes=["t = 2.011 s: freeze slave", "t = 2.512 s: thaw slave"])
    assert find(given, run)[0].verdict == "unseen"
    run.rows["slave"]["woke_ns"][400:402] = 480_000_000
    assert find(given, run)[0].shown == ("slave: 0.48 s late",)


def test_a_second_life_is_seen_and_an_event_that_never_came_is_idle(system, tmp_path):
    given = script({"kind": "restart", "node": "slave", "at": 2, "for": 0.5})
    assert find(given, shown(system, tmp_path))[0].verdict == "idle"
    run = shown(system, tmp_path, notes=["t = 2.001 s: kill slave", "t = 2.502 s: start slave"])
    assert find(given, run)[0].verdict == "unseen"
    both = {**run.rows, "slave.2": run.rows["slave"][600:]}
    assert find(given, replace(run, rows=both))[0].shown == ("slave: slave.2 began",)


def packets(n, lost=0, delay=0.0, protocol=UDP):
    """Of xi_slave on its way to the master, from 2 s on; the first are lost."""
    rows = np.zeros(n, PACKET)
    rows["t_ns"] = (2.0 + 0.005 * np.arange(n)) * 1e9
    rows["delay_ns"], rows["length"] = round(delay * 1e9), 98
    rows["protocol"] = protocol
    rows["left_ns"] = rows["t_ns"] + rows["delay_ns"]
    rows["delay_ns"][:lost] = rows["left_ns"][:lost] = -1
    there = {"slave>master": rows, "master>slave": rows[:0]}
    recorded = SimpleNamespace(names=BOTH, of=there.__getitem__)
    return Network(recorded, {n: (n,) for n in ("master", "slave")}, 0)


def test_faults_of_a_network_show_at_the_far_end(system, tmp_path):
    def judged(table, network, counts=None, change=lambda inlets: None):
        run = shown(system, tmp_path, counts, notes=[f"t = 2 s: {table['kind']} slave>master"])
        change(run.rows["master"]["inlets"][:, 0])
        given = script({"link": "slave>master", "at": 2, "for": 1, **table})
        return find(given, run, network)[0].verdict

    def silent(inlets):
        inlets["newest"][400:600] = 399

    def late(inlets):
        inlets["transit_ns"][430:440] = 200_000_000

    down = {"kind": "net-down"}
    assert judged(down, packets(200, lost=200)) == "unseen"
    assert judged(down, packets(200, lost=200), change=silent) == "seen"
    assert judged(down, packets(3, lost=3)) == "idle"
    slow = {"kind": "net-delay", "by": 0.2}
    assert judged(slow, packets(200, delay=0.2)) == "unseen"
    assert judged(slow, packets(200, delay=0.2), change=late) == "seen"
    loss = {"kind": "net-loss", "probability": 0.3}
    assert judged(loss, packets(200, lost=60)) == "unseen"
    assert judged(loss, packets(200, lost=60), {"lost": 60}) == "seen"
    assert judged(loss, packets(200, lost=60, protocol=TCP)) == "idle"  # it repeats them


def test_what_shows_a_fault_is_on_the_page():
    page = (ROOT / "docs" / "faults.md").read_text()
    for kind in SIGNS:
        assert f"\n| {kind} | " in page, kind


def test_a_message_of_zenoh_is_hit_by_its_name(system):
    """Its number is above all 11-bit identifiers, and yet no 29-bit one."""
    rules = script(drop()).frames_for("master", system.identifiers("master"), {"net": 0})
    number = system.messages["xi_slave"].encoding.message.id
    rules.injector.put(Frame.of(number, bytes(40), 0, 2_000_000_000 + 1), 1)
    assert rules.hits() == {0: 1}


class Told:
    """A network that keeps what it was told."""

    names = BOTH

    def __init__(self):
        self.links = {}

    def set(self, link, **spec):
        self.links[link] = spec


def test_faults_of_one_link_add_up_and_end_one_by_one(system):
    network = Told()
    given = script(
        {"kind": "net-rate", "at": 1, "for": 3, "rate": 1e5},
        {"kind": "net-down", "at": 2, "for": 1, "link": "master>slave"},
    )
    told = []
    for event in happen.events(given, system, network):
        event.do(None)
        told.append(dict(network.links))
    rate, both = {"rate": 1e5}, {"rate": 1e5, "down": True}
    assert told[0] == dict.fromkeys(BOTH, rate)
    assert told[1] == {"master>slave": both, "slave>master": rate}
    assert told[2] == told[0] and told[3] == {link: {} for link in BOTH}


def test_a_network_that_is_not_there_is_an_error(system):
    given = script({"kind": "net-down", "at": 1, "for": 1, "link": "slave>x"})
    with pytest.raises(ScenarioError, match=r"fault\.0\.kind: net-down needs nodes on hosts"):
        happen.events(given, system)
    with pytest.raises(ScenarioError, match=r"fault\.0\.link: no link 'slave>x'; there are: mas"):
        happen.events(given, system, Told())
    with pytest.raises(ScenarioError, match='expected "FROM>TO"'):
        script({"kind": "net-down", "at": 1, "for": 1, "link": "slave"})


# ---- what fails a run ---------------------------------------------------------------------------


def life(name, code=0):
    node = name.partition(".")[0]
    return SimpleNamespace(start=SimpleNamespace(life=name, node=node), code=code)


def ended(system, folder, lives, script_=None, faults=()):
    """A run whose processes ended so; everybody finished."""
    run = shown(system, folder)
    (folder / "nodes").mkdir()
    for report in run.reports:
        report.said = {"end": "finished"}
    outcome = SimpleNamespace(
        folder=folder, rows=run.rows, reports=run.reports, notes=[],
        faults=[SimpleNamespace(kind=kind, missing=(), t1=4.0) for kind in faults],
    )  # fmt: skip
    judged = SimpleNamespace(failures=())
    return SimpleNamespace(
        system=system, script=script_ or script(), outcome=outcome, judged=judged, lives=lives
    )


BOTH_LIVES = (life("master"), life("slave"))
WELL = {"torque": 50.0, "together": 0.01}


def wrong(folder, done, **measures):
    return list(soak._failures(job(folder), done, {**WELL, **measures}))


def test_a_process_that_crashed_fails_a_run_and_one_that_was_killed_does_not(system, tmp_path):
    restart = script({"kind": "restart", "node": "slave", "at": 2, "for": 0.5})
    lives = [life("master"), life("slave", -9)]
    done = ended(system, tmp_path, lives, restart, ["restart"])
    assert wrong(tmp_path, done) == []
    done.script = script()
    assert wrong(tmp_path, done) == ["slave ended with exit code -9"]
    (tmp_path / "nodes" / "master.err").write_text("Traceback (most recent call last):\nOh: no\n")
    assert wrong(tmp_path, done)[0] == "master crashed: Oh: no"
    done.lives.append(life("slave.2"))
    assert "slave.2 has left no journal" in wrong(tmp_path, done)
    done.outcome.notes.append("t = 3 s: node slave.2 refuses to start: apart")
    assert "slave.2 has left no journal" not in wrong(tmp_path, done)


def test_who_stopped_needs_a_fault_that_explains_it_and_no_torque(system, tmp_path):
    done = ended(system, tmp_path, BOTH_LIVES, faults=["drop"])
    done.outcome.reports[0].said["end"] = "fault"
    done.outcome.rows["master"]["reasons"] = Why.OVERRUN
    assert wrong(tmp_path, done, together=9.0) == ["master stopped: overrun"]
    done.outcome.faults[0].kind = "freeze"
    assert wrong(tmp_path, done, together=9.0) == []  # who stopped need not arrive
    done.outcome.rows["master"]["scale"][-1] = 0.5
    assert wrong(tmp_path, done) == ["master stopped, with torque at 50%"]


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
        Row("00000", {"faults": "drop, drop"}, (), True, measures=good, wall=21.0),
        Row("00001", {"faults": "freeze"}, (), False, "slave crashed", measures=bad, wall=22.0),
    ]


def job(folder, seed=0):
    deployment = ROOT / "configs" / "deploy" / "zenoh.toml"
    given = load_soak(SCENARIO, None)
    return soak.Job(SCENARIO, deployment, (), given, folder, seed, hosted=False, network=False)


def test_runs_that_are_there_are_not_made_again(tmp_path):
    soak_drive.soak(job(tmp_path), 0, 1)
    with Store(tmp_path, soak_drive.UNITS) as store:
        for row in rows():
            store.append(row)
    begun = []
    records = soak_drive.soak(job(tmp_path), 2, 1, begun=begun.append)
    assert [(b.points, b.found, b.todo) for b in begun] == [(2, 2, 0)]
    assert [r["run"] for r in records] == ["00000", "00001"]
    assert (tmp_path / soak_drive.TABLE).is_file()
    with pytest.raises(ScenarioError, match="was begun with another seed, 0; expected 1"):
        soak_drive.soak(job(tmp_path, seed=1), 2, 1)


def test_a_table_by_kind_and_what_was_wrong(tmp_path):
    test_runs_that_are_there_are_not_made_again(tmp_path)
    records = soak_drive.soak(job(tmp_path), 2, 1)
    found = {row[0]: row[1:5] for row in soak_table.kinds(records)}
    assert found["drop"] == ["2", "1", "1", "0"]
    assert found["freeze"] == ["1", "0", "0", "1"]
    assert found["all"] == ["3", "1", "1", "1"]
    facts = dict(soak_table.facts(records))
    assert facts["runs"] == "2, 0.01 h"
    assert (facts["crashes"], facts["greatest torque"]) == ("1", "50.0 N.m")
    assert soak_table.failures(records) == ["00001 (freeze): slave crashed"]
    assert "slave crashed" in soak_table.markdown(records, "Title")


@pytest.mark.slow
def test_a_run_waits_for_nodes_of_which_none_is_left(tmp_path):
    given = script(*(
        {"kind": "restart", "node": node, "at": 0.5, "for": 0.3} for node in ("master", "slave")
    ))  # fmt: skip
    changes = ["run.step='5 ms'", "run.stop='6 s'", *sockets(("master", "slave"), tmp_path)]
    system, running = prepared("teleoperation", "zenoh", changes, tmp_path / "run")
    running.settings = replace(running.settings, events=happen.events(given, system))
    with running:
        ended = running.run()
    assert [p.start.life for p in ended.lives] == ["master", "slave", "master.2", "slave.2"]
    assert all(p.done and p.done["end"] == "finished" for p in ended.lives[2:])


@pytest.mark.slow
def test_two_runs_with_processes_and_a_network(tmp_path):
    if why := hosts.missing():
        pytest.skip(f"no hosts here: {why}")
    words = ["soak", SCENARIO, "--hours", "0.003", "--run", "6 s", "--parallel", "2"]
    words += ["--folder", tmp_path / "soak", "--faults", tmp_path / "soak.toml"]
    given = (ROOT / "configs" / "faults" / "soak.toml").read_text()
    given = given.replace('last = "9 s"', 'last = "4 s"').replace("[1, 4]", "[3, 3]")
    given = given.replace("../zenoh", str(ROOT / "configs" / "zenoh"))
    (tmp_path / "soak.toml").write_text(given)

    def run():
        return subprocess.run(
            [*COSIM, *map(str, words)],
            capture_output=True, text=True, cwd=ROOT, env=environment(), timeout=120,
        )  # fmt: skip

    done = run()
    assert done.returncode == 0, done.stdout + done.stderr
    assert "2 runs; 2 to run" in done.stdout and "as they had to be" in done.stdout
    assert not list((tmp_path / "soak" / "runs").iterdir())  # all was well: nothing to keep
    again = run()
    assert "2 runs; 2 there already; 0 to run" in again.stdout
    assert namespaces.abandoned() == []
