"""Runs with faults on a simulated clock, and the verdict on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

from bridge.campaign import compressed, judgement
from bridge.campaign.spec import CampaignRunSpec
from bridge.deployment.system import load_system
from bridge.faults.load import build
from bridge.native.frame import Flags, frame_dtype
from bridge.native.journal import Journal
from bridge.records.node_lives import Life
from bridge.results import verdict
from bridge.results.verdict import Word
from cosim.base.copies import replace
from tests.bridge.rehearsing import SCENARIO

FAULTS = {
    "forge": {"probability": 0.3, "count": 60},
    "replay": {"count": 100},
    "flood": {"rate": 5000.0},
    "absurd": {"probability": 0.3},
    "corrupt": {"probability": 0.3, "count": 3},
    "drop": {"probability": 0.3},
}
HEARD = {"can": ("slave", "LINK_4"), "zenoh": ("slave", "xi_master"), "mixed": ("slave", "LINK_4")}


def run(folder, deploy, kind, **more):
    system = load_system(SCENARIO, deploy, ["run.stop=2.0"])
    node, message = HEARD[deploy]
    table = {"kind": kind, "node": node, "message": message, "from": 0.8, "to": 1.3}
    script = build({"seed": 1, "fault": [{**table, **FAULTS[kind]}]}, Path("script.toml"))
    return system, compressed.run(system, script, folder, **more)


@pytest.mark.parametrize("deploy", HEARD)
@pytest.mark.parametrize("kind", ["forge", "replay", "flood"])
def test_a_hostile_peer_is_in_the_report_and_in_the_verdict(tmp_path, deploy, kind):
    system, outcome = run(tmp_path, deploy, kind)
    (fault,) = outcome.faults
    assert fault.verdict == "seen", fault.text()
    found = verdict.judge(system, outcome)
    assert found.word is Word.FAILED and found.exit_code == 1
    assert HEARD[deploy][1] in found.text()
    assert outcome.replayed is not None and outcome.replayed.first is None


def test_absurd_values_are_in_the_report_and_in_the_verdict(tmp_path):
    system, outcome = run(tmp_path, "can", "absurd")
    assert outcome.faults[0].verdict == "seen", outcome.faults[0].text()
    assert verdict.judge(system, outcome).word is Word.FAILED
    assert outcome.replayed is not None and outcome.replayed.first is None


@pytest.mark.parametrize("kind", ["corrupt", "drop"])
def test_faults_that_receivers_refuse_leave_the_verdict(tmp_path, kind):
    system, outcome = run(tmp_path, "can", kind)
    assert outcome.faults[0].verdict == "seen"
    assert verdict.judge(system, outcome).word is Word.PASSED
    assert not judgement.judge(system, CampaignRunSpec(script="x.toml"), outcome).failures


def test_a_simulated_run_with_faults_is_the_same_every_time(tmp_path):
    first, second = (run(tmp_path / n, "can", "drop")[1] for n in ("a", "b"))
    for life, rows in first.rows.items():
        assert rows.tobytes() == second.rows[life].tobytes()


def test_without_checks_corrupted_frames_are_accepted_and_that_is_noticed(tmp_path):
    system, outcome = run(tmp_path, "can", "corrupt", blind=True)
    judged = judgement.judge(system, CampaignRunSpec(script="x.toml"), outcome)
    assert judged.undetected > 0
    assert any("accepted" in text for text in judged.failures)
    assert outcome.faults[0].verdict == "unseen"


def test_a_machine_that_stands_still_makes_it_inconclusive(tmp_path):
    """What stopped is of time, and a node was late although no fault made it so."""
    system, outcome = run(tmp_path, "can", "drop")
    report = next(r for r in outcome.reports if r.life.node == "slave")
    rows = {life: np.copy(r) for life, r in outcome.rows.items()}
    stopped = _ended(report, ("overrun",))
    reports = [stopped if r is report else r for r in outcome.reports]
    outcome = _with(outcome, rows=rows, reports=reports)
    assert verdict.judge(system, outcome).word is Word.FAILED
    rows[report.life]["woke_ns"][500] += 90_000_000
    found = verdict.judge(system, outcome)
    assert found.word is Word.INCONCLUSIVE and found.exit_code == 3
    assert "90 ms" in found.text()
    worse = [_ended(r, ("estop",)) if r is stopped else r for r in reports]
    assert verdict.judge(system, _with(outcome, reports=worse)).word is Word.FAILED


def test_a_run_that_missed_its_period_is_inconclusive(tmp_path):
    """Nothing went wrong, but a node woke a period late in 9 % of its slots, and then in 18 %."""
    system, outcome = run(tmp_path, "can", "drop")
    life = next(r.life for r in outcome.reports if r.life.node == "slave")
    rows = {one: np.copy(r) for one, r in outcome.rows.items()}
    rows[life]["woke_ns"] = rows[life]["deadline_ns"]
    rows[life]["woke_ns"][::11] += round(system.nodes["slave"].plan.h * 1e9)
    outcome = _with(outcome, rows=rows)
    assert verdict.judge(system, outcome).word is Word.PASSED
    rows[life]["woke_ns"][5::11] += round(system.nodes["slave"].plan.h * 1e9)
    found = verdict.judge(system, outcome)
    assert found.word is Word.INCONCLUSIVE
    assert "slave missed 18% of its slots" in found.text()


def test_a_machine_that_misses_many_slots_makes_it_inconclusive(tmp_path):
    """Each slot is late by less than what stops a node, but thousands are missed."""
    system, outcome = run(tmp_path, "can", "drop")
    report = next(r for r in outcome.reports if r.life.node == "slave")
    rows = {life: np.copy(r) for life, r in outcome.rows.items()}
    reports = [_ended(r, ("stale",)) if r is report else r for r in outcome.reports]
    outcome = _with(outcome, rows=rows, reports=reports)
    woke, h = rows[report.life]["woke_ns"], round(system.nodes["slave"].plan.h * 1e9)
    woke[::100] += h
    assert verdict.judge(system, outcome).word is Word.FAILED
    woke[50::40] += h
    found = verdict.judge(system, outcome)
    assert found.word is Word.INCONCLUSIVE
    assert "overloaded: slave missed" in found.text()


def test_a_bus_that_delivers_late_makes_it_inconclusive(tmp_path):
    """What slave hears comes 100 ms late, and all nodes were on time; a fault of that is none."""
    system, outcome = run(tmp_path, "can", "drop")
    report = next(r for r in outcome.reports if r.life.node == "slave")
    reports = [_ended(r, ("stale",)) if r is report else r for r in outcome.reports]
    whole = [structs.replace(fault, t0=0.0, t1=2.0) for fault in outcome.faults]
    outcome = _with(outcome, faults=[])
    stopped = _with(outcome, reports=reports)
    assert verdict.judge(system, stopped).word is Word.FAILED
    _delayed(tmp_path / "nodes", "right", report.life, 100_000_000)
    found = verdict.judge(system, stopped)
    assert found.word is Word.INCONCLUSIVE
    assert "bus right delivered frames up to 10" in found.text()
    assert verdict.judge(system, outcome).word is Word.PASSED
    assert verdict.judge(system, _with(stopped, faults=whole)).word is Word.FAILED


def _delayed(nodes, bus, life, ns):
    """Logs of a life and of its peer: frames with a count, each heard so much later than sent."""
    peer = Life("master_control")
    for one, flags, later in ((peer, Flags.SENT, 0), (life, 0, ns)):
        path = nodes / one.frames(bus)
        with Journal.create(path, frame_dtype(), 200) as journal:
            for k in range(200):
                row = np.zeros((), frame_dtype())
                row["id"], row["length"], row["flags"] = 0x3A2, 8, flags
                row["t_ns"], row["data"][0] = 1_000_000_000 + 5_000_000 * k + later, k
                journal.append(*row.item())


def _ended(report, reasons):
    from bridge.records.records import LifeEnd

    said = structs.replace(report.statement, end=LifeEnd.FAULT)
    return type(report)(report.life, report.slots, report.lateness, report.state, reasons, said)


def _with(outcome, **changes):
    return replace(outcome, **changes)
