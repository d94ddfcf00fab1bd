"""``cosim doctor --deploy`` next to strict drives: each step finds what it is for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.strict_drives.cases import CASES, Case, Ended, doctor, relaxed

pytestmark = pytest.mark.slow
WATCHDOG = 400  # ms


def checked(name: str, folder: Path, *faults: str, **changes: object) -> Ended:
    case: Case = relaxed(CASES[name], folder, WATCHDOG)
    return doctor(replace(case, **changes), folder / "out", faults)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["damiao", "cia402", "odrive"])
def test_drives_that_are_well_pass_every_step(name: str, tmp_path: Path) -> None:
    ended = checked(name, tmp_path)
    assert ended.code == 0 and "✗" not in ended.said, ended.said
    assert "emergency stop: not proven" in ended.said
    assert "deploy.nodes.master_control.guard.tau_max=" in ended.said
    for drive in ended.drives:
        end = drive.end
        assert end["trips"] == 1 and end["enabled"] == 2 and not end["off"], (drive.name, end)
        assert f"drive {end['drive']} on bus" in ended.said


FAULTS = {
    "1:wrong@0": "drive 1 on bus left: direction of master_control.tau[0]: turned by -",
    "2:refuse@0": "drive 2 on bus left: watchdog: enable: it tells DISABLED, expected enabled",
    "1:unplug@0": "drive 1 on bus left: ",
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_drive_that_is_not_well_is_named_with_its_step(fault: str, tmp_path: Path) -> None:
    ended = checked("damiao", tmp_path, fault)
    assert ended.code == 1, ended.said
    assert any(x.startswith(f"✗ {FAULTS[fault]}") for x in ended.said.splitlines()), ended.said
    assert "next: a first run" not in ended.said


def test_a_watchdog_that_is_off_is_found(tmp_path: Path) -> None:
    """A tool has left it at 0 in an ODrive, where no frame of the profile sets it."""
    words = tuple("0" if w == str(WATCHDOG) else w for w in relaxed(
        CASES["odrive"], tmp_path, WATCHDOG).words)  # fmt: skip
    ended = checked("odrive", tmp_path, words=words)
    assert ended.code == 1
    assert "still CLOSED_LOOP_CONTROL after 1200 ms without a frame" in ended.said, ended.said


def test_a_bus_without_drives_names_each(tmp_path: Path) -> None:
    ended = checked("damiao", tmp_path, drives=((5,), (5,)))
    assert ended.code == 1 and ended.said.count("does not answer") == 4, ended.said
