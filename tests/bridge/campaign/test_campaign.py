"""A campaign: what is expected, what must never be, and three scripts with real processes."""

from __future__ import annotations

import subprocess
from types import SimpleNamespace
from zlib import crc32

import numpy as np
import pytest

from bridge.campaign import judgement, scripted
from bridge.campaign.soak import RunSetup
from bridge.campaign.spec import CampaignRunSpec, load_campaign
from bridge.deployment.system import load_system
from bridge.native.faults import CORRUPT, INJECTED
from bridge.native.journal import Journal
from bridge.native.safety import Why
from bridge.records.node_lives import ByLife, Life
from bridge.replay.replay import ReplayReport
from bridge.results.findings import Evidence, Place, Sign
from bridge.wiring.wiring import heard_dtype, row_dtype
from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.study.run_point import StudyRow
from cosim.study.runner import Observer
from cosim.study.store import Store
from tests.bridge.faulty import report
from tests.bridge.rehearsing import COSIM, NAMESPACE, ROOT, environment, possible

FILE = ROOT / "configs" / "faults" / "campaign.toml"
SPEC = CampaignRunSpec(script="x.toml", ends="finished")


@pytest.fixture(scope="module")
def system():
    return load_system(ROOT / "configs" / "teleoperation.toml", "can", ["run.stop=0.1"])


def outcome(
    system, folder, reasons=0, node="slave", end="finished", newest=(), counts=None, wait_ns=0
):
    """Of a run in which `node` ended so; it accepted `newest` of LINK_4, `wait_ns` late."""
    (folder / "nodes").mkdir()
    for name in ("run.json", "trajectories.parquet"):
        (folder / name).touch()
    rows = ByLife(
        {Life(name): np.zeros(20, row_dtype(plan)) for name, plan in system.nodes.items()}
    )
    rows[node]["reasons"] = reasons
    heard = np.zeros(1, heard_dtype(system, "slave"))[0]
    heard["message"] = system.received_by("slave").index("LINK_4")
    with Journal.create(folder / "nodes" / "slave.heard", heard.dtype, 20) as journal:
        for number in newest:
            heard["sequence"], heard["arrival_ns"] = number, number * 5_000_000 + wait_ns
            journal.append(*heard)
    reports = [
        report(
            life,
            end if life.node == node else "finished",
            messages={"LINK_4": counts} if counts and life.node == "slave" else {},
        )
        for life in rows
    ]
    return SimpleNamespace(
        folder=folder, rows=rows, reports=reports, replay_error="",
        replayed=ReplayReport({}, 0.0, None, ()), finished=end == "finished", faults=(),
    )  # fmt: skip


def corrupted(system, folder, k, after_ns=1_000_000):
    """The record of LINK_4 number k, one bit of it flipped on its way to the slave."""
    codec = system.messages["LINK_4"].encoding
    data = codec.encode([1.0, 2.0, 3.0, 4.0], counter=k)
    row = np.zeros(1, INJECTED)
    row["t_ns"], row["id"], row["length"] = k * 5_000_000 + after_ns, codec.message.id, len(data)
    row["through_ns"], row["crc"], row["crc_after"] = row["t_ns"], crc32(data), 1
    row["copies"] = 1
    row["kinds"], row["flags"] = 1 << CORRUPT, codec.message.flags
    row["data"][0, : len(data)] = list(data)
    with Journal.create(folder / "nodes" / "slave.faults", INJECTED, 10) as journal:
        journal.append(*row[0])


COUNTS = dict.fromkeys(("ok", "lost", *judgement.REFUSED), 0)


def test_a_corrupted_frame_that_was_refused(system, tmp_path):
    counts = {**COUNTS, "crc": 1, "lost": 1}
    found = outcome(system, tmp_path, newest=[6, 8], counts=counts)
    corrupted(system, tmp_path, 7)
    judged = judgement.judge(system, SPEC, found)
    assert (judged.corrupted, judged.undetected, judged.failures) == (1, 0, ())
    assert judged.seen == {"crc": 1, "lost": 1}


@pytest.mark.parametrize("how", ["number", "count"])
def test_a_corrupted_frame_that_was_accepted_fails_the_run(system, tmp_path, how):
    newest, crc = ([6, 7, 8], 1) if how == "number" else ([6, 8], 0)
    found = outcome(system, tmp_path, newest=newest, counts={**COUNTS, "ok": 9, "crc": crc})
    corrupted(system, tmp_path, 7)
    judged = judgement.judge(system, SPEC, found)
    assert judged.undetected == 1
    assert judged.failures == ("1 corrupted frames accepted",)


@pytest.mark.parametrize(("after_ns", "wait_ns"), [(1_200_000_000, 0), (500_000, 5_000_000)])
def test_a_number_that_was_accepted_at_another_time_is_that_of_another_frame(
    system, tmp_path, after_ns, wait_ns
):
    """A node that begins again counts from 0 until it starts; a gateway sends a sample again."""
    counts = {**COUNTS, "crc": 1, "ok": 1}
    found = outcome(system, tmp_path, newest=[7], counts=counts, wait_ns=wait_ns)
    corrupted(system, tmp_path, 7, after_ns=after_ns)
    assert judgement.judge(system, SPEC, found).undetected == 0


