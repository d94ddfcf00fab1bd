"""A sample of the campaign of drive faults, what its judge sees, and defects that it has found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bridge.campaign import compressed, drive_judge
from bridge.campaign.drive_judge import judge_drives
from bridge.faults.load import build
from bridge.native.frame import Flags, frame_dtype
from bridge.native.journal import Journal
from bridge.native.safety import Command, LifeState, Why
from bridge.native.vendor import VendorFault
from bridge.records.node_lives import Life
from bridge.results import verdict
from bridge.results.verdict import Word
from cosim.base.copies import replace
from tests.bridge.deployments import named
from tests.drive_faults import __main__ as campaign
from tests.drive_faults import lives, waits


@pytest.mark.parametrize("seed", range(20))
def test_a_run_is_as_it_has_to_be(seed, tmp_path):
    row = lives.run(seed, tmp_path)
    assert row.problems == []
    assert row.torques > 0 and row.exact and row.forbidden == 0


def simulated(deployment, folder, *tables, commands=lives.COMMANDS, stop=lives.END):
    system = named(deployment, f"run.stop={stop}")
    script = build({"fault": [{"kind": "drive", **table} for table in tables]}, Path("x.toml"))
    return system, script, compressed.run(system, script, folder, commands=commands)


def states(outcome, node):
    """The states of a node one after the other."""
    state = outcome.rows[Life(node)]["state"]
    return [LifeState(s).name for s in state[np.r_[True, np.diff(state) != 0]]]


# ---- defects that the campaign has found ----


@pytest.mark.parametrize("deployment", ["can-damiao", "openarm", "six_axis", "can-cia402"])
def test_drives_that_said_nothing_for_long_are_brought_up(deployment, tmp_path):
    """A Damiao drive answers commands only: before ARM its position is of no age at all."""
    commands = ((300_000_000, (Command.ARM, Command.START)),)
    _, _, outcome = simulated(deployment, tmp_path, commands=commands, stop=0.8)
    assert states(outcome, "master_control") == ["INACTIVE", "ACTIVE"]
    assert outcome.replayed.first is None


@pytest.mark.parametrize("deployment", ["can-damiao", "six_axis", "can"])
def test_a_second_bring_up_in_a_run_leaves_the_verdict(deployment, tmp_path):
    """Answers of registers are no positions, torques that feed a drive are its message's frames."""
    system, _, outcome = simulated(deployment, tmp_path)
    found = verdict.judge(system, outcome)
    assert "out of range" not in found.text() and "somebody else" not in found.text()
    assert found.word is Word.PASSED or deployment == "can"  # there a STOP is told as a fault
    for node in ("master", "slave", "master_control"):
        assert outcome.rows[Life(node)]["state"][-1] == LifeState.ACTIVE


def test_a_run_with_a_drive_off_has_not_passed_although_it_was_started_again(tmp_path):
    table = {"bus": "right", "drive": 12, "does": "trip", "code": 0x2310, "at": 0.5}
    system, _, outcome = simulated("can-cia402", tmp_path, table)
    assert states(outcome, "slave_control")[-1] == "ACTIVE"
    found = verdict.judge(system, outcome)
    assert found.word is Word.FAILED
    assert "slave_control was stopped at t = 0.50" in found.text()
    assert "drive 12 on bus right told fault" in found.text()


def test_a_drive_that_says_nothing_at_the_end_has_not_passed(tmp_path):
    """It boots 25 ms before the end, too late for its node to miss it."""
    table = {"bus": "left", "drive": 12, "does": "reboot", "at": 2.375}
    system, _, outcome = simulated("can-cia402", tmp_path, table)
    assert states(outcome, "master_control")[-1] == "ACTIVE"
    found = verdict.judge(system, outcome)
    assert found.word is Word.FAILED
    assert "drive 12 on bus left may have been off at the end: nothing came" in found.text()


def test_an_encoder_that_was_not_read_for_a_while_has_not_jumped(tmp_path):
    """The drive boots during the bring-up, its arm is moved, and then it tells where it is."""
    table = {"bus": "left", "drive": 11, "does": "reboot", "at": 1.2}
    _, _, outcome = simulated("can-cia402", tmp_path, table)
    reasons = np.bitwise_or.reduce(outcome.rows[Life("master_control")]["reasons"])
    assert not reasons & Why.JUMP
    assert states(outcome, "master_control")[-1] == "ACTIVE"


