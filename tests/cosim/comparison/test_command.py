"""``cosim compare`` as a user runs it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import typer

from cosim.base.errors import ScenarioError
from cosim.cli.compare import compare
from cosim.cli.options import flat
from cosim.record import held_folder
from tests.cli.command import Command
from tests.cosim.comparison.parts import CONFIG, SMALL, VARIANTS, written


def call(*arguments: str | Path) -> None:
    """The command alone, without what turns errors into exit codes."""
    app = typer.Typer()
    app.command()(flat(compare))
    app([*map(str, arguments)], standalone_mode=False)


def test_it_prints_one_table_and_writes_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    call(
        CONFIG, "--controllers", "p+d,pd", "--operators", "light, tight", "--links", "paper",
        "--set", "run.stop=2 s", "--jobs", "1", "--out", out, "--keep", "--png",
    )  # fmt: skip
    said = capsys.readouterr()
    assert "2 controllers x 2 operators x 1 link laws x 1 seed\n4 runs; 4 to run" in said.out
    assert "link tables: the same for every controller" in said.out
    assert said.err.startswith("4/4 runs in ")
    assert {p.name for p in out.iterdir()} == {
        "comparison.png", "report.html", "table.md", "table.csv", "table.json", "links", "runs",
        "SHA256SUMS",
    }  # fmt: skip
    kept = out / "runs" / "paper" / "tight" / "pd-seed0"
    assert (kept / "trajectories.parquet").exists()
    with pytest.raises(ScenarioError, match="not empty"):
        call(CONFIG, "--out", out)
    call(
        CONFIG, "--controllers", "pd", "--operators", "tight", "--links", "paper", "--quiet",
        "--set", "run.stop=1 s", "--jobs", "1", "--out", out, "--keep", "--force", "--no-plot",
    )  # fmt: skip
    assert capsys.readouterr().out == ""
    assert len(json.loads((out / "table.json").read_text(encoding="utf-8"))["runs"]) == 1
    assert not (out / "comparison.png").exists() and not (out / "report.html").exists()


def test_a_folder_has_one_comparison_at_a_time(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with held_folder(out), pytest.raises(ScenarioError, match="another command records into this"):
        call(CONFIG, "--controllers", "pd", "--operators", "light", "--links", "paper",
             "--set", "run.stop=1 s", "--out", out)  # fmt: skip
    assert not list(out.iterdir())


def test_the_list_says_what_there_is(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    call(CONFIG, "--list")
    said = capsys.readouterr().out
    assert "sends q, dq" in said
    assert "4 B_l B_r > (T_l + T_r)² K_l K_r" in said
    assert "200 N·m/rad" in said
    call(CONFIG, "--variants", written(tmp_path, SMALL), "--list")
    assert "sends q, dq" in capsys.readouterr().out


def test_a_wrong_name_is_one_sentence_and_an_exit_code(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said = Command(monkeypatch, capsys).refused("compare", CONFIG, "--links", "papr")
    assert said.startswith("--links: no link 'papr'; did you mean 'paper'?")


def test_what_cannot_be_leaves_nothing_behind(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(ScenarioError, match="--operators: no operator 'lihgt'; did you mean"):
        call(CONFIG, "--operators", "lihgt", "--out", out)
    with pytest.raises(ScenarioError, match="no such file; expected a scenario file"):
        call(tmp_path / "none.toml", "--variants", VARIANTS, "--out", out)
    with pytest.raises(ScenarioError, match="expected one variants file, there is none"):
        call(tmp_path / "none.toml", "--out", out)
    wrong = written(tmp_path, SMALL.replace("PD(10,4)", "PD(9,9)"))
    with pytest.raises(ScenarioError, match=r"at controllers\.pd"):
        call(CONFIG, "--variants", wrong, "--out", out)
    assert not out.exists()
