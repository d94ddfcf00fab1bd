"""A rehearsal whose simulated buses stand still, because the process that serves them does."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

from bridge.rehearsal.supervisor import STARTED
from tests.bridge.deployments import TELEOPERATION
from tests.cli.command import CALL

#: s for which the buses stand still: the watchdogs of this deployment expire after much less.
STILL = 1.5


@pytest.mark.slow
def test_buses_that_stand_still_are_named_and_nothing_is_judged(tmp_path: Path) -> None:
    run, out = tmp_path / "run", tmp_path / "outcome.json"
    words = ("rehearse", TELEOPERATION, "--deploy", "can", "-i", "cosim", "--set", "run.stop=4")
    command = [*CALL, *map(str, (*words, "--out", run, "--json", out))]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while not (run / STARTED).is_file() and process.poll() is None:
        time.sleep(0.01)
    started = json.loads((run / STARTED).read_text(encoding="utf-8"))
    time.sleep(max(0.0, started["start_ns"] * 1e-9 - time.monotonic()) + 1.0)
    os.kill(started["pid"], signal.SIGSTOP)
    time.sleep(STILL)
    os.kill(started["pid"], signal.SIGCONT)
    said, errors = process.communicate(timeout=120)
    assert process.returncode == 3, said + errors
    found = json.loads(out.read_text(encoding="utf-8"))
    assert found["verdict"] == "inconclusive"
    assert "behind the wall clock" in found["reasons"][0]
    facts = json.loads((run / "run.json").read_text(encoding="utf-8"))
    lags = [note for note in facts["rehearsal"]["notes"] if note["kind"] == "lagged"]
    assert {lag["bus"] for lag in lags} == {"left", "right"}
    assert max(lag["late"] for lag in lags) > 0.9 * STILL
    assert [x for x in found["happenings"] if x["who"].startswith("bus ")]
    assert "first causes" in said and " → " in said
    page = (run / "report.html").read_text(encoding="utf-8")
    first, nodes = page.index("What happened first"), page.index("<h2>Nodes</h2>")
    assert first < page.index("part from the twin") < page.index('id="panels"') < nodes
    assert page.count("behind the wall clock") >= 2
