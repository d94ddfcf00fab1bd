"""Participants in rehearsals: the other nodes run with them, and replay exactly."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.bridge.deployments import TELEOPERATION
from tests.cli.command import Command

#: Nodes that a busy machine does not stop: nothing here is about time.
CALM = (
    "run.stop=1",
    'deploy.nodes.master_control.stale."master_control.q".stop="5 s"',
    'deploy.nodes.slave_control.stale."slave_control.q".stop="5 s"',
    *(f'deploy.nodes.{n}.drive.watchdog="5 s"' for n in ("master", "slave")),
    *(
        f'deploy.nodes.{n}.{key}="5 s"'
        for n in ("master", "slave", "master_control", "slave_control")
        for key in ("overrun", "within")
    ),
)
needs_cc = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler (cc)")


@pytest.fixture
def cosim(monkeypatch, capsys):
    return Command(monkeypatch, capsys)


def settings(*changes: str) -> list[str]:
    return [word for change in changes for word in ("--set", change)]


def built(cosim: Command, folder: Path, *words: str) -> None:
    """A new participant in `folder`, built by the command that its page has."""
    done = cosim("new", "participant", folder.name, "--dir", folder.parent, *words)
    assert done.code == 0, done
    page = (folder / "README.md").read_text(encoding="utf-8")
    if line := next((x for x in page.splitlines() if x.startswith("Build: ")), ""):
        command = line.partition("`")[2].rstrip("`")
        made = subprocess.run(command, shell=True, cwd=folder, capture_output=True, text=True)
        assert made.returncode == 0 and not made.stderr, made.stderr


def judged(cosim: Command, folder: Path, *words: str | Path) -> dict:
    """What the rehearsal says of the other nodes; its replay is exact."""
    done = cosim("rehearse", TELEOPERATION, "--no-plot", "--no-twin", "--out", folder, *words)
    assert "difference exactly 0" in done.out, done.out + done.err
    found: dict = json.loads((folder / "run.json").read_text())["rehearsal"]
    if done.code not in (0, 3):  # the requirements are those of another arm
        assert all(x.startswith("requirement") for x in found["reasons"]), done.out
    again = cosim("replay", folder)
    assert again.code == 0, again
    return found


def heard(found: dict, node: str, message: str) -> int:
    """Samples of a message that a node accepted; it refused none."""
    counts = found["nodes"][node]["said"]["messages"][message]
    refused = {name for name in ("crc", "length", "invalid", "range", "rate") if counts[name]}
    assert not refused and not counts["wrong_sequence"]
    return int(counts["ok"])


@needs_cc
@pytest.mark.slow
@pytest.mark.live
def test_a_drive_in_c_on_can(cosim, tmp_path):
    words = ("--scenario", TELEOPERATION, "--deploy", "can", "--node", "slave")
    built(cosim, tmp_path / "drive", *words, *settings(*CALM))
    found = judged(
        cosim, tmp_path / "run", "-i", "cosim", "--deploy", "can", *settings(*CALM),
        "--outside", f"slave={tmp_path}/drive/participant {{right}}",
    )  # fmt: skip
    assert heard(found, "slave_control", "STATE_3") > 150
    assert set(found["nodes"]) == {"master", "master_control", "slave_control"}
    assert found["finished"]
