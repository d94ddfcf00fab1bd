"""Two islands on SocketCAN, xi between them over Zenoh: six processes."""

from __future__ import annotations

import json

import numpy as np

from bridge.native.journal import Journal
from tests.vcan.rehearsals import CALM, SCENARIO, bring_up, cosim, settings

GATEWAYS = ("left_gateway", "right_gateway")
WORDS = ("rehearse", str(SCENARIO), "--deploy", "gateway", "--no-latency", "--no-twin", "--no-plot")
CHANGES = (*CALM, *(f"deploy.nodes.{node}.priority=0" for node in GATEWAYS), 'run.stop="3 s"')


def test_islands_meet_over_their_gateways(tmp_path):
    bring_up()
    folder = tmp_path / "run"
    done = cosim(tmp_path / "lib", *WORDS, "--out", str(folder), *settings(*CHANGES))
    assert done.returncode in (0, 3), done.stdout + done.stderr
    facts = json.loads((folder / "run.json").read_text())["rehearsal"]
    assert facts["finished"] and facts["replay"] == 0.0, done.stdout + done.stderr
    for node in GATEWAYS:
        said = facts["nodes"][node]["said"]
        assert sum(f["sent"] for f in said["forwards"].values()) > 1000, said
        assert not any(f["failed"] for f in said["forwards"].values())
        assert all(counts["crc"] == counts["invalid"] == 0 for counts in said["messages"].values())
    for node in ("master_control", "slave_control"):
        rows = Journal.open(folder / "nodes" / f"{node}.journal")
        held = rows["inlets"]["held"][:, -1]
        assert held[-1] > 500 and (np.diff(held) >= 0).all()