@pytest.mark.parametrize(("deployment", "drive"), [("can-damiao", 1), ("can-cia402", 11)])
def test_old_positions_stop_the_node(deployment, drive, tmp_path):
    table = {"bus": "left", "drive": drive, "does": "old", "at": 0.3}
    system, _, outcome = simulated(deployment, tmp_path, table, commands=(), stop=1.5)
    rows = outcome.rows[Life("master_control")]
    assert rows["reasons"][-1] & Why.DRIVE
    stopped = rows["deadline_ns"][np.flatnonzero(rows["reasons"])[0]] * 1e-9
    assert stopped < 0.6
    text = verdict.judge(system, outcome).text()
    assert f"drive {drive} on bus left sends old positions" in text
    assert outcome.replayed.first is None


@pytest.mark.parametrize("deployment", ["can-damiao", "can-cia402", "openarm", "six_axis"])
def test_positions_of_drives_at_work_are_not_old(deployment, tmp_path):
    system, _, outcome = simulated(deployment, tmp_path, commands=(), stop=2.0)
    assert verdict.judge(system, outcome).word is Word.PASSED


def test_a_fault_that_no_node_notices_is_named(tmp_path):
    """A Damiao drive answers commands only: 1 ms before the end it cannot tell its error."""
    table = {"bus": "left", "drive": 1, "does": "trip", "code": 8, "at": 0.499}
    system, _, outcome = simulated("can-damiao", tmp_path, table, commands=(), stop=0.5)
    found = verdict.judge(system, outcome)
    assert found.word is Word.FAILED
    assert "not in the report: drive on drive 1 on bus left (trip)" in found.text()


# ---- our own protocol ----


@pytest.mark.parametrize("does", ["trip", "reboot", "hot"])
def test_a_drive_of_our_own_that_is_off_gets_no_torque(does, tmp_path):
    table = {"bus": "left", "drive": 1, "does": does, "at": 0.6}
    system, script, outcome = simulated("can", tmp_path, table)
    rows = outcome.rows[Life("master")]
    off = int(np.flatnonzero(rows["reasons"] & Why.DRIVE)[0])
    assert rows["deadline_ns"][off] * 1e-9 == pytest.approx(0.601)
    assert rows["state"][off] == LifeState.FAULT  # no ramp of a torque that is not there
    judged = {one.name: one for one in judge_drives(system, script, tmp_path / "nodes", cold=True)}
    mine = judged["drive 1 on bus left"]
    assert mine.forbidden == () and mine.unheard <= 2 and mine.torques > 50
    assert outcome.replayed.first is None
    assert (
        "injected and noticed: drive on drive 1 on bus left"
        in verdict.judge(system, outcome).text()
    )
    assert (states(outcome, "master")[-1] == "ACTIVE") == (does != "hot")  # until it cools


def test_a_stop_leaves_a_drive_of_our_own_that_can_be_started_again(tmp_path):
    _, _, outcome = simulated("can", tmp_path)
    for arm in ("master", "slave"):
        assert states(outcome, arm) == ["INACTIVE", "ACTIVE", "STOPPING", "INACTIVE", "ACTIVE"]


# ---- the judge ----

MS = 1_000_000
OFF, ON = (bytes([state << 4 | 1, 1, 2, 3, 4, 5, 6, 7]) for state in (0xA, 1))
TORQUE, ZERO = bytes([127, 255, 127, 240, 0, 0, 12, 0]), bytes([127, 255, 127, 240, 0, 0, 8, 0])


def log_of(path, *frames):
    """A log of (ms, identifier, data, sent)."""
    with Journal.create(path, frame_dtype(64), 64) as journal:
        for ms, identifier, data, sent in frames:
            row = np.zeros((), frame_dtype(64))
            row["t_ns"], row["id"], row["length"] = round(ms * MS), identifier, len(data)
            row["flags"] = Flags.SENT if sent else 0
            row["data"][: len(data)] = list(data)
            journal.append(*row.item())
    return Journal.open(path)


