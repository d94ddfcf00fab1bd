"""``cosim conform`` on SocketCAN: our own node, whose time-outs are those of a slow kernel."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.vcan.rehearsals import SCENARIO

#: Rules about bytes, and some of each kind about behaviour.
RULES = "C-01,C-02,C-03,C-04,C-05,C-07,C-08,C-10,C-15,C-30,C-32,C-40,C-50,C-55,C-59,C-67,C-70"
SLOW = (
    'deploy.patience="200 s"',
    'run.stop="60 s"', 'run.step="5 ms"',
    'deploy.nodes.master_control.phase="1 ms"',
    'deploy.nodes.master_control.overrun="2 s"',
    'deploy.nodes.master_control.within="1 s"',
    'deploy.nodes.master_control.stale."master_control.q".stop="600 ms"',
)  # fmt: skip
BUSES = ("-i", "socketcan", "-c", "left=vcan0", "-c", "right=vcan1")


@pytest.mark.timeout(900)
def test_our_own_node_keeps_the_rules(vcan: tuple[str, str], tmp_path: Path) -> None:
    same = [*BUSES, *(word for change in SLOW for word in ("--set", change))]
    cosim = [sys.executable, "-m", "cosim"]
    node = [*cosim, "node", str(SCENARIO), "--node", "master_control", *same]
    path = tmp_path / "verdicts.json"
    conform = [*cosim, "conform", str(SCENARIO), "--node", "master_control", *same]
    done = subprocess.run(
        [*conform, "--rules", RULES, "--json", str(path), "--", *node],
        cwd=tmp_path, capture_output=True, text=True, timeout=800, check=False,
    )  # fmt: skip
    found = json.loads(path.read_text())["rules"]
    failed = [f"{r['rule']}: {r['came']}" for r in found if r["verdict"] == "failed"]
    assert not failed and done.returncode in (0, 3), done.stdout + done.stderr
    assert sum(r["verdict"] == "passed" for r in found) >= 8, done.stdout
