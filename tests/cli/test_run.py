"""``cosim run``: its output, and the contents of the run folder."""

from __future__ import annotations

import csv
import io
import json
import re
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

import cosim as package
from cosim.cli import summary
from cosim.measure.metric_result import LABELS
from cosim.record import Run, verify
from tests.cli.command import CONFIG, ROOT, Command, finished

SHORT = ("--set", "run.stop=0.5")
SUMMARY = (
    "sync error",
    "sync error, RMS",
    "sync error, peak",
    "settled",
    "tracking error",
    "tracking error, RMS",
    "tracking error, peak",
    "settled",
    "operator effort",
    "holding torque",
    "peak torque",
    "requirement",
    "requirement",
    "link age",
    "link age",
    "wall time",
    "digest",
    "report",
    "run folder",
)


#: A number that no unit follows.
BARE = re.compile(r"(?<![\w.-])-?\d[\d.]*(?:e[+-]?\d+)?(?![\w.]| (?:rad|N|s|ms|us|times)\b| %)")


def test_the_main_job_prints_a_fact_per_line_with_its_unit(cosim: Command) -> None:
    done = cosim("run", CONFIG)
    assert (done.code, done.err) == (0, "")
    title, what, *lines = done.out.splitlines()
    assert title == "Bilateral teleoperation with time-varying delay (Theorem 5)"
    assert "4 FMUs, 2 links, 60000 ticks of 1 ms, algorithm sampled, seed 0" in what
    facts = [(line[:LABELS].rstrip(), line[LABELS:].strip()) for line in lines]
    assert tuple(label for label, _ in facts) == SUMMARY
    said = dict(facts)
    times = [
        re.fullmatch(r"after ([\d.]+) s \((sync|tracking) error below 0.05 rad\)", text)
        for label, text in facts
        if label == "settled"
    ]
    assert [time and time[2] for time in times] == ["sync", "tracking"]
    assert all(time and 11.0 < float(time[1]) < 12.0 for time in times)
    for label, text in facts[:-3]:  # without digest and paths
        without_signals = re.sub(r"\b(master|slave)\S*", "", text)
        assert not BARE.search(without_signals), (label, text)
    assert float(said["operator effort"].split()[0]) == pytest.approx(47.0, abs=0.5)
    assert said["operator effort"].endswith("N.m.√s (L2 norm of master.tau_h over 60 s)")
    assert float(said["peak torque"].split()[0]) == pytest.approx(26.9, abs=0.1)
    assert re.match(r"7\d\d ms on average, 95 % below 1.1\d s, at most 1.2 s  ", said["link age"])
    assert re.fullmatch(r"[\d.]+ m?s for 60 s: \d+ times real time", said["wall time"])


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("patience", "quiet", "said"), [(0.0, False, True), (60.0, False, False), (0.0, True, False)]
)
def test_what_takes_long_is_said_on_a_terminal(
    monkeypatch: pytest.MonkeyPatch, patience: float, quiet: bool, said: bool
) -> None:
    error = Terminal()
    monkeypatch.setattr("sys.stderr", error)
    monkeypatch.setattr(summary, "PATIENCE", patience)
    with summary.announced(quiet, "checking the scenario"):
        waited = time.monotonic() + 10
        while said and not error.getvalue() and time.monotonic() < waited:
            time.sleep(0.001)
    assert ("checking the scenario" in error.getvalue()) == said
    assert not said or error.getvalue().endswith("\r\x1b[K")


def test_an_error_does_not_stand_behind_what_was_said(monkeypatch: pytest.MonkeyPatch) -> None:
    error = Terminal()
    monkeypatch.setattr("sys.stderr", error)
    with pytest.raises(ValueError, match="wrong"), summary.announced(False, "reading"):
        raise ValueError("wrong")
    assert error.getvalue().endswith("\r\x1b[K")


def test_nothing_is_said_without_a_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(summary, "PATIENCE", 0.0)
    with summary.announced(False, "checking the scenario"):
        time.sleep(0.01)
    assert capsys.readouterr().err == ""


