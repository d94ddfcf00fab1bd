"""A missing wire is reported by every command, and is an error with --strict."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from cosim.base.component import Port
from cosim.checks.wiring import unconnected_inputs
from cosim.cli.commands import app
from cosim.loading.files import load
from cosim.scenario.assemble import assemble
from fmus.models import planar2r, teleoperation
from tests.cosim.fmi.exporter import export, strict2

CONFIGS = Path("configs").resolve()
SCENARIO = CONFIGS / "teleoperation.toml"
FORGOTTEN = 'components.master_control.inputs={q="master.q"}'
SAID = "warning: master_control.dq: the input is unconnected, and the scenario sets no start value"


def run(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, list(arguments))
    return result.exit_code, f"{result.output} {result.exception or ''}"


def commands(folder: Path) -> dict[str, list[str]]:
    """Every command that runs, or says how something will; the study sets what others are told."""
    study = folder / "study.toml"
    study.write_text(
        f"scenario = \"{SCENARIO}\"\nsettings = ['{FORGOTTEN}', 'run.stop=0.01']\n"
        '[vary.k]\npaths = ["components.master.parameters.k_p"]\nvalues = [1, 2]\n'
    )
    out = ["--out", str(folder / "out")]
    change = ["--set", FORGOTTEN, "--set", "run.stop=0.05"]
    return {
        "run": ["run", str(SCENARIO), *change, "--no-plot", *out],
        "twin": ["run", str(SCENARIO), *change, "--no-plot", *out, "--deploy", "can"],
        "show": ["show", str(SCENARIO), *change],
        "sweep": ["sweep", str(study), "--no-plot", "--workers", "threads", *out],
        "compare": ["compare", str(SCENARIO), "--controllers", "forgetful",
                    "--variants", str(forgetful(folder)), "--no-plot", *out],
        "rehearse": ["rehearse", str(SCENARIO), *change, *out],
    }  # fmt: skip


@pytest.mark.parametrize(("count", "lines"), [(12, 12), (13, 1)])
def test_the_same_of_many_robots_is_said_once(count: int, lines: int, tmp_path: Path) -> None:
    """With the advice for the first; a line for each of those that a sentence would name."""
    path = tmp_path / "many.toml"
    path.write_text(
        '[run]\nstep = "1 ms"\nstop = "2 ms"\n[components.robot]\n'
        f'count = {count}\nmodel = "fmus.models.planar2r"\npreset = "SL91"\n'
    )
    for command in ("run", "sweep"):
        code, said = run(*arguments(command, path, tmp_path / command))
        found = [line for line in said.splitlines() if "unconnected" in line]
        assert code == 0 and len(found) == lines, said
        if lines == 1:
            assert "robot1.tau, robot2.tau, robot3.tau, robot4.tau and 9 more: " in found[0]
    _, said = run("check", str(path))
    assert f"{lines} warning" in said and "components.robot1.inputs.tau" in said


def arguments(command: str, scenario: Path, out: Path) -> list[str]:
    if command == "run":
        return ["run", str(scenario), "--no-plot", "--out", str(out)]
    study = scenario.with_name("study.toml")
    study.write_text(f'scenario = "{scenario}"\n[vary.seed]\npath = "run.seed"\nvalues = [1, 2]\n')
    return ["sweep", str(study), "--no-plot", "--workers", "threads", "--out", str(out)]


def forgetful(folder: Path) -> Path:
    """Variants with a controller whose wire is forgotten."""
    path = folder / "variants.toml"
    path.write_text(
        """
set = ["run.step=5 ms", "run.stop=0.05 s"]
[roles.master]
arm = "master"
controller = "master_control"
[roles.slave]
arm = "slave"
controller = "slave_control"
[wiring]
inputs = { q = "arm.q" }
drives = { tau = "controller.tau" }
[controllers.forgetful]
model = "fmus.models.pd"
preset = "PD(10,4)"
receives = { q_j = "arm.q", dq_j = "arm.dq" }
[operators.light]
master = { k_p = 10.0, k_d = 5.0 }
[links.constant]
delay = { law = "constant", delay = "100 ms" }
[columns.effort]
kind = "norm"
of = ["master.tau_h"]
[stable]
position = ["master.q", "slave.q"]
velocity = ["master.dq", "slave.dq"]
position_limit = 100.0
velocity_limit = 200.0
rest = 0.01
window = 0.01
[figure]
y = ["master.q[0]", "slave.q[0]"]
"""
    )
    return path


@pytest.mark.parametrize("command", ["run", "twin", "show", "sweep", "compare"])
def test_a_forgotten_wire_is_said(tmp_path: Path, command: str) -> None:
    code, said = run(*commands(tmp_path)[command])
    assert SAID in said
    assert code == 0, said


@pytest.mark.parametrize("command", ["run", "twin", "show", "sweep", "compare", "rehearse"])
def test_it_is_an_error_with_strict(tmp_path: Path, command: str) -> None:
    code, said = run(*commands(tmp_path)[command], "--strict")
    assert code != 0
    assert SAID in said
    assert not (tmp_path / "out").exists()


def test_what_a_model_declares_optional_goes_unsaid() -> None:
    for fmi in ("2.0", "3.0"):
        plan = assemble(
            load(SCENARIO, [f'components.{n}.fmi="{fmi}"' for n in ("master", "slave")])
        )
        assert not list(unconnected_inputs(plan))
    optional = {p.name for m in (planar2r, teleoperation) for p in m.model().inputs() if p.optional}
    assert optional == {"tau_ext", "q_h", "grip", "w", "age"}
    assert not Port("u").optional


def test_inputs_of_other_tools_are_said_whatever_their_start(tmp_path: Path) -> None:
    export(strict2(), tmp_path / "strict.fmu")
    path = tmp_path / "s.toml"
    path.write_text('[run]\nstep = 0.1\nstop = 1\n[components.x]\nmodel = "strict.fmu"\n')
    assert [f.where for f in unconnected_inputs(assemble(load(path)))] == ["x.u"]
    assert not list(unconnected_inputs(assemble(load(path, ["components.x.start.u=0"]))))
