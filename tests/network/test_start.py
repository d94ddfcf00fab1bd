"""`cosim node` on two hosts, started by `cosim tell` on one of them: whose t = 0 is when?"""

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from bridge.deployment.system import load_system
from bridge.records.node_lives import ByLife, Life
from bridge.relay.network import RelayNetwork
from bridge.replay import replay
from tests.network.hosts import ARMS, Case, Site, settings

SCENARIO = Path(__file__).parents[2] / "configs" / "teleoperation.toml"
CALL = [sys.executable, "-c", "from cosim.cli import main; main()"]
LATE = 0.2  # s, one way
STOP = 5.0  # s
pytestmark = pytest.mark.slow


def command(network: RelayNetwork, host: str, what: str, *words: str) -> subprocess.Popen[str]:
    call = [*CALL, what, str(SCENARIO), *words]
    with network.on_host(host):
        return subprocess.Popen(call, stdout=subprocess.PIPE, text=True)


def ready(node: subprocess.Popen[str]) -> None:
    assert node.stdout is not None
    assert any("ready, waiting for NMT start" in line for line in iter(node.stdout.readline, ""))


def started(network: RelayNetwork, changes: Sequence[str], folder: Path) -> None:
    """Both nodes to their end; the master's host tells them to start."""
    said = ["--deploy", "zenoh", *(word for change in changes for word in ("--set", change))]
    nodes = [
        command(network, arm, "node", *said, "--node", arm, "--out", str(folder / arm))
        for arm in ARMS
    ]
    for node in nodes:
        ready(node)
    teller = command(network, "master", "tell", *said[:2], "start", *said[2:])
    for process in (*nodes, teller):
        said, _ = process.communicate(timeout=60.0)
        assert process.returncode == 0, said


@pytest.mark.live
def test_a_start_that_travels_gives_all_one_time_origin(tmp_path: Path):
    """The slave hears of it later; EPOCH says when, to hosts of one clock (`docs/network.md`)."""
    both = {"*": {"delay": {"law": "constant", "delay": f"{LATE} s"}}}
    with RelayNetwork(ARMS, tmp_path / "packets", both) as network:
        changes = [f'run.stop="{STOP} s"', *settings(Case(STOP), Site(network, None))]
        changes += [
            'run.step="5 ms"',
            "deploy.silence=0",
        ]  # a busy machine stands still for seconds
        started(network, changes, tmp_path)
    system = load_system(SCENARIO, "zenoh", changes)
    rows, heard = (
        ByLife({Life(arm): read(tmp_path / arm / "nodes")[arm] for arm in ARMS})
        for read in (replay.load, replay.received_by_life)
    )
    begun = [
        json.loads((tmp_path / a / "nodes" / f"{a}.json").read_text())["start_ns"] for a in ARMS
    ]
    apart = (begun[1] - begun[0]) * 1e-9
    assert apart == pytest.approx(0.0, abs=0.1 * LATE)
    # The quickest one of each way: with a t = 0 each, one would be quicker and one slower by LATE.
    # (A busy machine makes others slower.)
    taken = {}
    for arm in ARMS:
        transit = rows[arm]["inlets"]["transit_ns"]
        taken[arm] = np.min(transit[transit > 0]) * 1e-9
    assert taken["slave"] == pytest.approx(LATE, abs=0.3 * LATE)
    assert taken["master"] == pytest.approx(LATE, abs=0.3 * LATE)
    found = replay.replay(system, rows, heard, tmp_path)
    assert (found.greatest, found.first, found.alone) == (0.0, None, ())