def test_a_run_folder_holds_everything(cosim: Command, tmp_path: Path) -> None:
    assert cosim("run", CONFIG, *SHORT, "--seed", "4").code == 0
    (folder,) = (tmp_path / "runs").iterdir()
    assert re.fullmatch(r"teleoperation-\d{8}-\d{6}", folder.name)
    names = sorted(path.name for path in folder.iterdir())
    assert names == ["SHA256SUMS", "links", "report.html", "run.json", "trajectories.parquet"]
    assert len(list((folder / "links").glob("*.parquet"))) == 2
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert "Bilateral teleoperation" in text and 'class="verdict ' in text


def test_figures_are_drawn_where_they_are_wanted(cosim: Command, tmp_path: Path) -> None:
    wanted = ("--png", "--pdf", "--no-plot")
    assert cosim("run", CONFIG, *SHORT, *wanted, "--out", "here").code == 0
    with Image.open(tmp_path / "here" / "positions.png") as image:
        assert image.width > 600 and image.height > 400
    assert (tmp_path / "here" / "positions.pdf").read_bytes().startswith(b"%PDF")


def test_trajectories_have_a_unit_on_every_column(cosim: Command, tmp_path: Path) -> None:
    cosim("run", CONFIG, *SHORT, "--out", "here", "--no-plot")
    schema = pq.read_schema(tmp_path / "here" / "trajectories.parquet")
    units = {field.name: field.metadata[b"unit"].decode() for field in schema}
    expected = {"t": "s", "master.q[0]": "rad", "slave.dq[1]": "rad/s"}
    expected |= {"master_control.tau[0]": "N.m", "slave_control.xi_in[0,1]": "rad/s"}
    assert expected.items() <= units.items()
    assert all(units.values())
    result = Run.open(tmp_path / "here")
    assert np.array_equal(result.t, np.arange(501) * 1e-3)


def test_run_json_says_what_the_result_depends_on(cosim: Command, tmp_path: Path) -> None:
    cosim("run", CONFIG, *SHORT, "--out", "here", "--no-plot", "--seed", "4")
    said = json.loads((tmp_path / "here" / "run.json").read_text(encoding="utf-8"))
    assert (said["seed"], said["ticks"], said["step"], said["error"]) == (4, 500, 1e-3, None)
    assert said["scenario"]["run"]["stop"] == 0.5
    assert said["versions"]["cosim"] == package.__version__
    assert {"python", "numpy", "platform"} <= set(said["versions"])
    assert re.fullmatch("[0-9a-f]{64}", said["fmus"]["master"]["sha256"])
    (link, _) = said["links"].values()
    assert link["delay"] == {"law": "uniform", "low": 0.3, "high": 1.2, "hold": 0.03}
    assert link["semantics"] == "signal"
    assert said["wall"] > 0


def test_values_are_changed_without_touching_the_file(cosim: Command, tmp_path: Path) -> None:
    """lambda_M = 1 on one side, another preset and another link."""
    changes = [
        "components.master_control.parameters.lambda_M=1",
        "components.slave.preset=heavy",
        "links.0.semantics=newest-stamp",
        'links.1.delay={law = "constant", delay = "100 ms"}',
        "run.record.every=100",
        'title = "another"',
    ]
    settings = [part for change in changes for part in ("--set", change)]
    done = cosim("run", CONFIG, *SHORT, *settings, "--out", "here", "--no-plot")
    assert done.code == 0
    assert done.out.startswith("another\n")
    said = Run.open(tmp_path / "here").metadata["scenario"]
    assert said["components"]["master_control"]["parameters"]["lambda_M"] == 1
    assert said["components"]["slave"]["preset"] == "heavy"
    assert [link["semantics"] for link in said["links"]] == ["newest-stamp", "signal"]
    assert len(Run.open(tmp_path / "here")) == 6


