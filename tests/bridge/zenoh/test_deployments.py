"""The deployments over Zenoh: twin, processes, replay."""

from pathlib import Path

import numpy as np
import pytest

from bridge.deployment.system import load_system
from bridge.replay import replay, twin
from bridge.zenoh.certificates import make_keys
from bridge.zenoh.options import ENCRYPTED
from tests.bridge.zenoh.rehearsed import (
    CONFIGS,
    Rehearsed,
    collect,
    prepared,
    sockets,
    together,
)
from tests.bridge.zenoh.test_channel import free_ports

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
    again = replay.replay(
        system, rows, replay.received_by_life(tmp_path / "twin"), tmp_path / "again"
    )
    assert (again.greatest, again.first, again.alone) == (0.0, None, ())


# ---- as processes, all of them side by side ---------------------------------------------------

SECURE = CONFIGS / "zenoh" / "secure.json5"
PROTOCOLS = ("unixsock-stream", "tcp", "udp", "tls", "quic")


def listening(protocol: str, folder: Path) -> list[str]:
    """Settings: two arms over a protocol; with certificates and access by name where it has any."""
    if protocol == "unixsock-stream":
        return sockets(ARMS, folder)
    ports = dict(zip(ARMS, free_ports(2), strict=True))
    said = "deploy.buses.net.options"
    found = [f'{said}.listen.{a}="{protocol}/127.0.0.1:{port}"' for a, port in ports.items()]
    if protocol in ENCRYPTED:
        found += [f'deploy.buses.net.zenoh="{SECURE}"', f'{said}.keys="{folder / "keys"}"']
    return found


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Rehearsed]:
    """Two arms by protocol, and six robots."""
    folder = tmp_path_factory.mktemp("rehearsed")
    make_keys(folder / "keys", ARMS)
    stop = 'run.stop="3 s"'
    waiting = {
        p: prepared("teleoperation", "zenoh", [stop, *listening(p, folder)], folder / p)
        for p in PROTOCOLS
    }
    six = [stop, *sockets(ROBOTS, folder)]
    waiting["six"] = prepared("network", "network", six, folder / "six")
    ended = together({name: running for name, (_, running) in waiting.items()})
    return {n: collect(system, ended[n], folder / n) for n, (system, _) in waiting.items()}


@pytest.mark.slow
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_two_processes_replay_to_the_bit(protocol: str, found: dict[str, Rehearsed]):
    run = found[protocol]
    assert run.ended.notes == []
    assert (run.replayed.greatest, run.replayed.first) == (0.0, None)
    for node, message in (("master", "xi_slave"), ("slave", "xi_master")):
        assert run.reports[node]["end"] == "finished"
        counts = run.reports[node]["messages"][message]
        assert counts["ok"] >= 500
        assert counts["crc"] == counts["length"] == counts["invalid"] == 0
        assert run.reports[node]["buses"]["net"]["send_failed"] == 0
        assert run.reports[node]["unknown_frames"] == 0


@pytest.mark.slow
def test_six_processes_replay_to_the_bit(found: dict[str, Rehearsed]):
    run = found["six"]
    assert run.ended.notes == []
    assert (run.replayed.greatest, run.replayed.first) == (0.0, None)
    assert set(np.unique(run.signal("control1.w"))) == {0.0, 1.0}  # the graph did switch
