"""``cosim conform --drive``: options and errors, and our emulated drive in simulated time."""

import json

import pytest

from tests.bridge.deployments import TELEOPERATION
from tests.cli.command import Command


@pytest.fixture
def command(monkeypatch, capsys):
    monkeypatch.setenv("NO_COLOR", "1")
    return Command(monkeypatch, capsys)


def test_a_drive_is_judged_in_simulated_time(command, tmp_path):
    file = tmp_path / "x.json"
    words = ("--drive", "damiao", "--node", 3, "--emulated")
    done = command("conform", *words, "--may-move", "--json", file)
    assert (done.code, done.out.splitlines()[0]) == (0, "damiao drive 3")
    verdicts = [r["verdict"] for r in json.loads(file.read_text())["rules"]]
    assert set(verdicts) == {"passed"}
    done = command("conform", *words)
    assert done.code == 0
    assert "because  it needs --may-move" in done.out
    done = command("conform", "--drive", "cia402", "--list", "--rules", "K-13")
    assert "CANopen, CiA 402-2, state machine, transition 4" in done.out


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("--drive", "maxon", "--node", 3), "expected one of damiao, odrive, cia402"),
        (("--drive", "damiao"), "expected the number of the drive"),
        (("--drive", "odrive", "--node", 64), "expected the number of the drive"),
        (("--drive", "damiao", "--node", 3), "found 0 channels, expected one"),
        (("--drive", "odrive", "--node", 3, "--emulated", "--watchdog", "3 N"), "watchdog"),
        ((TELEOPERATION, "--drive", "damiao", "--node", 3), "expected one of them"),
        (("--drive", "damiao", "--node", 3, "-i", "nothing", "-c", "x"), "nothing"),
    ],
)
def test_a_drive_that_cannot_be_judged_is_one_sentence(command, arguments, text):
    assert text in command.refused("conform", *arguments)
