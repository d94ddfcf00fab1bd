"""One rehearsal of each profile with ``--hardware`` on SocketCAN, next to strict drives.

The one processor of the guest stands still at times, so the watchdogs here are longer than those of
shipped profiles, and so are the ages that nodes accept; nodes feed drives at a share of that time.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.base.copies import replace
from tests.strict_drives.cases import CASES, CONTROLLERS, GUEST, relaxed, run, slow
from tests.strict_drives.judged import misdeeds

WATCHDOG = 2000  # ms
#: Two ODrives an arm: six of them are too many for the guest.
ODRIVES = replace(
    CASES["damiao"],
    kind="odrive",
    profile="odrive",
    words=(
        "--timeout",
        "0",
        "--period",
        "20",
        "--beat",
        "20",
        "--inertia",
        "3.3,1",
        "--damping",
        "1",
    ),
    enabled="closed loop",
    feeds=0xE,
    step=32,
)
RUNS = {name: CASES[name] for name in ("damiao", "cia402", "ours")} | {"odrive": ODRIVES}
PATIENT = (
    'deploy.patience="200 s"',
    *slow(*CONTROLLERS, period="20 ms"),
    *(
        f'deploy.nodes.{node}.stale={{"{node}.q"={{stop="5 s"}},"{node}.xi_in"={{age="age[0]"}}}}'
        for node in CONTROLLERS
    ),
)


@pytest.mark.usefixtures("vcan")
@pytest.mark.timeout(GUEST)
@pytest.mark.parametrize("name", RUNS)
def test_strict_drives_on_vcan(name: str, fresh_bus: str, tmp_path: Path) -> None:
    case = relaxed(RUNS[name], tmp_path, WATCHDOG)
    case = replace(case, settings=(*case.settings, *PATIENT), words=(*case.words, "--look", "10"))
    channels = ("vcan0", "vcan1") if name == "ours" else ("vcan0", "vcan1", fresh_bus)
    ended = run(case, tmp_path / "out", channels=channels, stop=1.0)
    assert not [drive.name for drive in ended.drives if drive.end["off"]], ended.said
    assert not [text for drive in ended.drives for text in drive.worked()], ended.said
    if ended.code == 3 and "inconclusive" in ended.said:
        return  # this machine stood still, and said so; it may have starved drives
    assert not misdeeds(ended.drives), ended.said
    assert ended.code == 0, ended.said