def test_a_seed_on_the_command_line_is_the_last_word(cosim: Command, tmp_path: Path) -> None:
    for folder, arguments in (
        ("a", ("--seed", "3")),
        ("b", ("--set", "run.seed=2", "--seed", "3")),
        ("c", ("--set", "run.seed=2")),
    ):
        cosim("run", CONFIG, "--set", "run.stop=2", *arguments, "--out", folder, "--no-plot")
    a, b, c = ((tmp_path / f / "trajectories.parquet").read_bytes() for f in "abc")
    assert a == b != c


def test_csv_holds_the_same_numbers(cosim: Command, tmp_path: Path) -> None:
    cosim("run", CONFIG, *SHORT, "--out", "here", "--no-plot", "--csv")
    with (tmp_path / "here" / "trajectories.csv").open(encoding="utf-8", newline="") as file:
        names, *rows = csv.reader(file)
    result = Run.open(tmp_path / "here")
    assert names == ["t", *result.names]
    for i, name in enumerate(names):
        assert np.array_equal([float(row[i]) for row in rows], result.column(name))


def test_quiet_and_no_plot(cosim: Command, tmp_path: Path) -> None:
    done = cosim("run", CONFIG, *SHORT, "--out", "here", "--no-plot", "--quiet")
    assert (done.code, done.out, done.err) == (0, "", "")
    assert not (tmp_path / "here" / "report.html").exists()
    assert (tmp_path / "here" / "trajectories.parquet").is_file()


def test_force_replaces_a_run_and_nothing_else(cosim: Command, tmp_path: Path) -> None:
    once = ("run", CONFIG, *SHORT, "--out", "here", "--no-plot", "--quiet")
    assert cosim(*once, "--seed", "1").code == 0
    before = (tmp_path / "here" / "run.json").read_bytes()
    assert "not empty" in cosim.refused(*once)
    assert (tmp_path / "here" / "run.json").read_bytes() == before
    assert cosim(*once, "--force").code == 0
    assert Run.open(tmp_path / "here").metadata["seed"] == 0
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("keep me")
    other = ("run", CONFIG, *SHORT, "--out", "mine", "--no-plot", "--force")
    assert "no earlier run" in cosim.refused(*other)
    assert (tmp_path / "mine" / "notes.txt").read_text() == "keep me"


def test_a_run_that_replaces_another_has_its_own_pictures_and_sums(
    cosim: Command, tmp_path: Path
) -> None:
    """Of the earlier one neither a table nor a figure is left, and no sum."""
    once = ("run", CONFIG, *SHORT, "--out", "here", "--quiet", "--force")
    assert cosim(*once, "--png", "--csv").code == 0
    assert cosim(*once, "--seed", "1", "--pdf").code == 0
    verify(tmp_path / "here")
    found = {path.name for path in (tmp_path / "here").iterdir()}
    assert "positions.pdf" in found and not found & {"positions.png", "trajectories.csv"}


def test_two_runs_in_one_second_do_not_meet(cosim: Command, tmp_path: Path) -> None:
    for _ in range(3):
        assert cosim("run", CONFIG, "--set", "run.stop=0.05", "--no-plot", "-q").code == 0
    assert len(list((tmp_path / "runs").iterdir())) == 3


def test_a_scenario_finds_the_modules_beside_the_user(tmp_path: Path) -> None:
    """The working directory is on the path of the console script, and of nobody else."""
    (tmp_path / "mine.py").write_text("from tests.cosim.blocks import Gain\n", encoding="utf-8")
    (tmp_path / "mine.toml").write_text(
        '[run]\nstep = 0.1\nstop = 1\n[components.gain]\nmodel = "mine:Gain"\n', encoding="utf-8"
    )
    done = finished("run", "mine.toml", cwd=tmp_path)
    assert (done.code, done.err) == (0, "")
    assert "1 Python components" in done.out or "1 Python component," in done.out
    assert (ROOT / "configs").is_dir()