def judged(log, faults=(), cold=False):
    reading = drive_judge.READINGS["damiao"]
    return drive_judge._judged(1, 0.05, reading, log, faults, cold)


def test_the_judge_counts_torques_to_a_drive_that_has_told_that_it_is_off(tmp_path):
    frames = [(1, 1, TORQUE, True), (2, 0x11, ON, False), (3, 1, TORQUE, True)]
    frames += [(4, 0x11, OFF, False), (5, 1, TORQUE, True), (6, 1, ZERO, True)]
    torques, forbidden, unheard, off = judged(log_of(tmp_path / "a", *frames))
    assert (torques, forbidden, unheard) == (3, (pytest.approx(0.005),), 0)
    assert off == ((0.004, pytest.approx(0.006)),)


def test_the_judge_excepts_what_was_sent_before_a_drive_could_tell(tmp_path):
    fault = build(
        {"fault": [{"kind": "drive", "bus": "b", "drive": 1, "does": "trip", "at": "2 ms"}]},
        Path("x"),
    ).drives
    frames = [(1, 0x11, ON, False), (2.5, 1, TORQUE, True), (3, 0x11, OFF, False)]
    _, forbidden, unheard, _ = judged(log_of(tmp_path / "a", *frames), fault)
    assert (forbidden, unheard) == ((), 1)


def test_the_judge_does_not_wait_for_a_silent_drive_for_ever(tmp_path):
    frames = [(1, 0x11, ON, False), (100, 1, TORQUE, True), (102, 1, TORQUE, True)]
    assert judged(log_of(tmp_path / "a", *frames))[1] == (pytest.approx(0.102),)


def test_the_judge_trusts_no_drive_before_it_has_told_its_state(tmp_path):
    frames = [(1, 1, TORQUE, True), (2, 0x11, ON, False), (3, 1, TORQUE, True)]
    assert judged(log_of(tmp_path / "a", *frames), cold=True)[1] == (pytest.approx(0.001),)


def test_an_unplugged_drive_is_off_when_its_watchdog_has_run_out():
    at = [
        (VendorFault.UNPLUG, 0.1), (VendorFault.PLUG, 0.12), (VendorFault.UNPLUG, 0.2),
    ]  # fmt: skip
    faults = [drive_judge.DriveFault(0, t, "b", 1, fault, 1) for fault, t in at]
    assert list(drive_judge._struck(faults, 50 * MS)) == [250 * MS]


# ---- the command ----


def test_the_command_names_its_seeds_and_makes_no_run_twice(tmp_path, capsys):
    words = ["--runs", "2", "--first", "3", "--out", str(tmp_path / "runs.jsonl")]
    assert campaign.main(words) == 0
    said = capsys.readouterr().out
    assert "seeds            3 to 4" in said and "2 of 2" in said
    before = (tmp_path / "runs.jsonl").read_bytes()
    assert campaign.main(words) == 0
    assert (tmp_path / "runs.jsonl").read_bytes() == before and before.count(b"\n") == 2


# ---- on the wall clock ----


@pytest.mark.parametrize("seed", [4, 9, 13, 24])
def test_a_fault_before_the_run_is_as_it_has_to_be(seed, tmp_path):
    """In each phase, of two vendors; two start, or stop later, and two are refused by name."""
    row = waits.run(seed, tmp_path)
    assert row.problems == [] and row.early == row.forbidden == 0
    if seed in (9, 24):
        assert row.end == "refused" and row.text


def test_the_judge_of_what_waits_names_misdeeds():
    row = waits.Waited(
        1, "can-damiao", "drive 1 on bus left", "trip", 8, 0.0, None, "rise", "started", True, 2,
        3, "drive 2", [],
    )  # fmt: skip
    said = list(waits._problems(row, 1, ["drive 2"]))
    assert len(said) == 4 and "torques before t = 0" in said[0]
    refused = replace(row, end="refused", early=0, forbidden=0)
    assert list(waits._problems(refused, 1, [])) == ["the node does not name the drive: drive 2"]
    assert list(waits._problems(refused, 2, [])) == []
