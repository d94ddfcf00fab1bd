"""The deployments over Zenoh: twin, processes, replay."""

from pathlib import Path

import numpy as np
import pytest

from bridge import replay, twin
from bridge.system import load_system
from tests.bridge.zenoh.rehearsed import CONFIGS, rehearse, sockets

ARMS = ("master", "slave")
ROBOTS = tuple(f"robot{i}" for i in range(1, 7))


@pytest.mark.parametrize(
    ("scenario", "deployment", "arms"),
    [
        ("teleoperation", "zenoh", ARMS),
        ("teleoperation", "mixed", ARMS),
        ("network", "network", ROBOTS),
    ],
)
def test_twins_bring_all_arms_to_the_hand_and_replay(
    scenario: str, deployment: str, arms: tuple[str, ...], tmp_path: Path
):
    stop = 20 if scenario == "teleoperation" else 100
    system = load_system(CONFIGS / f"{scenario}.toml", deployment, [f'run.stop="{stop} s"'])
    (tmp_path / "twin").mkdir()
    twin.simulate(system, tmp_path / "twin")
    rows = replay.load(tmp_path / "twin")
    for arm in arms:
        slot = system.nodes[arm].plan.slots()[f"{arm}.q"]
        q = rows[arm]["signals"][-1, slot.start : slot.start + 2]
        assert np.abs(q - [3.5, 3.0]).max() < 0.01
    (tmp_path / "again").mkdir()
    again = replay.replay(system, rows, tmp_path / "again")
    assert (again.greatest, again.first, again.alone) == (0.0, None, ())


@pytest.mark.slow
def test_two_processes_over_zenoh_replay_to_the_bit(tmp_path: Path):
    changes = ['run.stop="3 s"', *sockets(ARMS, tmp_path)]
    found = rehearse("teleoperation", "zenoh", changes, tmp_path / "run")
    assert found.ended.notes == []
    assert (found.replayed.greatest, found.replayed.first) == (0.0, None)
    for node, message in (("master", "xi_slave"), ("slave", "xi_master")):
        counts = found.reports[node]["messages"][message]
        assert counts["ok"] >= 590
        assert counts["crc"] == counts["length"] == counts["invalid"] == 0
        assert found.reports[node]["buses"]["net"]["send_failed"] == 0
        assert found.reports[node]["unknown_frames"] == 0


@pytest.mark.slow
def test_six_processes_over_zenoh_replay_to_the_bit(tmp_path: Path):
    changes = ['run.stop="3 s"', *sockets(ROBOTS, tmp_path)]
    found = rehearse("network", "network", changes, tmp_path / "run")
    assert found.ended.notes == []
    assert (found.replayed.greatest, found.replayed.first) == (0.0, None)
    weights = found.signal("control1.w")
    assert set(np.unique(weights)) == {0.0, 1.0}  # the graph did switch
