"""``cosim new controller``: what it writes runs and passes its test as it is."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer import Typer
from typer.testing import CliRunner

from cosim.base.errors import ScenarioError
from cosim.cli.export import export
from cosim.cli.new import new
from cosim.engine.simulate import simulate
from cosim.loading.files import load
from cosim.record import Run
from cosim.scaffold import write_controller

ROOT = Path(__file__).resolve().parents[2]
_PATHS = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
ENVIRONMENT = os.environ | {"PYTHONPATH": _PATHS}


def test_the_scenario_runs_and_the_arm_arrives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module, scenario, _ = write_controller("law_that_runs", tmp_path)
    assert len(module.read_text().splitlines()) < 30
    monkeypatch.syspath_prepend(str(tmp_path))
    result = Run.open(simulate(load(scenario), tmp_path / "run").folder)
    assert abs(result.array("arm.q")[-1, 0] - 0.698) < 0.01


def test_its_test_passes_in_a_new_interpreter(tmp_path: Path) -> None:
    write_controller("law", tmp_path)
    call = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_law.py"]
    done = subprocess.run(
        call,
        cwd=tmp_path,
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout
    assert "1 passed" in done.stdout


@pytest.mark.parametrize("name", ["2nd", "my-law", "class", "", "a/b"])
def test_what_is_no_module_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ScenarioError, match="is not a valid name of a Python module"):
        write_controller(name, tmp_path)
    assert not list(tmp_path.iterdir())


def test_nothing_is_written_over(tmp_path: Path) -> None:
    (tmp_path / "test_law.py").write_text("mine")
    with pytest.raises(ScenarioError, match="exists already"):
        write_controller("law", tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["test_law.py"]


def test_the_commands_say_what_they_wrote(tmp_path: Path) -> None:
    app = Typer()
    app.command("new")(new)
    app.command("export")(export)
    runner = CliRunner()
    done = runner.invoke(app, ["new", "controller", "law", "--dir", str(tmp_path)])
    assert done.exit_code == 0
    assert "cosim run law.toml" in done.output
    config, out = ROOT / "configs" / "teleoperation.toml", tmp_path / "t.ssp"
    done = runner.invoke(app, ["export", str(config), "--ssp", str(out)])
    assert done.exit_code == 0, done.exception
    assert f"{out}  SSP 1.0, 4 FMUs, 2 links" in done.output
    assert isinstance(runner.invoke(app, ["export", str(config)]).exception, ScenarioError)
    assert isinstance(runner.invoke(app, ["new", "plant", "x"]).exception, ScenarioError)