@pytest.mark.parametrize(
    ("spec", "fails"),
    [
        (
            CampaignRunSpec(script="x", ends="stopped", node="slave", because=("watchdog", "bus")),
            False,
        ),
        (CampaignRunSpec(script="x", ends="stopped"), False),
        (CampaignRunSpec(script="x"), False),
        (CampaignRunSpec(script="x", ends="finished"), True),
        (CampaignRunSpec(script="x", ends="stopped", node="master"), True),
        (CampaignRunSpec(script="x", ends="stopped", because=("estop",)), True),
        (CampaignRunSpec(script="x", sees=("crc",)), True),
    ],
)
def test_expectations(system, tmp_path, spec, fails):
    found = outcome(system, tmp_path, Why.WATCHDOG, end="fault")
    assert bool(judgement.judge(system, spec, found).failures) == fails


def test_what_must_never_be(system, tmp_path):
    found = outcome(system, tmp_path)
    found.rows["master_control"]["sent"][3, 1] = 100.5
    found.rows["slave_control"]["sent"][3, 1] = np.nan
    found.replayed, found.replay_error = None, "slot 3 waits"
    (tmp_path / "run.json").unlink()
    said = "; ".join(judgement.judge(system, SPEC, found).failures)
    for part in ("times its limit", "replay: slot 3 waits", "not in the run folder: run.json"):
        assert part in said


@pytest.mark.parametrize(("signs", "failures"), [((), 1), ((Sign(what="health"),), 0)])
def test_a_fault_that_no_report_shows_fails_the_run(system, tmp_path, signs, failures):
    found = outcome(system, tmp_path)
    place = Place(target="right", message="", done=1, signs=signs)
    found.faults = [
        Evidence(index=3, kind="bus-down", targets=["right"], t0=1.0, t1=1.3, places=[place])
    ]
    said = judgement.judge(system, SPEC, found).failures
    assert len(said) == failures
    assert all(s.startswith("no report shows fault 3: bus-down on right") for s in said)


def test_a_table_is_markdown(system, tmp_path):
    judged = judgement.judge(system, SPEC, outcome(system, tmp_path))
    failed = judgement.failed_run("y.toml", ValueError("dict | None\nno"))
    lines = judgement.markdown(judgement.table([judged, failed]))
    assert "dict \\| None no" in lines
    lines = lines.replace("\\|", "")
    assert lines.count("\n") == 4
    assert {line.count("|") for line in lines.splitlines()} == {9}


def test_the_campaign_of_the_project_has_every_script():
    scripts = {run.script for run, _ in load_campaign(FILE).runs}
    buses = load_campaign(FILE.with_name("buses-campaign.toml"))
    assert [run.script for run, _ in buses.runs] == ["buses.toml"] * 16
    scripts.add("buses.toml")
    others = {FILE.name, buses.path.name}
    others |= {"many.toml", "soak.toml", "soak-can.toml", "soak-mixed.toml"}
    assert scripts == {p.name for p in FILE.parent.glob("*.toml")} - others


def test_scripts_are_chosen_by_name_or_file_and_strange_ones_refused():
    found = load_campaign(FILE)
    assert [run.name for run in scripted.runs_of(found, ["drop.toml"])] == ["drop"]
    with pytest.raises(ScenarioError, match="no script 'drap'; did you mean 'drop'"):
        scripted.runs_of(found, ["drap"])


def test_runs_of_scripts_that_are_there_are_not_made_again(tmp_path):
    found = load_campaign(FILE)
    runs = scripted.runs_of(found, ["corrupt", "kill"])
    assert [run.name for run in runs] == ["corrupt", "kill"]
    deployment = ROOT / "configs" / "deploy" / "can.toml"
    job = RunSetup(
        scenario=found.scenario, deployment=deployment, changes=found.settings, folder=tmp_path
    )
    assert scripted.campaign(job, found, [], 1) == []
    good = judgement.JudgedRun(
        "corrupt", {"slave@2": "fault (peer)"}, {"crc": 3}, 3, 0, np.inf, True, "0", ()
    )
    with Store(tmp_path, {}) as store:
        store.append(scripted.row_of("corrupt", good, job.changes, 1.0))
        store.append(StudyRow("kill", {}, (), False, "the process died"))
    begun = []
    judged = scripted.campaign(job, found, runs, 1, observer=Observer(begun=begun.append))
    assert [(b.found, b.to_run) for b in begun] == [(2, 0)]
    assert judged[0] == ("corrupt", good)
    assert judged[1][1].failures == ("no run: the process died",)
    with pytest.raises(ScenarioError, match="was started with another settings"):
        scripted.campaign(replace(job, changes=()), found, runs, 1)


def test_a_script_for_a_kernels_bus_is_left_out_elsewhere(system):
    runs = scripted.runs_of(load_campaign(FILE), ["bus-down", "kill"])
    others = load_system(
        system.scenario.path, "can", ["run.stop=0.1", 'deploy.buses.left.interface="udp_multicast"']
    )
    for one, expected in ((system, [False, False]), (others, [True, False])):
        assert sorted(scripted.needs_kernel(one, run) for run in runs) == sorted(expected)


@pytest.mark.slow
def test_three_scripts_with_processes(tmp_path):
    possible()
    words = ["campaign", FILE, "-i", "udp_multicast", "--out", tmp_path / "runs"]
    words += ["--markdown", tmp_path / "table.md", "--set", 'run.step="5 ms"']
    words += ["--set", "run.stop=4", "--only", "corrupt", "--only", "kill", "--only", "bus-down"]
    done = subprocess.run(
        [*NAMESPACE, *COSIM, *map(str, words)],
        capture_output=True, text=True, cwd=ROOT, env=environment(), timeout=200,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "bus-down     left out" in done.stderr and "2 runs; 2 to run" in done.stdout
    table = (tmp_path / "table.md").read_text().splitlines()
    assert [line.split("|")[1].strip() for line in table[2:]] == ["corrupt", "kill"]
    assert int(table[2].split("|")[4]) > 20  # corrupted
