"""Commands that are killed (SIGKILL) at any moment are resumed to the same bytes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from random import Random

import pytest

from cosim.record.folder import FINISHED, read_metadata
from tests.bridge.zenoh.rehearsed import CONFIGS
from tests.cosim.checkpoint.cuts import contents

ROOT = CONFIGS.parent
USUAL = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
#: A scenario with requirements, and options by which a run of it takes some seconds.
RUNS = {
    "two arms": ("teleoperation.toml", "run.stop=300"),
    "threads": ("many.toml", "run.stop=60", "graphs.net.n=64"),
    "mujoco": ("mujoco/teleoperation.toml", "run.stop=20"),
}


def killed(folder: Path, stage: str, first: int, each: int) -> dict[str, list[int] | int]:
    """The answer of :mod:`tests.cosim.checkpoint.killing`."""
    text = (CONFIGS / "teleoperation.toml").read_text(encoding="utf-8")
    (folder / "arms.toml").write_text(text.replace('stop = "60 s"', 'stop = "0.45 s"'))
    call = [sys.executable, "-m", "tests.cosim.checkpoint.killing"]
    given = [str(folder), "arms.toml", stage, str(first), str(each)]
    done = subprocess.run([*call, *given], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found: dict[str, list[int] | int] = json.loads(done.stdout.splitlines()[-1])
    return found


def test_kills_at_some_changes_of_files(tmp_path: Path) -> None:
    found = killed(tmp_path, "resume", 5, 17)
    assert found["kills"] > 1 and not found["wrong"]


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("stage", ["run", "resume"])
def test_kills_at_all_changes_of_files(tmp_path: Path, stage: str) -> None:
    """Also within a checkpoint, and between the end of the run and its verdict."""
    found = killed(tmp_path, stage, 1, 1)
    assert found["kills"] > 40 and not found["wrong"]


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("interval", ["0s", "0.05", "t=0.5s"])
@pytest.mark.parametrize("name", RUNS)
def test_kills_at_random_times(tmp_path: Path, name: str, interval: str) -> None:
    """The process that computes is killed again and again until it is finished."""
    if name == "mujoco":
        pytest.importorskip("mujoco")
    file, *settings = RUNS[name]
    random = Random(f"{name} {interval}")
    arguments = [sys.executable, "-m", "cosim", "run"]
    given = [CONFIGS / file, "--no-plot", *(x for s in settings for x in ("--set", s))]
    given += ["--threads", "2"] if name == "threads" else []
    subprocess.run([*arguments, *given, "--out", "whole"], check=True, cwd=tmp_path, **USUAL)
    kept, kills = [*given, "--out", "kept", "--force", "--checkpoint", interval], 0
    for attempt in range(60):
        process = subprocess.Popen([*arguments, *kept], cwd=tmp_path, **USUAL)
        time.sleep(random.uniform(0.3, 1.0 + 0.3 * attempt))  # a slow machine also ends
        if process.poll() is None:
            kills += 1
            process.send_signal(signal.SIGKILL)
        process.wait()
        place = tmp_path / "kept"
        finished = read_metadata(place).get("status") == FINISHED
        if (place / ".checkpoints").exists() and any(
            (place / ".checkpoints" / x).exists() for x in ("latest", "previous")
        ):
            kept = ["--resume", "kept", "--no-plot"]
        elif finished:
            break
    assert kills > 0
    one, other = contents(tmp_path / "whole"), contents(tmp_path / "kept")
    facts = [json.loads(x.pop("run.json")) for x in (one, other)]
    for x in facts:
        del x["command"]
    assert one == other and facts[0] == facts[1]
    assert os.listdir(tmp_path / "kept").count(".checkpoints") == 0
