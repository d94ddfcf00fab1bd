"""Nodes in lock-step run ahead by the delays of their links, and remain the twin to the bit."""

from __future__ import annotations

from pathlib import Path
from random import Random

import numpy as np
import pytest

from bridge.native import lockstep as native
from bridge.native.frame import Ring
from bridge.native.message import Header
from bridge.native.node import FINISHED, STOPPED
from bridge.native.safety import LifeState, Status
from bridge.replay import replay
from tests.bridge.deployments import run_twin
from tests.bridge.node.apart import ARMS, drawn_link, one, run_apart, system_with


@pytest.mark.parametrize("seed", range(8))
def test_any_links_over_any_network_are_the_twin(seed: int, tmp_path: Path):
    random = Random(seed)
    phase = random.choice(["0 ms", "0.3 ms", "2 ms"])
    changes = [*drawn_link(0, random), *drawn_link(1, random)]
    system = system_with(*changes, f'deploy.nodes.slave.phase="{phase}"')
    expected = run_twin(system, tmp_path / "twin")
    heard = []
    for slowest in (0.0, 0.004):
        folder = tmp_path / f"{slowest}"
        assert run_apart(system, folder, seed, slowest) == dict.fromkeys(ARMS, ""), changes
        rows = replay.load(folder)
        for life in ARMS:
            assert rows[life].tobytes() == expected[life].tobytes(), (life, changes)
        heard.append(replay.received_by_life(folder))
    twin = replay.received_by_life(tmp_path / "twin")
    for life in ARMS:
        assert heard[0][life].tobytes() == heard[1][life].tobytes(), (life, changes)
        assert np.sort(heard[0][life]).tobytes() == np.sort(twin[life]).tobytes(), (life, changes)


@pytest.mark.parametrize(("ahead", "slots"), [("true", 298), ("false", 1)])
def test_a_node_alone_runs_ahead_by_the_least_delay(ahead: str, slots: int, tmp_path: Path):
    changes = [f'links.{i}.delay={{law="constant", delay="0.3 s"}}' for i in (0, 1)]
    system = system_with(*changes, f"deploy.buses.net.options.lookahead={ahead}", wait="50 ms")
    incoming, sent = Ring(8), Ring(4096)
    with one(system, "master", (incoming, sent), tmp_path) as node:
        result = node.run()
        assert result == native.STALLED
        assert node.wired.struct.slot == slots
        assert f"slot {slots} " in node.error(result) and "sample 0 of xi_slave" in node.error(
            result
        )
        assert len(sent) == -(-slots // 5)


@pytest.mark.parametrize("ahead", ["true", "false"])
def test_a_refused_sample_ends_a_run_that_was_ahead_of_it(ahead: str, tmp_path: Path):
    system = system_with(f"deploy.buses.net.options.lookahead={ahead}")
    carried, incoming = system.messages["xi_slave"], Ring(256)
    for k in range(120):
        header = Header(counter=k, status=LifeState.ACTIVE | Status.SIMULATED, t_us=5000 * k)
        value = 31.0 if k == 3 else 0.0  # rad/s; the range ends at 30
        incoming.put(carried.encoding.frame([value, 0.0], header))
    with one(system, "master", (incoming, Ring(4096)), tmp_path) as node:
        result = node.run()
        if ahead == "false":
            assert result == FINISHED and node.wired.receivers["xi_slave"].range == 1
            return
        assert result == native.REFUSED
        assert "sample 3 of xi_slave from node slave" in node.error(result)
        assert "options.lookahead = false" in node.error(result)


def test_an_emergency_stop_ends_a_node_that_does_not_wait(tmp_path: Path):
    system, incoming = system_with(), Ring(8)
    incoming.put(system.services["net"].estop.frame([1, 0], Header()))
    with one(system, "master", (incoming, Ring(4096)), tmp_path) as node:
        assert node.run() == STOPPED
        assert node.wired.struct.slot == 0
