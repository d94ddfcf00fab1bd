"""Input tables in which a time stands twice: a jump, the habit of the FMI world. FMPy judges."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

from cosim.base.errors import CosimError
from cosim.engine.simulate import simulate
from cosim.loading.files import load
from cosim.record import Run
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from tests.cosim.fmi.plain import U, Y, described, export, real

#: As in the inputs of the Reference FMUs: from 0 to 1 at 1 s, from 1 to 3 at 2 s.
TABLE = "t,u\n0,0\n1,0\n1,1\n2,1\n2,3\n"


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    variables = [real("u", U, "input"), real("y", Y, "output")]
    text = described(variables).replace('StepSize="true"', 'StepSize="false"')  # no steps between
    return export(tmp_path_factory.mktemp("fmu") / "plain.fmu", text)


def outputs(fmu: Path, table: Path, stop: str, step: str = "0.5") -> list[float]:
    given = load(fmu, [f"run.stop={stop}", f"run.step={step}"], table)
    return Run.open(simulate(given, table.parent / "run").folder).column("plain2.y").tolist()


def test_from_the_time_of_a_jump_on_the_later_value_holds(fmu: Path, tmp_path: Path) -> None:
    """An output is that of the input at the step before: u(1) = 1, u(2) = 3."""
    (tmp_path / "jump.csv").write_text(TABLE)
    found = outputs(fmu, tmp_path / "jump.csv", "2.5")
    assert found == [0.0, 0.0, 0.0, 1.0, 1.0, 3.0]


def test_lines_before_and_after_a_jump_are_those_of_fmpy(fmu: Path, tmp_path: Path) -> None:
    rows = [(0, 0), (0.25, 1), (0.25, -1), (0.25, 5), (0.75, 6), (0.75, 0), (1, 1)]
    text = "".join(f"{t},{u}\n" for t, u in rows)
    (tmp_path / "jump.csv").write_text(f"time,u\n{text}")
    signals = np.array(rows, dtype=[("time", float), ("u", float)])
    theirs = fmpy.simulate_fmu(
        str(fmu), stop_time=1.0, output_interval=0.1, step_size=0.1, input=signals, output=["y"]
    )
    ours = outputs(fmu, tmp_path / "jump.csv", "1", "0.1")
    assert ours == pytest.approx(theirs["y"].tolist(), abs=1e-15)


def test_points_and_the_table_of_a_scenario_jump_too(fmu: Path, tmp_path: Path) -> None:
    (tmp_path / "jump.csv").write_text(TABLE)

    def ran(given: dict[str, Any]) -> list[float]:
        document = {
            "run": {"step": 0.5, "stop": 2.5},
            "components": {"m": {"model": str(fmu), "inputs": {"u": given}}},
        }
        found = simulate(build(document, tmp_path / "s.toml"), tmp_path / "run", force=True)
        return Run.open(found.folder).column("m.y").tolist()

    points = [[0, 0], [1, 0], [1, 1], [2, 1], [2, 3]]
    for interpolate in ("hold", "linear"):
        for given in ({"points": points}, {"table": "jump.csv"}):
            assert ran({**given, "interpolate": interpolate}) == [0.0, 0.0, 0.0, 1.0, 1.0, 3.0]


def test_times_that_go_back_are_refused(fmu: Path, tmp_path: Path) -> None:
    (tmp_path / "back.csv").write_text("t,u\n0,0\n1,0\n0.5,1\n")
    with pytest.raises(CosimError, match="not increasing"):
        assemble(load(fmu, ["run.stop=1"], tmp_path / "back.csv"))
