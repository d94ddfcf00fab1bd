"""An FMU that ends the simulation: the run is complete, finished, and reports it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from cosim.cli.commands import app
from cosim.engine.memory_run import trace
from cosim.engine.simulate import columns
from cosim.loading.files import load
from cosim.record import Run
from cosim.record.folder import read_metadata
from cosim.scenario.assemble import assemble
from cosim.study.memory import record
from tests.cosim.fmi.exporter import export, strict2, strict3

ENDS, EVENT = 6, 7


def scenario(folder: Path, fmi: str, how: int, when: float, kind: str = "continuous") -> Path:
    """One strict FMU, and plants that go on: their steps come before its, and after."""
    text = strict2() if fmi == "2.0" else strict3('hasEventMode="true"')
    export(text, folder / "strict.fmu")
    path = folder / "s.toml"
    path.write_text(
        f"""
[run]
step = 0.1
stop = 1.0
[components.other]
model = "strict.fmu"
start = {{ u = 1.0 }}
[components.x]
model = "strict.fmu"
kind = "{kind}"
parameters = {{ how = {how}, when = {when} }}
inputs = {{ u = "other.y" }}
[components.z]
model = "strict.fmu"
start = {{ u = 1.0 }}
"""
    )
    return path


def run(path: Path, out: Path) -> tuple[str, Run]:
    result = CliRunner().invoke(app, ["run", str(path), "--out", str(out)])
    assert result.exit_code == 0, result.output
    return result.output, Run.open(out)


CASES = pytest.mark.parametrize(
    ("fmi", "how", "when", "kind", "time", "rows"),
    [
        ("2.0", ENDS, 0.25, "continuous", 0.325, 4),  # its step was not done: t = 0.3 is the last
        ("2.0", ENDS, 0.25, "sampled", 0.325, 4),
        ("2.0", ENDS, -1.0, "sampled", 0.025, 1),
        ("3.0", ENDS, 0.25, "continuous", 0.35, 5),  # its step was done: everybody's is
        ("3.0", ENDS, 0.25, "sampled", 0.35, 5),
        ("3.0", EVENT, 0.25, "continuous", 0.4, 5),
        ("3.0", EVENT, -1.0, "continuous", 0.0, 1),
    ],
)


@CASES
def test_a_run_ends_where_an_fmu_ends_it(tmp_path, fmi, how, when, kind, time, rows) -> None:
    path = scenario(tmp_path, fmi, how, when, kind)
    said, found = run(path, tmp_path / "run")
    assert f"ended by x at t = {time:g} s, of 1 s" in said
    assert found.t == pytest.approx([0.1 * k for k in range(rows)])
    assert read_metadata(tmp_path / "run")["ended"] == {
        "component": "x",
        "time": pytest.approx(time),
    }
    assert read_metadata(tmp_path / "run")["error"] is None
    expected = [1.0 + 0.2 * k for k in range(rows)]
    assert found.column("other.y") == pytest.approx(expected)
    assert found.column("z.y") == pytest.approx(expected)


@CASES
def test_a_run_in_memory_ends_there_as_well(tmp_path, fmi, how, when, kind, time, rows) -> None:
    path = scenario(tmp_path, fmi, how, when, kind)
    _, expected = run(path, tmp_path / "run")
    loaded = load(path)
    found = record(assemble(loaded), columns(assemble(loaded)))
    assert np.array_equal(found.t, expected.t)
    for name in expected.names:
        assert np.array_equal(found.array(name)[:, 0], expected.column(name))
    assert trace(assemble(loaded), ["other.y"]).stopped.startswith("ended by x at t = ")
