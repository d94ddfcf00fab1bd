"""``cosim conform`` on SocketCAN: the participant in C, whose time-outs are those of a slow kernel.

It has 50 Hz, for the kit sends every frame and hears it twice on the guest's one processor. A node
of Python takes minutes to start beside it, and a rule may start it again: it is judged on simulated
buses.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from bridge.deployment.system import load_system
from bridge.sdk.folder import write_participant
from tests.vcan.rehearsals import SCENARIO, settings

#: Rules about bytes, and some of each kind about behaviour.
RULES = "C-01,C-02,C-03,C-04,C-07,C-08,C-10,C-15,C-30,C-32,C-55,C-67,C-70"
SLOW = (
    'run.stop="60 s"', 'run.step="20 ms"',
    *(f'components.{c}_control.period="20 ms"' for c in ("master", "slave")),
    *(f'deploy.messages.{m}.period="20 ms"' for m in ("STATE_1", "STATE_3")),
    'deploy.nodes.master_control.phase="1 ms"',
    'deploy.nodes.master_control.overrun="2 s"',
    'deploy.nodes.master_control.within="1 s"',
    'deploy.nodes.master_control.stale."master_control.q".stop="600 ms"',
)  # fmt: skip
BUSES = ("-i", "socketcan", "-c", "left=vcan0", "-c", "right=vcan1")


@pytest.mark.timeout(900)
def test_a_participant_keeps_the_rules(vcan: tuple[str, str], tmp_path: Path) -> None:
    system = load_system(SCENARIO, "can", SLOW)
    write_participant(system, "master_control", "c", tmp_path / "c")
    subprocess.run("cc -std=c99 -w -o participant *.c", shell=True, cwd=tmp_path / "c", check=True)
    path = tmp_path / "verdicts.json"
    done = subprocess.run(
        [sys.executable, "-m", "cosim", "conform", str(SCENARIO), "--node", "master_control",
         *BUSES, *settings(*SLOW), "--rules", RULES, "--json", str(path),
         "--", str(tmp_path / "c" / "participant"), "{left}", "{right}"],
        cwd=tmp_path, capture_output=True, text=True, timeout=800, check=False,
    )  # fmt: skip
    found = json.loads(path.read_text())["rules"]
    failed = [f"{r['rule']}: {r['came']}" for r in found if r["verdict"] == "failed"]
    assert not failed and done.returncode in (0, 3), done.stdout + done.stderr
    assert sum(r["verdict"] == "passed" for r in found) >= 8, done.stdout
