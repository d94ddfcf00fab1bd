"""Rehearsals over simulated buses that the rehearsal serves itself."""

from __future__ import annotations

import json
import re

import pytest

from bridge.deployment.system import load_system
from bridge.rehearsal.simulated_buses import served
from bridge.replay.from_log import replay_log
from cosim.record import Run
from tests.bridge.deployments import OPENARM, SIX_AXIS_POSITION, TELEOPERATION
from tests.cli.command import Command


@pytest.fixture
def cosim(monkeypatch, capsys):
    return Command(monkeypatch, capsys)


def rehearse(cosim, folder, *more):
    words = ("rehearse", TELEOPERATION, "-i", "cosim", "--no-plot", "--out", folder)
    return cosim(*words, "--set", "run.stop=0.5", *more)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["can", "can-classic"])
def test_processes_in_simulated_time_are_the_twin(cosim, name, tmp_path):
    done = rehearse(cosim, tmp_path / "run", "--deploy", name, "--clock", "simulated")
    assert done.code == 0, done
    assert "0.5 s in simulated time" in done.out
    assert "positions differ by 0 rad RMS" in done.out
    assert "no slot missed, replays exactly" in done.out
    difference = cosim("diff", tmp_path / "run", tmp_path / "run/twin")
    assert "identical to the bit in 42 signals, 500 rows" in difference.out
    for link in Run.open(tmp_path / "run").path.glob("links/*"):
        assert link.read_bytes() == (tmp_path / "run/twin/links" / link.name).read_bytes()
    logs = [tmp_path / f"run/buses/{bus}.log" for bus in ("left", "right")]
    assert len(logs[0].read_text().splitlines()) > 300
    assert replay_log(load_system(TELEOPERATION, name, ["run.stop=0.5"]), logs).exact
    notes = json.loads((tmp_path / "run/run.json").read_text())["rehearsal"]["notes"]
    assert notes == []
    assert cosim("report", tmp_path / "run").code == 0
    page = (tmp_path / "run/report.html").read_text(encoding="utf-8")
    assert re.search(r"left SYNC: \d+ frames from 0\.00 s", page), "frames count from the start"


@pytest.mark.slow
@pytest.mark.parametrize("period", ["2 ms", "4 ms"])
def test_two_openarms_on_simulated_buses_are_their_twin(cosim, period, tmp_path):
    """500 and 250 Hz; the load is that of 14 frames of 50 us a cycle."""
    nodes = ("master", "slave", "master_control", "slave_control")
    changes = [word for n in nodes for word in ("--set", f'components.{n}.period="{period}"')]
    words = ("rehearse", OPENARM, "-i", "cosim", "--clock", "simulated", "--set", "run.stop=1")
    done = cosim(*words, "--no-plot", "--out", tmp_path / "run", *changes)
    assert done.code == 0, done
    assert "positions differ by 0 rad RMS" in done.out
    assert "no slot missed, replays exactly" in done.out
    expected = 100 * 14 * 50.3e-6 / (2e-3 if period == "2 ms" else 4e-3)
    for bus in ("left", "right"):
        load = re.search(rf"bus {bus} .* load ([\d.]+)%", done.out)
        assert load and float(load[1]) == pytest.approx(expected, rel=0.08)


@pytest.mark.slow
def test_two_arms_that_take_positions_are_their_twin(cosim, tmp_path):
    words = ("rehearse", SIX_AXIS_POSITION, "-i", "cosim", "--clock", "simulated")
    done = cosim(*words, "--set", "run.stop=1", "--no-plot", "--out", tmp_path / "run")
    assert done.code == 0, done
    assert "positions differ by 0 rad RMS" in done.out
    assert "master_command.q_c -> master_servo.q_c" in done.out
    assert "no slot missed, replays exactly" in done.out


@pytest.mark.slow
@pytest.mark.live
def test_processes_on_the_wall_clock_share_the_buses_too(cosim, tmp_path):
    calm = 'deploy.nodes.{}.overrun="2 s"'
    nodes = ("master", "slave", "master_control", "slave_control")
    settings = [word for node in nodes for word in ("--set", calm.format(node))]
    done = rehearse(cosim, tmp_path / "run", "--no-twin", *settings)
    assert done.code in (0, 3), done
    assert "0.5 s on the wall clock" in done.out
    assert "bus left" in done.out


@pytest.mark.parametrize(
    ("more", "text"),
    [
        (["--faults", "x.toml"], "found --faults with the simulated clock, expected it with"),
        (["--nodes", "master"], "found --nodes with the simulated clock"),
        (["--hardware"], "found --hardware with the simulated clock"),
    ],
)
def test_options_of_the_wall_clock_are_refused(cosim, more, text, tmp_path):
    words = ("rehearse", TELEOPERATION, "-i", "cosim", "--clock", "simulated")
    assert text in cosim.refused(*words, "--out", tmp_path / "run", *more)


def test_a_bus_that_is_served_elsewhere_keeps_its_address():
    changes = [
        'deploy.buses.left.interface="cosim"', 'deploy.buses.left.channel="bench@10.0.0.1:29530"',
        'deploy.buses.right.interface="cosim"', 'deploy.buses.right.channel="right"',
    ]  # fmt: skip
    with served(load_system(TELEOPERATION, "can", changes), []) as settings:
        assert len(settings) == 1
        assert settings[0].startswith('deploy.buses.right.channel="right@127.0.0.1:')
