"""``cosim doctor --deploy`` on SocketCAN, next to strict drives."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.strict_drives.cases import CASES, COSIM, beside, relaxed
from tests.vcan.test_strict_drives import WATCHDOG


@pytest.mark.usefixtures("vcan")
@pytest.mark.parametrize("name", ["damiao", "cia402"])
def test_the_steps_to_real_drives_on_vcan(name: str, tmp_path: Path) -> None:
    case = relaxed(CASES[name], tmp_path, WATCHDOG)
    words = ["doctor", "--deploy", case.deploy, "-c", "left=vcan0", "-c", "right=vcan1", "--yes"]
    ended = beside(case, tmp_path / "out", [*COSIM, *words], channels=("vcan0", "vcan1"))
    assert ended.code == 3 and "✗" not in ended.said, ended.said
    assert "bus left: vcan0 is up; not checked: a virtual bus has no bit timing" in ended.said
    for drive in ended.drives:
        assert drive.end["trips"] >= 1 and not drive.end["off"], (drive.name, drive.end)
        for step in ("firmware", "settings"):
            assert (
                f"✓ drive {drive.end['drive']} on bus {drive.name.split()[0]}: {step}" in ended.said
            )
