"""Simulated buses behind the wall clock: who is named, and what the verdict is."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bridge.deployment.system import System
from bridge.native.safety import GuardBit, LifeState, Why
from bridge.records.node_lives import Life
from bridge.records.records import Gone, Lagged, LifeEnd, Statement
from bridge.results import overload, verdict
from bridge.results.findings import Evidence
from bridge.results.timeline import FIRST, FirstCause, causes_text, happenings
from bridge.results.verdict import Word
from cosim.measure.robustness import Robustness
from cosim.measure.robustness import Verdict as RequirementVerdict
from tests.bridge.deployments import named

INLET = [("held", "<i8"), ("transit_ns", "<i8")]
PERIOD = 5_000_000  # ns
LAG = Lagged(t=1.5, bus="right", end=3.0, late=1.5)


@pytest.fixture(scope="module")
def system() -> System:
    return named(
        "can", 'deploy.buses.left.interface="cosim"', 'deploy.buses.right.interface="cosim"'
    )


def rows(system: System, node: str, slots: int = 1000) -> Any:
    """Rows of a node that was on time, and got everything after 1 ms."""
    fields: list[Any] = [
        ("slot", "<i8"), ("deadline_ns", "<i8"), ("woke_ns", "<i8"), ("state", "<i4"),
        ("reasons", "<u4"), ("guard", "<u4"), ("inlets", INLET, (len(system.nodes[node].inlets),)),
    ]  # fmt: skip
    found = np.zeros(slots, fields)
    found["slot"] = np.arange(slots)
    found["deadline_ns"] = found["woke_ns"] = found["slot"] * PERIOD
    found["state"] = LifeState.ACTIVE
    found["inlets"]["transit_ns"] = 1_000_000
    return found


def outcome(system: System, *notes: Any, faults: tuple[Evidence, ...] = ()) -> Any:
    """A run that every node finished."""
    lives = [Life(name) for name in system.nodes]
    reports = [
        SimpleNamespace(
            life=life, statement=Statement(life=life, end=LifeEnd.FINISHED), reasons=(), why="",
            end=LifeEnd.FINISHED,
        )
        for life in lives
    ]  # fmt: skip
    return SimpleNamespace(
        reports=reports, rows={life: rows(system, life.node) for life in lives}, notes=notes,
        faults=faults, finished=True, replayed=SimpleNamespace(first=None, altered=()),
        unanswered=(), replay_error="", required=(),
    )  # fmt: skip


@pytest.fixture(autouse=True)
def no_journals(monkeypatch: pytest.MonkeyPatch) -> None:
    """The numbers that are read from journals are missing."""
    for name in ("extra_frames", "extra_services", "_old_torques", "silent_ends"):
        monkeypatch.setattr(verdict, name, lambda *_: ())
    monkeypatch.setattr(overload, "_late_buses", lambda *_: iter(()))


def stopped(found: Any, node: str, why: Why, t: float) -> None:
    """Let a node stop at `t` (s)."""
    life = Life(node)
    report = next(r for r in found.reports if r.life == life)
    report.reasons, report.end = (why.name.lower(),), LifeEnd.FAULT
    report.why = f"because of {why.name.lower()}"
    late = found.rows[life]["deadline_ns"] * 1e-9 >= t
    found.rows[life]["state"][late] = LifeState.FAULT
    found.rows[life]["reasons"][late] = int(why)
    found.finished = False


def test_a_run_on_time_passes(system: System) -> None:
    found = outcome(system)
    assert verdict.judge(system, found).word is Word.PASSED
    assert happenings(system, found) == []


def required(verdict: RequirementVerdict) -> tuple[Robustness, ...]:
    return (Robustness("near", verdict, -1.0, "rad", 2.0, f"{verdict}, margin -1 rad"),)


def test_a_requirement_that_is_not_met_fails_a_run_that_would_pass(system: System) -> None:
    found = outcome(system)
    found.required = required("failed")
    judged = verdict.judge(system, found)
    assert (judged.word, judged.exit_code) == (Word.FAILED, 1)
    assert judged.reasons == ("requirement near: failed, margin -1 rad",)
    for word in ("passed", "inconclusive"):
        found.required = required(word)
        assert verdict.judge(system, found).word is Word.PASSED


def test_an_inconclusive_run_stays_so_whatever_its_requirements(system: System) -> None:
    found = outcome(system, LAG)
    found.required = required("failed")
    assert verdict.judge(system, found).word is Word.INCONCLUSIVE


def test_a_bus_that_stood_still_makes_a_run_inconclusive_even_if_nothing_stopped(
    system: System,
) -> None:
    found = verdict.judge(system, outcome(system, LAG))
    assert (found.word, found.exit_code) == (Word.INCONCLUSIVE, 3)
    assert found.reasons == ("bus right was up to 1.50 s behind the wall clock, until 3.00 s",)
    short = replace_late(LAG, overload.limit(system) * 0.9)
    assert verdict.judge(system, outcome(system, short)).word is Word.PASSED


def replace_late(lag: Lagged, late: float) -> Lagged:
    return Lagged(t=lag.t, bus=lag.bus, end=lag.end, late=late)


@pytest.mark.parametrize("why", [Why.GUARD, Why.COMPONENT, Why.WATCHDOG])
def test_what_moved_otherwise_or_later_is_due_to_the_bus(system: System, why: Why) -> None:
    """Values out of range and nodes that their guard stops, as in a run 72 rad off its twin."""
    found = outcome(system, LAG)
    stopped(found, "slave", why, 2.0)
    said = found.reports[0].statement
    found.reports[0].statement = replace_statement(said, {"LINK_2": {"range": 7}})
    judged = verdict.judge(system, found)
    assert judged.word is Word.INCONCLUSIVE
    assert judged.reasons[0].startswith("bus right was up to 1.50 s behind")
    assert any("7 samples out of range" in text for text in judged.reasons)
    found.notes = ()
    assert verdict.judge(system, found).word is Word.FAILED


def replace_statement(said: Statement, messages: Any) -> Statement:
    return Statement(life=said.life, end=said.end, messages=messages)


@pytest.mark.parametrize("wrong", ["replay", "emergency stop"])
def test_what_no_lag_explains_fails(system: System, wrong: str) -> None:
    found = outcome(system, LAG)
    if wrong == "replay":
        found.replayed = SimpleNamespace(first="master.q[0] at slot 3", altered=())
    else:
        stopped(found, "slave", Why.ESTOP, 2.0)
    assert verdict.judge(system, found).word is Word.FAILED


def test_a_lag_shows_in_the_samples_that_nodes_held(system: System) -> None:
    """It also holds if the bus is served by another process, whose lag is not watched."""
    found = outcome(system)
    life = Life("master_control")
    bus = system.messages[system.nodes[life.node].inlets[0].message].bus
    found.rows[life]["inlets"]["transit_ns"][300:340, 0] = 400_000_000
    [lag] = overload.bus_lags(system, found, 0.1)
    assert (lag.bus, lag.late) == (bus, pytest.approx(0.4))
    assert (lag.t, lag.end) == (pytest.approx(1.5), pytest.approx(1.695))
    assert verdict.judge(system, found).word is Word.INCONCLUSIVE
    found.rows[life]["inlets"]["held"][300:340, 0] = -1  # it held nothing then
    assert overload.bus_lags(system, found, 0.1) == []


def test_a_bus_that_a_fault_delays_or_that_is_real_is_not_late(system: System) -> None:
    fault = Evidence(index=0, kind="delay", targets=("master",), t0=1.4, t1=1.6, places=())
    for by, one in ((system, outcome(system, faults=(fault,))), (named("can"), outcome(system))):
        one.rows[Life("master_control")]["inlets"]["transit_ns"][300:340, 0] = 400_000_000
        assert overload.bus_lags(by, one, 0.1) == []


# ---- what happened first -------------------------------------------------------------------------


def test_the_first_causes_are_in_the_order_of_time(system: System) -> None:
    drive = {
        "t": 2.31,
        "drive": "drive 3",
        "phase": "failed",
        "told": "undervoltage",
        "failure": "",
    }
    fault = Evidence(index=0, kind="drive", targets=("slave",), t0=2.3, t1=3.0, places=())
    gone = Gone(t=3.0, life=Life("master"), end=LifeEnd.KILLED, detail="killed by SIGKILL")
    found = outcome(system, gone, faults=(fault,))
    stopped(found, "slave_control", Why.DRIVE, 2.33)
    for peer, t in (("slave", 2.4), ("master_control", 2.41)):
        stopped(found, peer, Why.PEER, t)
    said = next(r for r in found.reports if r.life.node == "slave_control").statement
    found.reports[3].statement = Statement(life=said.life, end=said.end, drives=(drive,))
    guarded = found.rows[Life("slave_control")]
    guarded["guard"][100:200] = int(GuardBit.TORQUE)
    listed = happenings(system, found)
    assert [(round(x.t, 3), x.who, x.what) for x in listed] == [
        (0.5, "slave_control", "the guard acted (torque limit)"),
        (2.3, "slave", "drive injected"),
        (2.31, "slave_control", "drive 3 went off (undervoltage)"),
        (2.33, "slave_control", "stopped (a drive is not enabled)"),
        (2.4, "slave, master_control", "stopped because of a peer"),
        (3.0, "master", "has ended: killed by SIGKILL"),
    ]
    text = causes_text(listed)
    assert text.startswith("0.500 s slave_control: the guard acted (torque limit) → 2.300 s slave:")


def test_a_node_that_woke_late_and_a_bus_that_stood_still_come_first(system: System) -> None:
    found = outcome(system, LAG)
    found.rows[Life("slave")]["woke_ns"][240] += 900_000_000
    stopped(found, "master", Why.WATCHDOG, 1.6)
    assert [x.who for x in happenings(system, found)] == ["slave", "bus right", "master"]
    assert happenings(system, found)[0].what == "woke up 900 ms late"


def test_a_long_story_is_cut() -> None:
    every = [FirstCause(float(t), "a", "b") for t in range(FIRST + 3)]
    assert causes_text(every).endswith(f"→ {FIRST - 1:.3f} s a: b → 3 more")
