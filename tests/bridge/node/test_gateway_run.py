"""Two islands as processes, gateways and Zenoh between them, in a network namespace."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys

import numpy as np
import pytest

from bridge.native.safety import LifeState, Why
from tests.bridge.rehearsing import (
    NAMESPACE,
    NODES,
    ROOT,
    Left,
    command,
    environment,
    possible,
    run,
    script,
)

pytestmark = pytest.mark.slow

DEPLOY = ("--deploy", "gateway", "--no-latency")
RESTART = """
[[fault]]
kind = "restart"
node = "right_gateway"
at = "3 s"
for = "0.3 s"
"""
#: Six processes beside other work stand still more often: only what the test does stops a node.
CALMER = (
    *(f'deploy.nodes.{node}.overrun="5 s"' for node in NODES),
    *(f'deploy.nodes.{node}.drive.watchdog="5 s"' for node in NODES[:2]),
    *(f'deploy.nodes.{node}.within="5 s"' for node in NODES[2:]),
    *(f'deploy.nodes.{node}.guard={{tau_max="100 N.m"}}' for node in NODES[2:]),
    *(
        f'deploy.nodes.{node}.stale={{"{node}.q"={{stop="5 s"}},"{node}.xi_in"={{age="age[0]"}}}}'
        for node in NODES[2:]
    ),
)
#: Emergency stop on the left bus, once the run has begun; then the run is ended.
ESTOP = """
{run} & run=$!
until [ -f {started} ]; do sleep 0.1; done
sleep 1.5
{estop} -i udp_multicast -c 239.74.163.2 --seconds 0.3
sleep 0.5
kill $run
wait $run
"""


def held(left, node):
    """Sample of xi that a controller held, in each of its slots."""
    return left.rows[node]["inlets"]["held"][:, -1]


def longest(numbers):
    """The most slots in a row with one number."""
    ends = np.flatnonzero(np.diff(numbers, append=-2))
    return int(np.diff(ends, prepend=-1).max())


def test_a_gateway_dies_and_comes_back(tmp_path):
    folder = tmp_path / "run"
    done = run(folder, *DEPLOY, *script(tmp_path, RESTART), stop=12.0, settings=CALMER)
    assert "difference exactly 0" in done.stdout, done.stdout + done.stderr
    left = Left(folder)
    assert left.exact()
    for node in NODES:  # nobody was stopped by it
        assert left.state(node) == LifeState.ACTIVE and left.end(node) == "finished", node
    for node in ("master_control", "slave_control"):
        numbers = held(left, node)
        assert longest(numbers) > 60  # 0.3 s, and what it takes to start a process
        assert numbers[-1] > len(numbers) - 20 and (np.diff(numbers) >= 0).all()
        assert np.abs(left.column(node, f"{node}.tau")).max() <= 100.0
    apart = np.abs(left.column("master", "master.q") - left.column("slave", "slave.q")).max(axis=1)
    back = int(left.rows["right_gateway@2"]["slot"][0])  # all slots are of 5 ms here
    # a quarter nearer, and not more: where the process starts late, little time is left
    assert apart[-1] < max(0.3, 0.75 * apart[back]), (back, apart[back], apart[-1])  # rad
    forwarded = left.nodes["right_gateway@2"]["said"]["forwards"]
    assert set(forwarded) == {"XI_2", "xi_slave"}
    assert all(f["sent"] > 500 and not f["failed"] for f in forwarded.values())
    assert "right_gateway@2: xi_slave: " in done.stdout


def test_an_emergency_stop_on_one_island_stops_the_other(tmp_path):
    possible()
    folder = tmp_path / "run"
    words = command(folder, *DEPLOY, stop=60.0, settings=CALMER)[len(NAMESPACE) :]
    text = ESTOP.format(
        run=shlex.join(words),
        started=folder / "rehearsal.json",
        estop=shlex.join([sys.executable, "-m", "bridge.can.estop"]),
    )
    done = subprocess.run(
        [*NAMESPACE, "sh", "-c", text],
        capture_output=True, text=True, cwd=ROOT, env=environment(), timeout=120,
    )  # fmt: skip
    assert (folder / "run.json").is_file(), done.stdout + done.stderr
    left = Left(folder)
    for node in (*NODES, "left_gateway", "right_gateway"):
        assert left.why(node) & Why.ESTOP, node
    for node in ("master_control", "slave_control"):
        assert not left.rows[node]["sent"][-1][:2].any()  # no torque any more
    assert left.exact()
    t = json.loads((folder / "run.json").read_text())["rehearsal"]["nodes"]
    assert t["slave_control"]["state"] != "active"
