"""A router between two hosts that goes away and comes back; six hosts with switching graphs."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from bridge.rehearse import Event
from bridge.relay.network import Network
from bridge.replay import load
from bridge.system import System
from bridge.twin import simulate
from tests.bridge.zenoh.rehearsed import CONFIGS
from tests.network.hosts import Hosted, exact, rehearse_on, settings, settled

ARMS = ("master", "slave")
ROBOTS = tuple(f"robot{i}" for i in range(1, 7))
LOSS = {"law": "independent", "p": 0.02}
pytestmark = pytest.mark.slow


class RouterProcess:
    """Zenoh's router on the host `router`."""

    def __init__(self, network: Network) -> None:
        self._network = network
        self.endpoint = f"tcp/{network.addresses['router']}:7447"
        self._process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        command = [sys.executable, "-m", "bridge.zenoh.router"]
        command += [str(CONFIGS / "zenoh" / "router.json5"), self.endpoint, "--insecure"]
        with self._network.inside("router"):
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "ready\n"

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


@pytest.fixture
def router(tmp_path: Path) -> Iterator[RouterProcess]:
    with Network((*ARMS, "router"), tmp_path / "packets") as network:
        made = RouterProcess(network)
        made.start()
        yield made
        made.kill()


def test_a_router_goes_away_and_comes_back(router: RouterProcess, tmp_path: Path):
    network = router._network
    changes = [
        'run.stop="16 s"', "deploy.latency=false",
        f'deploy.buses.net.zenoh="{CONFIGS / "zenoh" / "client.json5"}"',
        f'deploy.buses.net.options={{insecure=true, connect="{router.endpoint}"}}',
    ]  # fmt: skip
    events = [
        Event(3.0, "router killed", lambda r: router.kill()),
        Event(4.0, "router again", lambda r: router.start()),
    ]
    hosted, folder = Hosted(network), tmp_path / "run"
    found = rehearse_on(hosted, "teleoperation", "zenoh", changes, folder, events)
    exact(found)
    settled(found, ARMS)
    assert len(network.of("master>slave")) == 0  # all of it went through the router
    for node, other in (("master", "slave"), ("slave", "master")):
        counted = found.reports[node]["messages"][f"xi_{other}"]
        assert counted["lost"] > 150 and counted["ok"] > 1500
        assert found.signal(f"{node}_control.age")[-3000:, 0].max() < 0.5


def without_network(system: System, folder: Path) -> np.ndarray:
    """Where the robots are at the end if messages take no time, (6, 2)."""
    (folder / "twin").mkdir()
    simulate(system, folder / "twin")
    rows = load(folder / "twin")
    slots = {r: system.nodes[r].plan.slots()[f"{r}.q"] for r in ROBOTS}
    ends = [rows[r]["signals"][-1][s.start : s.start + 2] for r, s in slots.items()]
    return np.array(ends)


def test_six_hosts_with_switching_graphs(tmp_path: Path):
    delay = {"law": "uniform", "low": "10 ms", "high": "60 ms", "hold": "30 ms"}
    with Network(ROBOTS, tmp_path / "packets") as network:
        changes = ['run.stop="25 s"', *settings(network, ROBOTS)]
        events = [Event(0.0, "delay", lambda r: network.set("*", delay=delay))]
        hosted, folder = Hosted(network), tmp_path / "run"
        found = rehearse_on(hosted, "network", "network", changes, folder, events)
    exact(found)
    began, q = (np.array([found.signal(f"{r}.q")[k] for r in ROBOTS]) for k in (0, -1))
    assert np.ptp(q, axis=0).max() < 0.2 * np.ptp(began, axis=0).max()  # they come together
    assert np.abs(q - without_network(found.system, tmp_path)).max() < 0.1
    for i, robot in enumerate(ROBOTS):
        neighbour = ROBOTS[i - 1]
        counted = found.reports[robot]["messages"][f"xi{neighbour[-1]}"]
        assert counted["ok"] > 4500


def test_lock_step_over_a_slow_network_that_loses_is_the_twin(tmp_path: Path):
    """TCP only: what is lost is sent again, and nobody minds when it comes."""
    links = {"*": {"delay": {"law": "constant", "delay": "5 ms"}, "loss": LOSS}}
    with Network(ARMS, tmp_path / "packets", links) as network:
        said = "deploy.buses.net.options"
        changes = ['run.stop="1 s"', f"{said}.insecure=true", f"{said}.lockstep=true"]
        for node in ARMS:
            changes.append(f'{said}.listen.{node}="tcp/{network.addresses[node]}:7461"')
        events = [
            Event(1.0, "a stall", lambda r: network.set("*", down=True)),
            Event(1.4, "its end", lambda r: network.set("*", **links["*"])),
        ]
        hosted, folder = Hosted(network), tmp_path / "run"
        found = rehearse_on(hosted, "teleoperation", "zenoh", changes, folder, events)
        assert any("its end" in note for note in found.ended.notes)
        assert (network.of("master>slave")["delay_ns"] < 0).any()
    (tmp_path / "twin").mkdir()
    simulate(found.system, tmp_path / "twin")
    for node, rows in load(tmp_path / "twin").items():
        assert rows.tobytes() == found.rows[node].tobytes()
