"""A loop of two small components, studies of it, and the command."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

from tests.cli.command import CALL

ROOT = Path(__file__).resolve().parents[3]

#: dx/dt = -gain x in steps of 10 ms: x shrinks by 1 - gain/100 a step; above 200 it grows.
SCENARIO = """
title = "a loop"
[run]
step = 0.01
stop = 4
[components.plant]
model = "tests.cosim.blocks:Integrator"
start.x = 1.0
inputs.u = { from = "gain.y", gain = -1.0 }
[components.gain]
model = "tests.cosim.study.blocks:Trap"
inputs.u = "plant.y"
[metrics]
rest = { kind = "error", of = ["plant.y"], target = [0.0], within = 0.1 }
"""

STUDY = """
scenario = "loop.toml"
[vary.gain]
path = "components.gain.parameters.gain"
"""


def written(folder: Path, study: str, scenario: str = SCENARIO) -> Path:
    """The two files in a folder; the path of the study."""
    (folder / "loop.toml").write_text(scenario, encoding="utf-8")
    path = folder / "study.toml"
    path.write_text(study, encoding="utf-8")
    return path


def started(*arguments: str, cwd: Path) -> subprocess.Popen[str]:
    """The command in a process of its own."""
    return subprocess.Popen(
        [*CALL, "sweep", *arguments],
        cwd=cwd, env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def journal(folder: Path) -> list[dict]:
    """The whole lines of a journal."""
    path = folder / "journal.jsonl"
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_bytes().split(b"\n")[:-1]]
