"""``cosim doctor --deploy`` next to strict drives: each step finds what it is for."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.base.copies import replace
from tests.strict_drives.cases import CASES, Case, Ended, doctor, relaxed

pytestmark = pytest.mark.slow
WATCHDOG = 400  # ms


def checked(name: str, folder: Path, *faults: str, **changes: object) -> Ended:
    case: Case = relaxed(CASES[name], folder, WATCHDOG)
    return doctor(replace(case, **changes), folder / "out", faults)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["damiao", "cia402"])
def test_drives_that_are_well_pass_every_step(name: str, tmp_path: Path) -> None:
    ended = checked(name, tmp_path)
    assert ended.code == 3 and "✗" not in ended.said, ended.said  # nothing is wrong, but
    assert "emergency stop: not checked: nobody was asked" in ended.said
    assert "bus left: not checked: udp_multicast" in ended.said
    assert "deploy.nodes.master_control.guard.tau_max=" in ended.said
    for drive in ended.drives:
        end = drive.end
        assert end["trips"] >= 1 and end["enabled"] >= 2 and not end["off"], (drive.name, end)
        assert f"drive {end['drive']} on bus" in ended.said


def test_the_emergency_stop_is_proven_with_a_person_at_the_arm(tmp_path: Path) -> None:
    """The power is cut half a second after the drives are enabled for the third time."""
    case: Case = relaxed(CASES["damiao"], tmp_path, WATCHDOG)
    ended = doctor(case, tmp_path / "out", ["unplug@0.5#3"], answers="y\n" * 9)
    assert "✓ emergency stop: all 4 drives are off" in ended.said, ended.said
    assert "not checked: nobody" not in ended.said and "✗" not in ended.said
    assert all(drive.end["enabled"] >= 3 for drive in ended.drives)


def test_a_drive_that_is_not_well_is_named_with_its_step(tmp_path: Path) -> None:
    ended = checked("damiao", tmp_path, "1:wrong@0", "2:refuse@0")
    assert ended.code == 1, ended.said
    lines = [line for line in ended.said.splitlines() if line.startswith("✗")]
    assert lines[0].startswith("✗ drive 1 on bus left: direction of master_control.tau[0]: turned")
    said = "watchdog: did not follow: expected enabled, it tells DISABLED"
    assert lines[1:] == [f"✗ drive 2 on bus left: {said}"], lines
    assert "emergency stop: not checked" in ended.said and "next: a first run" not in ended.said
