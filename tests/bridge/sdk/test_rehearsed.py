"""Participants in rehearsals: the other nodes run with them, and replay exactly."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.bridge.deployments import TELEOPERATION
from tests.bridge.sdk import core_on_zenoh
from tests.bridge.sdk.bench import library, needs_cc
from tests.bridge.zenoh.rehearsed import sockets
from tests.cli.command import Command

pytestmark = pytest.mark.slow
NODES = {
    "can": ("master", "slave", "master_control", "slave_control"),
    "zenoh": ("master", "slave"),
}
PYTHON = sys.executable
needs_rustc = pytest.mark.skipif(shutil.which("rustc") is None, reason="no rustc")
PICO = os.environ.get("ZENOH_PICO", "")


@pytest.fixture
def cosim(monkeypatch, capsys):
    return Command(monkeypatch, capsys)


def calm(deploy: str) -> list[str]:
    """Nodes that a busy machine does not stop: nothing here is about time."""
    found = ["run.stop=1"]
    for node in NODES[deploy]:
        found += [f'deploy.nodes.{node}.{key}="5 s"' for key in ("overrun", "within")]
    if deploy == "can":
        for side in ("master", "slave"):
            found.append(f'deploy.nodes.{side}.drive.watchdog="5 s"')
            found.append(f'deploy.nodes.{side}_control.stale."{side}_control.q".stop="5 s"')
    return [word for change in found for word in ("--set", change)]


def built(cosim: Command, folder: Path, language: str, deploy: str, node: str = "slave") -> None:
    """A new participant, built by the command that its page has."""
    words = (
        "--scenario",
        TELEOPERATION,
        "--deploy",
        deploy,
        "--node",
        node,
        "--language",
        language,
    )
    done = cosim("new", "participant", folder.name, "--dir", folder.parent, *words, *calm(deploy))
    assert done.code == 0, done
    page = (folder / "README.md").read_text(encoding="utf-8")
    if line := next((x for x in page.splitlines() if x.startswith("Build: ")), ""):
        command = line.partition("`")[2].rstrip("`")
        made = subprocess.run(command, shell=True, cwd=folder, capture_output=True, text=True)
        assert made.returncode == 0 and not made.stderr, made.stderr


def judged(cosim: Command, folder: Path, deploy: str, *words: str | Path) -> dict[str, Any]:
    """The verdict on the other nodes of a rehearsal, whose replay is exact."""
    said = (
        "rehearse",
        TELEOPERATION,
        "--deploy",
        deploy,
        "--no-plot",
        "--no-twin",
        "--out",
        folder,
    )
    done = cosim(*said, *calm(deploy), *words)
    assert "difference exactly 0" in done.out, done.out + done.err
    found: dict[str, Any] = json.loads((folder / "run.json").read_text())["rehearsal"]
    if done.code not in (0, 3):  # the requirements are those of another arm
        assert all(x.startswith("requirement") for x in found["reasons"]), done.out
    again = cosim("replay", folder)
    assert again.code == 0, again
    return found


def heard(found: dict[str, Any], node: str, message: str) -> int:
    """Samples of a message that a node accepted; none had wrong bytes or values."""
    counts = found["nodes"][node]["said"]["messages"][message]
    assert not {name for name in ("crc", "length", "invalid", "range", "repeated") if counts[name]}
    return int(counts["ok"])


def on_can(cosim: Command, folder: Path, command: str) -> None:
    """A program as the drive of the slave, on the simulated buses of the rehearsal."""
    found = judged(cosim, folder / "run", "can", "-i", "cosim", "--outside", f"slave={command}")
    assert set(found["nodes"]) == {"master", "master_control", "slave_control"}
    assert heard(found, "slave_control", "STATE_3") > 150 and found["finished"]


def on_zenoh(cosim: Command, folder: Path, command: str, *words: str) -> None:
    """A program as the slave, over Zenoh."""
    found = judged(cosim, folder / "run", "zenoh", *words, "--outside", f"slave={command}")
    assert set(found["nodes"]) == {"master"}
    assert heard(found, "master", "xi_slave") > 150 and found["finished"]


def local(folder: Path) -> list[str]:
    """Sockets in place of ports."""
    return [word for change in sockets(["master", "slave"], folder) for word in ("--set", change)]


@needs_cc
@pytest.mark.live
def test_a_drive_in_c_on_can(cosim, tmp_path):
    built(cosim, tmp_path / "drive", "c", "can")
    on_can(cosim, tmp_path, f"{tmp_path}/drive/participant {{right}}")


def test_a_drive_in_python_on_can(cosim, tmp_path):
    built(cosim, tmp_path / "drive", "python", "can")
    on_can(cosim, tmp_path, f"{PYTHON} {tmp_path}/drive/participant.py cosim {{right}}")


@needs_cc
def test_the_core_in_c_on_zenoh(cosim, tmp_path):
    changes = [word for word in calm("zenoh") if word != "--set"]
    core = library(tmp_path / "c", "zenoh", "slave", *changes)
    words = f"{PYTHON} {core_on_zenoh.__file__} {core} teleoperation slave"
    on_zenoh(cosim, tmp_path, f'{words} "{{net.listen}}" "{{net.connect}}"', *local(tmp_path))


@pytest.mark.live
def test_an_arm_in_python_on_zenoh(cosim, tmp_path):
    built(cosim, tmp_path / "arm", "python", "zenoh")
    command = f'{PYTHON} {tmp_path}/arm/participant.py "{{net.listen}}" "{{net.connect}}"'
    on_zenoh(cosim, tmp_path, command, *local(tmp_path))


@pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler (c++)")
def test_a_drive_in_cpp_on_can(cosim, tmp_path):
    built(cosim, tmp_path / "drive", "c++", "can")
    on_can(cosim, tmp_path, f"{tmp_path}/drive/participant {{right}}")


@needs_cc
@needs_rustc
def test_a_drive_in_rust_on_can(cosim, tmp_path):
    built(cosim, tmp_path / "drive", "rust", "can")
    on_can(cosim, tmp_path, f"{tmp_path}/drive/participant {{right}}")


@pytest.mark.skipif(not PICO, reason="ZENOH_PICO names no folder where zenoh-pico is installed")
@pytest.mark.parametrize(("language", "compiler"), [("c", "cc"), ("c++", "c++"), ("rust", "rustc")])
def test_an_arm_on_zenoh_pico(cosim, tmp_path, monkeypatch, language, compiler):
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler}")
    for name, folder in (
        ("C_INCLUDE_PATH", "include"), ("CPLUS_INCLUDE_PATH", "include"), ("LIBRARY_PATH", "lib")
    ):  # fmt: skip
        monkeypatch.setenv(name, f"{PICO}/{folder}")
    built(cosim, tmp_path / "arm", language, "zenoh")
    on_zenoh(cosim, tmp_path, f'{tmp_path}/arm/participant "{{net.listen}}" "{{net.connect}}"')


def test_a_program_that_ends_before_the_start_is_named(cosim, tmp_path):
    words = ("--deploy", "can", "-i", "cosim", "--no-plot", "--out", tmp_path / "run")
    done = cosim(
        "rehearse", TELEOPERATION, *words, "--outside", "slave=sh -c 'echo no law; exit 3'"
    )
    assert done.code == 1
    assert "node slave, outside: its program has ended (exit code 3: no law)" in done.err
