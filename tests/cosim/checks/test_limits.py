"""Joints outside of their limits, at the start and later, and links with doubtful numbers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from cosim.checks import Finding
from tests.cli.command import ROOT, Command
from tests.cosim.checks.cases import tripped

URDF = str(ROOT / "configs" / "robots" / "fr3.urdf")
START = [0.0, -0.4, 0.0, -1.9, 0.0, 1.6, 0.0]


def document(robot: dict[str, Any]) -> dict[str, Any]:
    """One FR3, or what `robot` changes of it, under its own weight."""
    arm = {
        "model": "fmus.models.arm",
        "options": {"urdf": URDF, "base": "link0", "tip": "link7"},
        "parameters": {"armature": 0.1},
        "start": {"tau": 0.0, "q": START},
    }
    merged = {key: {**arm.get(key, {}), **robot.get(key, {})} for key in ("parameters", "start")}
    return {
        "run": {"step": "1 ms", "stop": "0.5 s"},
        "components": {"robot": {**arm, **merged}},
    }


def found(rule: str, **robot: Any) -> list[Finding]:
    return tripped(document(robot), rule)


def test_a_start_beyond_the_limits_of_the_urdf_is_named() -> None:
    """Joint 4 of the FR3 reaches from -3.04 to -0.15 rad."""
    assert found("limits") == []
    beyond = [*START[:3], 0.5, *START[4:]]
    (one,) = found("limits", start={"q": beyond})
    assert one.where == "robot.q[3]" and one.severity == "warning" and one.number == 0.5
    assert "outside of its limits -3." in one.reason and "no stop acts" in one.reason


def test_a_stop_is_a_limit_of_its_own() -> None:
    assert found("limits", parameters={"armature": 0.1, "k_s": 100.0}) == []


def test_an_inertia_that_no_link_of_the_arm_can_have_is_named() -> None:
    """As in a file with g.mm2 for kg.m2: 2661 kg.m2 on 1.56 kg have a radius of 41 m."""
    from tests.fmus.chains import fr3

    assert found("body") == []
    inertia = fr3().inertia.copy()
    inertia[5] = [1.56, 0, 0, 0, 2661, 0, 2661, 0, 0, 2661]
    (one,) = found("body", parameters={"armature": 0.1, "inertia": inertia.tolist()})
    assert one.where == "robot" and "link 5 has 1.56 kg, 2661 kg.m2" in one.reason
    assert "gyration of 41.3 m" in one.reason


@pytest.mark.usefixtures("compiled_once")
def test_a_motion_beyond_the_limits_is_said_by_run_and_report(
    cosim: Command, tmp_path: Path
) -> None:
    """The FR3 falls, and its second joint passes 1.78 rad, where the robot ends."""
    scenario = tmp_path / "fall.toml"
    q = ", ".join(map(str, [0.0, 1.6, 0.0, -1.9, 0.0, 1.6, 0.0]))
    scenario.write_text(
        f"""[run]
step = "1 ms"
stop = "0.5 s"
[components.robot]
model = "fmus.models.arm"
options = {{ urdf = {URDF!r}, base = "link0", tip = "link7" }}
parameters = {{ armature = 0.1 }}
start = {{ tau = 0.0, q = [{q}] }}
"""
    )
    done = cosim("run", scenario, "--out", tmp_path / "run")
    assert done.code == 0, done
    (line,) = [x for x in done.err.splitlines() if "robot.q[1] leaves" in x]
    assert line.startswith("warning: ") and "1.78" in line and "no stop acts" in line
    facts = json.loads((tmp_path / "run" / "run.json").read_text())
    assert len(facts["limits"]) == 7
    assert "robot.q[1] leaves its limits" in (tmp_path / "run" / "report.html").read_text()
