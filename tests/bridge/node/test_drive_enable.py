"""Drives of a run with hardware are disabled once more at its end, whatever happens."""

from __future__ import annotations

from pathlib import Path

import can
import pytest

from bridge.deployment.system import System, load_system
from bridge.node.drive_enable import disabled_at_the_end, foreign_drives

ROOT = Path(__file__).parents[3]
CONTROLLERS = ("master_control", "slave_control")
DISABLE = bytes.fromhex("FFFFFFFFFFFFFFFD")


@pytest.fixture(scope="module")
def system() -> System:
    settings = ["run.stop=1"]
    for bus in ("left", "right", "link"):
        settings += [f'deploy.buses.{bus}.interface="virtual"']
        settings += [f'deploy.buses.{bus}.channel="enabling-{bus}"']
    scenario = ROOT / "configs/teleoperation.toml"
    return load_system(scenario, "can-damiao", settings)


def test_drives_of_the_nodes_started_here_and_no_others(system: System) -> None:
    both = foreign_drives(system, CONTROLLERS)
    assert sorted((d.bus, d.node) for d in both) == [
        (b, n) for b in ("left", "right") for n in (1, 2)
    ]
    assert {d.bus for d in foreign_drives(system, CONTROLLERS[:1])} == {"left"}
    assert foreign_drives(system, ("master", "slave")) == ()


def test_they_are_disabled_after_an_error(system: System) -> None:
    with can.Bus(interface="virtual", channel="enabling-left") as left:
        with pytest.raises(ZeroDivisionError), disabled_at_the_end(system, CONTROLLERS):
            raise ZeroDivisionError
        heard = [left.recv(5.0) for _ in range(2)]
    said = sorted((m.arbitration_id, bytes(m.data)) for m in heard if m is not None)
    assert said == [(1, DISABLE), (2, DISABLE)]
