"""Rehearsals as a fixture: apart from each other, and the twin's to the bit."""

from __future__ import annotations

from pathlib import Path

import pytest

from bridge.deployment import spec
from bridge.testing.rehearsals import _apart
from cosim.base.errors import ScenarioError

CONFIGS = Path(__file__).resolve().parents[3] / "configs"
SCENARIO = CONFIGS / "teleoperation.toml"
FREEZE = """\
title = "The controller stands still"
[[fault]]
kind = "freeze"
node = "slave_control"
at = "1 s"
for = "0.5 s"
"""


@pytest.mark.parametrize("deploy", ["can", pytest.param("zenoh", marks=pytest.mark.slow)])
def test_processes_on_a_clock_that_waits_are_the_twin_to_the_bit(rehearsal, twin, deploy) -> None:
    changes = {"run.stop": "0.2 s"}
    run = rehearsal(SCENARIO, deploy, set=changes)
    assert run.has_no_faults()
    assert run.is_identical_to(twin(SCENARIO, deploy, set=changes))
    assert run.metadata["command"].startswith("cosim rehearse ")
    assert "Nodes" in run.report().read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_fault_on_the_wall_clock_is_a_fault(rehearsal, tmp_path: Path) -> None:
    (tmp_path / "freeze.toml").write_text(FREEZE)
    run = rehearsal(SCENARIO, "can", set={"run.stop": "3 s"}, faults=tmp_path / "freeze.toml")
    answer = run.has_no_faults()
    assert not answer and "slave_control" in answer.text


def test_faults_need_the_clock_on_which_they_happen(rehearsal) -> None:
    with pytest.raises(ScenarioError, match="found faults with the clock simulated; expected wall"):
        rehearsal(SCENARIO, "can", clock="simulated", faults="freeze.toml")


def test_no_two_tests_listen_on_one_port_or_use_a_real_bus() -> None:
    changes = [[*_apart(spec.load(CONFIGS / "deploy" / "zenoh.toml"))] for _ in range(2)]
    assert all(len(found) == 2 and "tcp/127.0.0.1:" in found[0] for found in changes)
    assert len({change for found in changes for change in found}) == 4
    real = spec.load(CONFIGS / "deploy" / "can.toml", ['buses.left.interface="socketcan"'])
    assert 'deploy.buses.left.interface="cosim"' in [*_apart(real)]
