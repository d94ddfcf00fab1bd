"""Nodes on python-can buses of the interface `cosim` in simulated time are the twin, to the bit."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from bridge.bus_server.several_buses import served_buses
from bridge.can.socket import BusError
from bridge.deployment.spec import load
from bridge.deployment.system import load_system
from bridge.node.run import NodeOptions, run_node
from bridge.node.simulated import is_simulated
from bridge.records.node_lives import Life
from bridge.replay import replay, twin
from cosim.base.errors import ScenarioError
from tests.bridge.deployments import CONFIGS, NETWORK, TELEOPERATION, named, written
from tests.bridge.replay.test_networks import on_one_bus

SHIPPED = sorted(path.stem for path in (CONFIGS / "deploy").glob("can*.toml"))


def on_simulated_buses(deployment):
    """Settings: all buses of a deployment are simulated, and so is its time."""
    changes = ['deploy.clock="simulated"']
    for name in deployment.buses:
        changes.append(f'deploy.buses.{name}.interface="cosim"')
        changes.append(f'deploy.buses.{name}.channel="{name}"')
    return changes


def rehearsed(path, folder, *settings, scenario=TELEOPERATION):
    """All nodes, each in a thread with bus objects of its own, over buses served on this host."""
    changes = [*settings, *on_simulated_buses(load(path))]
    system = load_system(scenario, str(path), changes)
    timings = {name: bus.timing for name, bus in system.deployment.buses.items()}
    with served_buses(timings, simulated=True) as channels:
        at = [f'deploy.buses.{name}.channel="{where}"' for name, where in channels.items()]
        system = load_system(scenario, str(path), [*changes, *at])
        nodes = folder / "nodes"
        nodes.mkdir()
        ready = threading.Barrier(len(system.nodes))

        def run(name):
            def start(control):
                ready.wait(60)
                control.start(1)

            options = NodeOptions(Life(name), nodes, realtime=False)
            return run_node(system, options, lambda event: None, start)

        with ThreadPoolExecutor(len(system.nodes)) as pool:
            reports = list(pool.map(run, system.nodes))
    return system, nodes, reports


def compared(system, nodes, folder):
    """Rows of all nodes of a rehearsal, every byte of which is the twin's."""
    (folder / "twin").mkdir()
    twin.simulate(system, folder / "twin")
    found, expected = replay.load(nodes), replay.load(folder / "twin")
    heard = replay.received_by_life(nodes), replay.received_by_life(folder / "twin")
    assert set(found) == set(expected) and set(heard[0]) == set(heard[1])
    for life, rows in expected.items():
        ages = rows["inlets"]["age_ns"], rows["inlets"]["transit_ns"]
        assert (found[life]["inlets"]["age_ns"] == ages[0]).all()
        assert (found[life]["inlets"]["transit_ns"] == ages[1]).all()
        assert found[life].tobytes() == rows.tobytes()
        assert heard[0][life].tobytes() == heard[1][life].tobytes()
    return found


@pytest.mark.parametrize("name", ["can", "can-classic"])
def test_every_age_is_that_of_the_twin_where_both_arms_ask_for_one_bus(name, tmp_path):
    path = written(on_one_bus(name), tmp_path)
    system, nodes, reports = rehearsed(path, tmp_path, "run.stop=0.1")
    rows = compared(system, nodes, tmp_path)
    assert [r.end.value for r in reports] == ["finished"] * 4
    transits = rows[Life("slave_control")]["inlets"]["transit_ns"]
    assert len(np.unique(transits)) > 10  # frames wait for each other


@pytest.mark.parametrize("name", SHIPPED)
def test_every_age_of_a_shipped_deployment_is_that_of_its_twin(name, tmp_path):
    system, nodes, _ = rehearsed(CONFIGS / f"deploy/{name}.toml", tmp_path, "run.stop=0.03")
    compared(system, nodes, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_also_in_a_longer_run(name, tmp_path):
    system, nodes, _ = rehearsed(CONFIGS / f"deploy/{name}.toml", tmp_path, "run.stop=3")
    compared(system, nodes, tmp_path)


@pytest.mark.slow
def test_six_robots_on_one_bus_are_their_twin(tmp_path):
    path = CONFIGS / "deploy/network-can.toml"
    system, nodes, _ = rehearsed(path, tmp_path, "run.stop=1", scenario=NETWORK)
    compared(system, nodes, tmp_path)


def test_queues_of_the_deployment_are_those_of_both(tmp_path):
    """Frames that the short queues drop are missing in both."""
    path = written(on_one_bus("can-classic", queue_length=1, queue="sorted"), tmp_path)
    system, nodes, reports = rehearsed(path, tmp_path, "run.stop=0.1")
    compared(system, nodes, tmp_path)
    assert reports[0].buses["left"]["send_failed"] > 10


@pytest.mark.parametrize(
    ("name", "settings", "text"),
    [
        ("can", [], "left: found socketcan with the simulated clock, expected CAN with interface"),
        ("zenoh", [], "found zenoh with the simulated clock"),
    ],
)
def test_what_simulated_time_needs_is_said(name, settings, text):
    system = named(name, 'deploy.clock="simulated"', *settings)
    with pytest.raises(ScenarioError, match=text):
        is_simulated(system)
    assert not is_simulated(named(name))


def test_a_bus_that_nobody_serves_is_said(tmp_path):
    system = load_system(
        TELEOPERATION, "can", on_simulated_buses(load(CONFIGS / "deploy/can.toml"))
    )
    options = NodeOptions(Life("master"), tmp_path, realtime=False)
    with pytest.raises(BusError, match="'left', expected NAME@ADDRESS of a simulated bus"):
        run_node(system, options, lambda event: None)
