"""``cosim new``: what it writes runs, is rehearsed and passes its test as it is."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer import Typer
from typer.testing import CliRunner

from bridge.cli.new import new
from bridge.deployment.system import load_system
from bridge.results.outcome import run_twin
from bridge.scaffold import write_arm, write_controller
from cosim.base.errors import ScenarioError
from cosim.cli.export import export
from cosim.cli.options import flat
from cosim.engine.simulate import simulate
from cosim.loading.files import load
from cosim.record import Run
from tests.cli.command import CALL

ROOT = Path(__file__).resolve().parents[2]
ROBOTS = ROOT / "configs" / "robots"
_PATHS = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
ENVIRONMENT = os.environ | {"PYTHONPATH": _PATHS}


def test_the_scenario_runs_and_the_arm_arrives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module, scenario, *_ = write_controller("law_that_runs", tmp_path)
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
    assert "2 passed" in done.stdout  # alone, and with frames on a bus


@pytest.mark.slow
def test_it_is_rehearsed_as_it_is(tmp_path: Path) -> None:
    write_controller("law", tmp_path)
    call = [*CALL, "rehearse", "law.toml", "--out", "run", "--clock"]
    done = subprocess.run(
        [*call, "simulated"], cwd=tmp_path, env=ENVIRONMENT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "verdict          passed: every node finished" in done.stdout


@pytest.mark.parametrize(
    ("file", "ends"),
    [("six_axis", ("", "")), ("openarm_right", ("body", "hand")), ("fr3", ("", ""))],
)
def test_two_arms_of_a_file_come_together(tmp_path: Path, file: str, ends: tuple[str, str]) -> None:
    paths, missing = write_arm("arm", ROBOTS / f"{file}.urdf", tmp_path, *ends)
    names = [str(path.relative_to(tmp_path)) for path in paths]
    assert names == ["arm.toml", "test_arm.py", "deploy/arm.toml", "can/arm.dbc"] and not missing
    scenario = load(paths[0])
    run = Run.open(simulate(scenario, tmp_path / "run").folder)
    apart = run.array("slave.q") - run.array("master.q")
    assert np.abs(apart[-1]).max() < 0.02
    moved = np.abs(run.array("master.q")[-1] - run.array("master.q")[0])
    assert moved.max() > 0.2  # the operator has moved it
    system = load_system(paths[0], str(paths[2]), ["run.stop='0.2 s'"])
    assert set(system.nodes) == {"master", "slave", "master_control", "slave_control"}
    twin = Run.open(run_twin(system, tmp_path / "twin"))
    early = run.array("master.q")[: len(twin)]
    assert np.abs(twin.array("master.q")[-1] - early[-1]).max() < 0.02


def test_an_arm_without_a_bus_says_why(tmp_path: Path) -> None:
    text = (ROBOTS / "six_axis.urdf").read_text(encoding="utf-8")
    urdf = tmp_path / "sliding.urdf"
    urdf.write_text(text.replace('type="revolute"', 'type="prismatic"', 1), encoding="utf-8")
    paths, missing = write_arm("arm", urdf, tmp_path)
    assert [path.name for path in paths] == ["arm.toml", "test_arm.py"]
    assert missing.startswith("its messages have angles; prismatic: ")


def test_an_arm_with_several_ends_names_them(tmp_path: Path) -> None:
    text = (ROBOTS / "six_axis.urdf").read_text(encoding="utf-8")
    camera = (
        '<link name="camera"/><joint name="j_camera" type="fixed"><parent link="link3"/>'
        '<child link="camera"/></joint></robot>'
    )
    urdf = tmp_path / "camera.urdf"
    urdf.write_text(text.replace("</robot>", camera), encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"may end in camera, .*; expected --tip"):
        write_arm("arm", urdf, tmp_path)
    write_arm("arm", urdf, tmp_path, tip="link6")


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
    app.command("export")(flat(export))
    runner = CliRunner()
    done = runner.invoke(app, ["new", "controller", "law", "--dir", str(tmp_path)])
    assert done.exit_code == 0
    assert "cosim run law.toml" in done.output
    config, out = ROOT / "configs" / "teleoperation.toml", tmp_path / "t.ssp"
    done = runner.invoke(app, ["export", str(config), "--ssp", str(out)])
    assert done.exit_code == 0, done.exception
    assert f"{out}  4 FMUs, 2 links" in done.output
    assert isinstance(runner.invoke(app, ["export", str(config)]).exception, ScenarioError)
    for wrong in (["plant", "x"], ["arm", "x"], ["controller", "x", "--tip", "hand"]):
        assert isinstance(runner.invoke(app, ["new", *wrong]).exception, ScenarioError)
    file = str(ROBOTS / "six_axis.urdf")
    done = runner.invoke(app, ["new", "arm", "mine", "--urdf", file, "--dir", str(tmp_path)])
    assert done.exit_code == 0 and "cosim rehearse mine.toml" in done.output
