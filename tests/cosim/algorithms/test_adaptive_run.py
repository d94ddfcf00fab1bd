"""Macro steps in the run folder, in the summary and the report, and in what ``cosim show`` says."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from cosim.base.errors import RunError
from cosim.cli.commands import app
from cosim.engine.simulate import simulate
from cosim.loading.files import load
from cosim.record import Run
from cosim.record.recover import complete
from tests.cosim.algorithms import masses

SCENARIO = """
title = "Two masses"
[run]
step = "0.1 s"
stop = {stop}
algorithm = "adaptive"
adaptive = {{ {settings} }}
[components.first]
model = "{model}"
start = {{ x0 = 1.0 }}
inputs = {{ force = "second.force" }}
[components.second]
model = "tests.cosim.algorithms.masses:MassWithSpring"
inputs = {{ x1 = "first.x", v1 = "first.v" }}
"""
BOND = 'bonds = [{ effort = "first.force", flow = "second.v1" }]'


def written(folder: Path, settings: str = "tolerance = 1e-3", stop: float = 5.0,
            model: str = "tests.cosim.algorithms.masses:Mass") -> Path:  # fmt: skip
    path = folder / "two.toml"
    path.write_text(SCENARIO.format(settings=settings, stop=stop, model=model))
    return path


def cosim(*arguments: object, status: int = 0) -> str:
    done = CliRunner().invoke(app, [str(a) for a in arguments])
    assert done.exit_code == status, done.output
    return done.output


def test_the_run_folder_says_which_steps_were_taken(tmp_path: Path) -> None:
    path = written(tmp_path, f"tolerance = 1e-3, {BOND}")
    said = cosim("run", path, "--out", tmp_path / "run", "--json", tmp_path / "said.json")
    run = Run.open(tmp_path / "run")
    (group,) = run.metadata["macro_steps"]
    assert group["components"] == ["first", "second"]
    steps, rejected = (run.column(f"first.macro_{what}") for what in ("steps", "rejections"))
    assert group["accepted"] == steps.sum() == sum(row["accepted"] for row in group["sizes"])
    assert group["rejected"] == rejected.sum() > 0
    assert sum(row["accepted"] * row["size"] for row in group["sizes"]) == pytest.approx(5.0)
    sizes = run.column("first.macro_size")
    assert run.units["first.macro_size"] == "s"
    assert sizes[1:].min() == min(row["size"] for row in group["sizes"] if row["accepted"])
    assert f"{'macro steps':22} {group['accepted']} of " in said
    assert f"{group['rejected']} repeated  first, second" in said
    assert json.loads((tmp_path / "said.json").read_text())["macro_steps"] == [group]
    report = (tmp_path / "run" / "report.html").read_text()
    assert "<h2>Macro steps</h2>" in report
    (bond,) = group["bonds"]
    energy = run.column(bond["signal"])
    assert bond["total"] == pytest.approx(energy.sum())
    assert bond["largest"] == np.abs(energy).max()
    assert "coupling energy" in said


def test_the_energy_that_the_coupling_makes_shrinks_with_the_tolerance(tmp_path: Path) -> None:
    found = []
    for tolerance in (1e-2, 1e-3, 1e-4):
        path = written(tmp_path, f"tolerance = {tolerance}, {BOND}")
        cosim("run", path, "--out", tmp_path / "run", "--force", "--no-plot", "--quiet")
        found.append(Run.open(tmp_path / "run").metadata["macro_steps"][0]["bonds"][0]["largest"])
    assert found[0] > 3.0 * found[1] > 9.0 * found[2] > 0.0


def test_steps_beyond_the_tolerance_are_reported(tmp_path: Path) -> None:
    path = written(tmp_path, 'tolerance = 1e-6, smallest = "50 ms"')
    said = cosim("run", path, "--out", tmp_path / "run", "--no-plot")
    assert "of the smallest size exceed the tolerance, by a factor of up to" in said
    assert "first at 0 s" in said


def test_show_says_who_steps_with_whom_and_what_the_inputs_are(tmp_path: Path) -> None:
    said = cosim("show", written(tmp_path, 'tolerance = 1e-3, smallest = "1 ms"'))
    assert "algorithm adaptive" in said
    assert "macro steps with second, at least 0.00156 s, tolerance 0.001" in said
    line = next(line for line in said.splitlines() if line.strip().startswith("first.force"))
    assert "mean of the values at both ends of each macro step" in line


def test_two_runs_have_the_same_bytes(tmp_path: Path) -> None:
    path = written(tmp_path)
    for name in ("one", "two"):
        cosim("run", path, "--out", tmp_path / name, "--no-plot", "--quiet")
    one, two = (Run.open(tmp_path / name) for name in ("one", "two"))
    for name in one.names:
        assert one.column(name).tobytes() == two.column(name).tobytes()
    assert one.metadata["macro_steps"] == two.metadata["macro_steps"]


def test_a_run_that_fails_in_a_trial_step_keeps_what_was_before(tmp_path: Path) -> None:
    path = written(tmp_path, model="tests.cosim.algorithms.trouble:BreakingMass")
    with pytest.raises(RunError, match=r"first: .*the mass is gone.* at tick 20 \(t = 2 s\)"):
        simulate(load(path), tmp_path / "run")
    run = Run.open(tmp_path / "run")
    exact = masses.exact(np.arange(21) * 0.1, start=(1.0, 0.0, 0.0, 0.0))
    assert run.column("first.x")[:21] == pytest.approx(exact[:, 0], abs=0.01)
    assert run.metadata["macro_steps"][0]["accepted"] > 0


@pytest.mark.filterwarnings("ignore::cosim.base.errors.CutShort")
def test_a_run_that_is_killed_keeps_its_rows(tmp_path: Path) -> None:
    path = written(tmp_path, stop=100_000.0)
    folder = tmp_path / "run"
    code = (
        "from cosim.engine.simulate import simulate; from cosim.loading.files import load; "
        f"from pathlib import Path; simulate(load(Path({str(path)!r})), {str(folder)!r})"
    )
    process = subprocess.Popen([sys.executable, "-c", code])
    try:
        until = time.monotonic() + 30.0
        while not _rows(folder):
            assert time.monotonic() < until
            time.sleep(0.2)
    finally:
        process.kill()
        process.wait()
    complete(folder)  # raises if the run is still active
    run = Run.open(folder)
    exact = masses.exact(np.arange(len(run)) * 0.1, start=(1.0, 0.0, 0.0, 0.0))
    assert len(run) > 0
    assert run.column("first.x") == pytest.approx(exact[:, 0], abs=0.01)


def _rows(folder: Path) -> int:
    """Rows that can be read by now."""
    try:
        return len(Run.open(folder))
    except Exception:  # the folder is being made
        return 0
