"""Two arms on two hosts: what the network does, what the controllers make of it, and again."""

from pathlib import Path

import numpy as np
import pytest

from bridge.rehearse import Event
from bridge.relay.network import Network
from tests.bridge.zenoh.rehearsed import Rehearsed
from tests.network.hosts import Hosted, bounded, exact, rehearse_on, settings, settled

ARMS = ("master", "slave")
CONTROLLERS = ("master_control", "slave_control")
PAPER = {"law": "uniform", "low": "300 ms", "high": "1200 ms", "hold": "30 ms"}
BURSTS = {"law": "gilbert-elliott", "p": 0.02, "r": 0.1, "1-h": 0.9, "1-k": 0.001}
pytestmark = pytest.mark.slow


def at_start(link: str, **spec: object):
    """The delay begins with the run: to connect takes the network as it is without."""
    return Event(0.0, f"{link}: {spec}", lambda running: NETWORK[0].set(link, **spec))


NETWORK: list[Network] = []


@pytest.fixture
def network(tmp_path: Path):
    with Network(ARMS, tmp_path / "packets", seed=1) as made:
        NETWORK[:] = [made]
        yield made
        NETWORK.clear()


def run(network: Network, folder: Path, stop: float, events=(), ahead=None, more=()) -> Rehearsed:
    changes = [f'run.stop="{stop} s"', *settings(network, ARMS), *more]
    hosted = Hosted(network, ahead)
    return rehearse_on(hosted, "teleoperation", "zenoh", changes, folder / "run", events)


def counts(found: Rehearsed, node: str) -> dict[str, int]:
    other = "slave" if node == "master" else "master"
    return found.reports[node]["messages"][f"xi_{other}"]


def transit(found: Rehearsed, node: str) -> np.ndarray:
    """Of the newest sample at each slot once there is one, s."""
    rows = found.rows[node]["inlets"]
    there = rows["newest"][:, 0] >= 0
    return rows["transit_ns"][there, 0] * 1e-9


def test_the_papers_delay(network: Network, tmp_path: Path):
    found = run(network, tmp_path, 18.0, [at_start("*", delay=PAPER, ordered=False)])
    exact(found)
    settled(found, ARMS)
    bounded(found, CONTROLLERS)
    for node in ARMS:
        taken = transit(found, node)
        late = taken[len(taken) // 4 :]
        assert late.min() > 0.25 and np.median(late) < 1.2
        assert counts(found, node)["crc"] == 0
        # a sample that was overtaken is never used: what is held only grows
        assert (np.diff(found.rows[node]["inlets"]["held"][:, 0]) >= 0).all()


def test_different_delays_each_way_and_clocks_that_differ(network: Network, tmp_path: Path):
    events = [
        at_start("master>slave", delay={"law": "constant", "delay": "50 ms"}),
        at_start("slave>master", delay={"law": "constant", "delay": "400 ms"}),
    ]
    ahead = {"slave": 80_000_000}  # its t = 0 is 80 ms earlier than the master's
    found = run(network, tmp_path, 18.0, events, ahead)
    exact(found)
    settled(found, ARMS)
    # by time stamps: what is measured contains the offset of the clocks
    assert np.median(transit(found, "slave")[3000:]) == pytest.approx(0.050 + 0.080, abs=0.02)
    assert np.median(transit(found, "master")[3000:]) == pytest.approx(0.400 - 0.080, abs=0.02)
    # by arrivals, which is what controllers see: it does not
    for node in ARMS:
        age = found.signal(f"{node}_control.age")[3000:, 0]
        assert np.median(age) < 0.02


def test_bursts_of_loss(network: Network, tmp_path: Path):
    found = run(network, tmp_path, 12.0, [at_start("*", loss=BURSTS)])
    exact(found)
    settled(found, ARMS)
    packets = network.of("master>slave")
    share = (packets["delay_ns"][1000:] < 0).mean()
    counted = counts(found, "slave")
    assert counted["lost"] / (counted["ok"] + counted["lost"]) == pytest.approx(share, abs=0.1)
    assert counted["lost"] > 50
    del packets


def test_a_partition_heals(network: Network, tmp_path: Path):
    events = [
        Event(4.0, "partition", lambda r: network.set("*", down=True)),
        Event(6.0, "healed", lambda r: network.set("*")),
    ]
    found = run(network, tmp_path, 14.0, events)
    exact(found)
    settled(found, ARMS)
    bounded(found, CONTROLLERS)
    for node in ARMS:
        age = found.signal(f"{node}_control.age")[:, 0]
        assert age[:3900].max() < 0.5
        assert 1.8 < age[5900] < 2.2
        assert age[-3000:].max() < 0.5
        assert counts(found, node)["lost"] >= 300
        assert {int(s) for s in found.rows[node]["state"]} == {2}  # nobody stopped


def test_a_node_is_killed_and_joins_again(network: Network, tmp_path: Path):
    events = [
        Event(3.0, "killed", lambda r: r.kill("slave")),
        Event(3.5, "again", lambda r: r.restart("slave")),
    ]
    found = run(network, tmp_path, 24.0, events)
    exact(found)
    assert set(found.rows) == {"master", "slave", "slave.2"}
    settled(found, ARMS)
    assert found.rows["slave"]["slot"][-1] < 3500 < found.rows["slave.2"]["slot"][0]
    assert found.rows["slave.2"]["inlets"]["newest"][-1, 0] > 3900


def test_a_narrow_link(network: Network, tmp_path: Path):
    found = run(network, tmp_path, 8.0, [at_start("*", rate=1e6)])
    exact(found)
    assert counts(found, "slave")["ok"] > 1500
    assert np.median(transit(found, "slave")) < 0.05
