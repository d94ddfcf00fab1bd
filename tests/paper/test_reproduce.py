"""``cosim reproduce`` as a user runs it: its output, its files and its exit code."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from cosim.base.copies import replace
from cosim.base.errors import RunError, ScenarioError
from cosim.cli.options import flat
from cosim.cli.reproduce import reproduce
from cosim.record import Run
from fmus.paper import claims, reproduction, teaching
from fmus.paper.claim import never

app = typer.Typer()
app.command()(flat(reproduce))
PNG = b"\x89PNG"


def called(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, arguments)
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output


def test_a_table_figures_numbers_runs_and_json(tmp_path: Path) -> None:
    code, text = called("--only", "1,2", "--out", str(tmp_path / "out"), "--jobs", "1")
    assert code == 0
    lines = [line for line in text.splitlines() if line.startswith("  pass")]
    rows = json.loads((tmp_path / "out/claims.json").read_text(encoding="utf-8"))["claims"]
    assert len(lines) == len(rows) > 5
    assert f"{len(rows)} claims: {len(rows)} pass, 0 FAIL" in text
    assert "\x1b[" not in text  # no terminal, no colour
    for name in ("fig01", "fig01-text", "fig02"):
        assert (tmp_path / f"out/{name}.png").read_bytes()[:4] == PNG
    page = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 3
    assert page.count("<td>✓</td>") == len(rows) and f"{len(rows)} of {len(rows)} claims" in page
    assert not (tmp_path / "out/fig03.png").exists()
    assert not (tmp_path / "out/runs/pair-10").exists()


def test_the_columns_line_up(tmp_path: Path) -> None:
    _, text = called("--only", "o1,fig3", "--out", str(tmp_path), "--jobs", "1")
    section = [line for line in text.splitlines() if line.startswith("  pass")]
    starts = {line.index(" rad") for line in section if line.endswith(" rad")}
    assert len(starts) == 1


def test_the_numbers_of_a_figure_are_those_of_its_run(tmp_path: Path) -> None:
    reproduction.reproduce(tmp_path, ["fig3"], jobs=1)
    table = np.loadtxt(tmp_path / "fig03.csv", delimiter=",", skiprows=1)
    header = (tmp_path / "fig03.csv").read_text(encoding="utf-8").splitlines()[0]
    assert header == "t [s],robot.q[0] [rad],robot.q[1] [rad]"
    run = Run.open(tmp_path / "runs/teaching-0")
    rows = np.searchsorted(run.t, table[:, 0] - 1e-9)
    assert table[-1, 0] == 20.0
    assert np.allclose(table[:, 1:], run.array("robot.q")[rows], atol=1e-6)


def test_a_claim_that_fails_is_shown_and_is_the_exit_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wrong = replace(teaching.CLAIMS[0], expected=never())
    title = "Teaching"
    monkeypatch.setattr(claims, "SECTIONS", {title: (wrong, teaching.CLAIMS[1])})
    code, text = called("--out", str(tmp_path), "--only", "thm2", "--jobs", "1", "--quiet")
    assert code == 1
    assert "FAIL  fig1-settled" in text
    assert "expected from: independent simulation" in text
    assert "fig1-exact" not in text  # quiet: what fails only
    rows = json.loads((tmp_path / "claims.json").read_text(encoding="utf-8"))["claims"]
    assert [row["passed"] for row in rows] == [False, True]


def test_a_list_runs_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    code, text = called("--list")
    assert code == 0
    assert "fig1-settled" in text
    assert "[o5 thm5]" in text
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_two_processes_find_what_one_finds(tmp_path: Path) -> None:
    measured = []
    for jobs in (1, 2):
        rows = reproduction.reproduce(tmp_path / str(jobs), ["12", "fig3"], jobs=jobs, seed=3)
        measured.append([row["measured"] for row in rows])
        assert (tmp_path / str(jobs) / "fig12.png").exists()
    assert measured[0] == measured[1]
    one, two = (tmp_path / f"{jobs}/runs/pair-10/trajectories.parquet" for jobs in (1, 2))
    assert one.read_bytes() == two.read_bytes()


def test_progress_counts_runs_and_figures(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    reproduction.reproduce(
        tmp_path, ["fig1"], jobs=1, progress=lambda done, all_: seen.append((done, all_))
    )
    runs, figures = len(select_cases("fig1")), 2
    assert seen == [(k, runs + figures) for k in range(1, runs + figures + 1)]


def select_cases(topic: str) -> frozenset[str]:
    return claims.select([topic]).cases


def test_a_folder_that_holds_something_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("x")
    for force in (False, True):
        with pytest.raises(ScenarioError, match="not empty"):
            reproduction.reproduce(tmp_path, ["o1"], jobs=1, force=force)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_reproduction_is_replaced_by_force_only(tmp_path: Path) -> None:
    reproduction.reproduce(tmp_path, ["o1"], jobs=1)
    with pytest.raises(ScenarioError, match="--force"):
        reproduction.reproduce(tmp_path, ["o1"], jobs=1)
    assert reproduction.reproduce(tmp_path, ["o1"], jobs=1, force=True)


def test_what_nothing_is_about_runs_nothing(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="no claim is about 'fig99'"):
        reproduction.reproduce(tmp_path / "out", ["99"], jobs=1)
    assert not (tmp_path / "out").exists()


def test_the_graphs_are_drawn(tmp_path: Path) -> None:
    assert reproduction.reproduce(tmp_path, ["4"], jobs=1) == []
    for name in ("fig04.png", "fig05.png"):
        assert (tmp_path / name).read_bytes()[:4] == PNG


def test_a_case_that_cannot_start_ends_the_reproduction(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object, **__: object) -> None:
        raise RunError("no space left")

    monkeypatch.setattr(reproduction, "simulate", refused)
    with pytest.raises(RunError, match="no space left"):
        reproduction.reproduce(tmp_path, ["o1"], jobs=1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_everything_passes(tmp_path: Path, seed: int) -> None:
    code, text = called("--out", str(tmp_path), "--seed", str(seed), "--jobs", "2")
    assert code == 0, [line for line in text.splitlines() if "FAIL" in line]
    drawn = {path.stem for path in tmp_path.glob("*.png")}
    assert {f"fig{n:02d}" for n in range(1, 16)} <= drawn


def test_the_page_says_how_many_claims_there_are() -> None:
    """``more than 200 claims``: counted here, and rounded down to a multiple of 50."""
    page = (Path(__file__).parents[2] / "docs/paper.md").read_text(encoding="utf-8")
    (said,) = re.findall(r"(\d+) claims", page)
    counted = sum(len(part) for part in claims.SECTIONS.values())
    assert int(said) == counted // 50 * 50, f"docs/paper.md says {said}, there are {counted}"
