"""The command: all runs, once each, whatever happens to it."""

from __future__ import annotations

import csv
import signal
import subprocess
from pathlib import Path
from time import sleep

import pyarrow.parquet as pq
import pytest

from cosim.scenario.assemble import assemble
from cosim.ssp.export import write
from tests.cli.command import Command
from tests.cosim.study.studies import SCENARIO, STUDY, journal, started, written
from tests.system.runs import CONFIG, scenario, teleoperation

GRID = STUDY + "values = [1, 10, 150, 205, 1500]\n"
FIGURES = """
[vary.x]
path = "components.plant.start.x"
values = [1, 2]
[vary.law.cases]
hold = ["run.seed=0"]
other = ["run.seed=1"]
[figures.map]
kind = "map"
x = "gain"
y = "law"
z = "stable"
[figures.line]
kind = "line"
x = "gain"
y = "rest"
by = "x"
logx = true
logy = true
[figures.points]
kind = "points"
x = "gain"
y = "rest.rmse"
z = "rest.settle_s"
"""

ARMS = """
scenario = "FILE"
settings = ["run.stop='2 s'"]
[vary.K]
path = "components.master_control.parameters.K"
values = [8, 16]
[metrics.last]
kind = "norm"
of = ["master.tau_h"]
"""


def table(folder: Path) -> list[dict]:
    found: list[dict] = pq.read_table(folder / "table.parquet").to_pylist()
    return found


def dataset(folder: Path) -> list[dict]:
    return [r for p in (folder / "results").glob("*.parquet") for r in pq.read_table(p).to_pylist()]


def test_a_study_becomes_a_table_a_summary_and_figures(cosim: Command, tmp_path: Path) -> None:
    done = cosim("sweep", written(tmp_path, GRID + FIGURES), "--workers", "threads", "--png")
    out = tmp_path / "runs" / "study"
    assert done.code == 0
    assert done.err.splitlines()[-1].startswith("20/20 runs in ")
    found = table(out)
    assert [r["gain"] for r in found[::4]] == [1, 10, 150, 205, 1500]
    assert [r["stable"] for r in found] == [True] * 16 + [False] * 4
    assert found[0]["rest"] == pytest.approx(0.99**400)
    assert found[2]["rest"] == pytest.approx(2 * 0.99**400)
    assert {r["law"] for r in found} == {"hold", "other"}
    assert "20 runs: 16 stable, 4 not (4 of them did not reach their end)" in done.out
    assert "  4 x gain: not a finite number: gain.y = " in done.out
    rows = list(csv.DictReader((out / "summary.csv").open()))
    assert [r["stable"] for r in rows[::4]] == ["1.0", "1.0", "1.0", "1.0", "0.0"]
    assert len(dataset(out)) == 20
    for name in ("map", "line", "points"):
        assert (out / f"{name}.png").stat().st_size > 5000


def test_processes_give_what_threads_give(cosim: Command, tmp_path: Path) -> None:
    study = written(tmp_path, GRID)
    assert cosim("sweep", study, "--workers", "threads", "--out", "a").code == 0
    assert cosim("sweep", study, "--jobs", 2, "--out", "b", "--quiet").out == ""
    a, b = ([{**r, "wall": 0} for r in table(tmp_path / x)] for x in "ab")
    assert repr(a) == repr(b)  # NaN is NaN


def test_a_component_that_crashes_takes_its_own_run_with_it(cosim: Command, tmp_path: Path) -> None:
    study = STUDY.replace('.gain"', '.how"') + "values = [0, 1, 2, 0.0, 0.00, 1.0]\n"
    done = cosim("sweep", written(tmp_path, study), "--jobs", 2, "--out", "here", "--no-plot")
    assert done.code == 1
    assert " runs have no result, the first of them: the worker process died" in done.err
    found = {r["gain"]: r for r in table(tmp_path / "here")}
    assert found[0]["stable"]
    assert found[1]["reason"].startswith("gain: ZeroDivisionError: one over nothing")
    assert found[2]["reason"].startswith("the worker process died")
    assert "6 points, 1 of them twice; 5 to run" in done.out


def test_a_study_grows_and_what_is_there_stays(cosim: Command, tmp_path: Path) -> None:
    written(tmp_path, GRID)
    flags = ("--workers", "threads", "--out", "here", "--no-plot")
    assert "5 points; 2 to run" in cosim("sweep", "study.toml", *flags, "--limit", 2).out
    first = dataset(tmp_path / "here")
    assert "the folder already contains a sweep; use --resume" in cosim.refused(
        "sweep", "study.toml", *flags
    )
    done = cosim("sweep", "study.toml", *flags, "--resume")
    assert "5 points; 2 there already; 3 to run" in done.out
    written(tmp_path, GRID.replace("[1, 10,", "[10, 20, 30,"))
    done = cosim("sweep", "study.toml", *flags, "--resume")
    assert "6 points; 4 there already; 2 to run" in done.out
    assert "the study has changed: 1 rows in this folder are no longer part of it" in done.out
    assert [r["gain"] for r in table(tmp_path / "here")] == [10, 20, 30, 150, 205, 1500]
    rows = dataset(tmp_path / "here")
    assert len(rows) == len({r["run"] for r in rows}) == 7
    assert {repr(row) for row in first} <= {repr(row) for row in rows}  # NaN is NaN


