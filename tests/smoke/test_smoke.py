"""The least that has to work after an installation, with a compiler or without: a few seconds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.record import Run
from fmus.models import planar2r
from tests.cli.command import CONFIG, Command, finished
from tests.system.golden import make
from tests.system.runs import SIDES, run, teleoperation


def test_the_main_job_runs_and_leaves_a_folder(cosim: Command, tmp_path: Path) -> None:
    done = cosim("run", CONFIG, "--set", "run.stop=2", "--out", "here")
    assert (done.code, done.err) == (0, "")
    assert "operator effort" in done.out
    names = sorted(path.name for path in (tmp_path / "here").iterdir())
    assert names == ["SHA256SUMS", "links", "report.html", "run.json", "trajectories.parquet"]


def test_the_first_seconds_are_the_golden_trajectory(tmp_path: Path) -> None:
    golden = np.loadtxt(make.FILE, delimiter=",", skiprows=1)[:4, 1:]
    result = run(teleoperation(stop=2.0), tmp_path / "run")
    ours = np.column_stack([result.column(name) for name in make.COLUMNS])[: -1 : make.EVERY]
    assert np.abs(ours - golden).max() < 1e-9


@pytest.mark.parametrize(("fmi", "made_by"), [("3.0", ""), ("2.0", ":kernel")])
def test_every_interface_gives_the_same_bytes(tmp_path: Path, fmi: str, made_by: str) -> None:
    other = teleoperation(stop=0.5)
    for component in other["components"].values():
        component |= {"fmi": fmi, "model": component["model"] + made_by}
    run(teleoperation(stop=0.5), tmp_path / "fmi2")
    run(other, tmp_path / "other")
    files = [tmp_path / folder / "trajectories.parquet" for folder in ("fmi2", "other")]
    assert files[0].read_bytes() == files[1].read_bytes()


def test_show_and_info(cosim: Command) -> None:
    shown = cosim("show", CONFIG)
    assert shown.code == 0 and all(side in shown.out for side in SIDES)
    told = cosim("info", planar2r.fmu("3.0"))
    assert told.code == 0 and "FMPy found no problems" in told.out


def test_a_wrong_key_is_a_sentence(tmp_path: Path) -> None:
    done = finished("run", CONFIG, "--set", "run.colour=1", cwd=tmp_path)
    assert done.code == 2
    assert done.err.startswith("error: ") and done.err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_run_is_read_back(tmp_path: Path) -> None:
    result = Run.open(run(teleoperation(stop=0.1), tmp_path / "run").path.parent)
    assert result.array("master.q").shape == (101, 2)
    assert result.unit("master.q") == "rad"
