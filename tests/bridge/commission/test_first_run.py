"""The first run with 5 % of the torque: the command that the doctor prints, with strict drives."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from cosim.record import Run
from tests.strict_drives.cases import CASES, CONFIGS, COSIM, beside, doctor, relaxed, run

pytestmark = pytest.mark.slow


def test_the_command_of_the_first_run_works_and_says_each_state(tmp_path: Path) -> None:
    case = relaxed(CASES["damiao"], tmp_path, 400)
    said = doctor(case, tmp_path / "doctor").said
    words = shlex.split(said.split("another terminal:\n")[1].strip().splitlines()[0])
    assert words[:2] == ["cosim", "rehearse"]
    scenario = str(CONFIGS / "teleoperation.toml")
    command = [*COSIM, *(scenario if w == "SCENARIO" else w for w in words[1:])]
    command += ["-i", "udp_multicast", "--yes", "--no-plot", "--no-twin", "--set", 'run.stop="2 s"']
    command += ["--out", str(tmp_path / "run"), *(w for s in case.settings for w in ("--set", s))]
    ended = beside(case, tmp_path / "first", command)
    order = [
        "ready: master_control, slave_control",
        "drives are cleared and enabled, and get torque 0",
        "master_control: all drives are enabled",
        "torques act in 0.5 s",
        "no torque any more, drives were disabled: master_control",
    ]
    places = [ended.said.find(text) for text in order]
    assert -1 not in places[:4] and sorted(places[:4]) == places[:4] and places[3] < places[4]
    assert ended.code in (0, 3), ended.said  # 3: this machine was too slow to judge
    assert "windup" not in ended.said  # the controllers know the limit, too
    for drive in ended.drives:
        assert drive.end["torques"] and not drive.end["off"], drive.end
    assert re.findall(r"guard.tau_max=\[([\d., ]+)\]", said) == ["0.35, 0.35"] * 2  # of 7 N.m
    tau = Run.open(tmp_path / "run").array("master_control.tau")
    assert 0.01 < np.abs(tau).max() <= 0.35


def test_a_drive_that_stops_its_node_is_said_at_once(tmp_path: Path) -> None:
    case = relaxed(CASES["damiao"], tmp_path, 400)
    ended = run(case, tmp_path / "out", faults=["1:trip=0xA@1"], stop=2.0)
    said = "master_control stops: drive 1 on bus left tells OVER_CURRENT (lower tau_max)"
    assert -1 < ended.said.find("torques act in 0.5 s") < ended.said.find(said), ended.said
    assert ended.said.find(said) < ended.said.find("no torque any more")
    assert ended.code in (1, 3), ended.said  # 3: this machine was too slow to judge