def test_runs_that_failed_are_made_again_if_asked_for(cosim: Command, tmp_path: Path) -> None:
    study = written(tmp_path, STUDY.replace('.gain"', '.how"') + "values = [0, 1, 3]\n")
    flags = ("--workers", "threads", "--out", "here", "--no-plot")
    assert "2 failed" in cosim("sweep", study, *flags).err
    (tmp_path / "mended").touch()
    assert "3 there already; 0 to run" in cosim("sweep", study, *flags, "--resume").out
    done = cosim("sweep", study, *flags, "--retry", "--limit", 2)
    assert "3 points; 3 there already, 2 of them failed; 2 to run" in done.out
    found = {r["gain"]: r for r in table(tmp_path / "here")}
    assert found[0]["stable"]
    assert found[3]["stable"]
    assert found[3]["rest"] == found[0]["rest"]
    assert "one over nothing" in found[1]["reason"]
    rows = dataset(tmp_path / "here")
    assert len(rows) == 5
    assert len({r["run"] for r in rows}) == 3
    assert "1 of them failed; 1 to run" in cosim("sweep", study, *flags, "--retry").out


def test_a_sweep_of_a_system_of_another_tool(cosim: Command, tmp_path: Path) -> None:
    """The exported scenario gives what the scenario gives."""
    read = scenario(teleoperation(stop=2.0))
    (tmp_path / "arms.toml").write_text(CONFIG.read_text(encoding="utf-8"), encoding="utf-8")
    write(read, assemble(read), tmp_path / "arms.ssp")
    rows = []
    for name in ("arms.toml", "arms.ssp"):
        (tmp_path / "study.toml").write_text(ARMS.replace("FILE", name), encoding="utf-8")
        cosim("sweep", "study.toml", "--workers", "threads", "--out", name[5:], "--no-plot")
        rows.append(table(tmp_path / name[5:]))
    for one, other in zip(*rows, strict=True):
        assert not one["reason"]
        assert one["last"] == other["last"]
    assert rows[0][0]["last"] != rows[0][1]["last"]


def test_another_scenario_is_another_sweep(cosim: Command, tmp_path: Path) -> None:
    flags = ("--workers", "threads", "--out", "here", "--no-plot")
    cosim("sweep", written(tmp_path, GRID), *flags)
    written(tmp_path, GRID, SCENARIO.replace("stop = 4", "stop = 2"))
    assert "has changed since the runs in this folder" in cosim.refused(
        "sweep", "study.toml", *flags, "--resume"
    )
    assert "5 to run" in cosim("sweep", "study.toml", *flags, "--resume", "--force").out
    assert table(tmp_path / "here")[0]["rest"] == pytest.approx(0.99**200)
    assert len(dataset(tmp_path / "here")) == 10


def test_trajectories_are_kept_if_asked_for(cosim: Command, tmp_path: Path) -> None:
    study = written(tmp_path, 'keep = "trajectories"\n' + GRID)
    cosim("sweep", study, "--workers", "threads", "--out", "here", "--no-plot")
    for row in table(tmp_path / "here"):
        folder = tmp_path / "here" / "runs" / row["run"]
        assert (folder / "trajectories.parquet").exists()
        assert (folder / "last.parquet").exists() == (row["gain"] == 1500)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--workers", "elves"), "--workers 'elves': expected processes or threads"),
        (("--out", "loop.toml"), "loop.toml: cannot use this folder: "),
        (("--out", "."), "the folder holds "),
    ],
)
def test_what_cannot_be_is_refused(
    cosim: Command, tmp_path: Path, arguments: tuple[str, ...], said: str
) -> None:
    assert said in cosim.refused("sweep", written(tmp_path, GRID), *arguments)


# ---- the end of the process ---------------------------------------------------------------------

SLOW = "settings = [\"components.gain.parameters.wait='100 ms'\"]\n" + STUDY
SLOW += "range = [1, 40]\ncount = 40\n"


def begun(folder: Path, rows: int, *arguments: str) -> subprocess.Popen[str]:
    """A sweep of forty slow runs, when `rows` of them are there."""
    written(folder, SLOW)
    process = started("study.toml", "--out", "here", "--no-plot", *arguments, cwd=folder)
    while len(journal(folder / "here")) < rows:
        assert process.poll() is None, process.communicate()
        sleep(0.005)
    return process


def resumed(cosim: Command, folder: Path, there: list[dict]) -> None:
    """Go on to the end: all of what was there is, as it was, and nothing is there twice."""
    done = cosim("sweep", "study.toml", "--out", "here", "--resume", "--workers", "threads")
    assert done.code == 0
    assert f"40 points; {len(there)} there already; {40 - len(there)} to run" in done.out
    rows = dataset(folder / "here")
    assert len(rows) == len({r["run"] for r in rows}) == 40
    walls = {r["run"]: r["wall"] for r in rows}
    assert all(walls[r["run"]] == r["wall"] for r in there)


def test_killed_in_the_middle_it_goes_on_where_it_was(cosim: Command, tmp_path: Path) -> None:
    process = begun(tmp_path, 5, "--jobs", "2")
    process.send_signal(signal.SIGKILL)
    process.communicate(timeout=60)  # the workers have let go of its pipes: they have ended
    there = journal(tmp_path / "here")
    assert 5 <= len(there) < 40
    resumed(cosim, tmp_path, there)


def test_ctrl_c_ends_cleanly(cosim: Command, tmp_path: Path) -> None:
    process = begun(tmp_path, 5, "--jobs", "2")
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "continue with --resume" in err
    assert "Traceback" not in err
    assert journal(tmp_path / "here") == []
    there = dataset(tmp_path / "here")
    assert 5 <= len(there) < 40
    resumed(cosim, tmp_path, there)
