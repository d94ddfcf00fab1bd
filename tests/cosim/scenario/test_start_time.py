"""A run from another time than 0: everything that has a time counts from there, as in FMPy."""

from __future__ import annotations

import base64
import zipfile
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

import cosim
from bridge.deployment.system import load_system
from cosim.base.component import Port
from cosim.base.errors import ScenarioError
from cosim.checks.preflight import check
from cosim.linear.scenario import linearized
from cosim.loading.files import load
from cosim.record import Run
from cosim.reporting.run_report import write_report
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from cosim.ssp.export import write
from tests.bridge.deployments import TELEOPERATION
from tests.cosim.fmi.plain import TIME, P, U, Y, described, export, real
from tests.cosim.reporting.test_report import data as page_data
from tests.cosim.reporting.test_report import decoded
from tests.system.runs import run as simulated
from tests.system.runs import teleoperation

VARIABLES = (
    real("u", U, "input"), real("p", P, "parameter"), real("y", Y, "output"),
    real("now", TIME, "output"),
)  # fmt: skip
FIVE = '<DefaultExperiment startTime="5" stopTime="6" stepSize="0.1"/>'


def fmu(folder: Path, experiment: str = FIVE, name: str = "late.fmu") -> Path:
    """An FMU whose output `now` is its time, and y = u + p."""
    return export(folder / name, described(VARIABLES, experiment=experiment))


def ran(source: Any, folder: Path, **how: Any) -> Run:
    cosim.run(source, out=folder / "run", **how)
    return Run.open(folder / "run")


def test_one_fmu_runs_from_the_start_of_its_default_experiment_as_in_fmpy(tmp_path: Path) -> None:
    path = fmu(tmp_path)
    run = ran(path, tmp_path)
    theirs = fmpy.simulate_fmu(str(path), output=["now"], use_event_mode=False)
    assert np.allclose(run.t, theirs["time"], rtol=0, atol=1e-12)
    assert np.allclose(run.column("plain2.now"), theirs["now"], rtol=0, atol=1e-12)
    assert np.array_equal(run.t, 5.0 + 0.1 * np.arange(11))
    assert not [f for f in check(load(path), assemble(load(path))) if f.rule == "start"]


@pytest.mark.parametrize("isolate", [False, True])
def test_tables_and_events_are_in_the_time_of_the_run(tmp_path: Path, isolate: bool) -> None:
    path = fmu(tmp_path)
    table = tmp_path / "u.csv"
    table.write_text("time,u\n0,0\n5.5,11\n10,20\n")
    line = np.interp([5.0, 5.2, 5.4, 5.6, 5.8], [0, 5.5, 10], [0, 11, 20])
    for name, given, expected in (
        ("a", {"table": str(table), "interpolate": "linear"}, line),
        ("b", {"points": [[-1.0, 3.0], [5.4, 4.0]]}, [3, 3, 4, 4, 4]),
    ):
        document = {
            "run": {"start": 5.0, "stop": "6 s", "step": 0.2},
            "components": {
                "m": {"model": str(path), "inputs": {"u": given}, "isolate": isolate},
                "free": {"model": str(path), "isolate": isolate},
            },
            "events": [{"at": 5.6, "set": {"free.u": 7.0}}],
        }
        run = ran(document, tmp_path / name)
        assert np.allclose(run.column("m.y")[1:], expected, rtol=0, atol=1e-9)
        assert run.column("free.y")[1:].tolist() == [0, 0, 0, 7, 7]
        assert np.allclose(run.column("m.now"), run.t, rtol=0, atol=1e-12)


@pytest.mark.parametrize("algorithm", ["sampled", "jacobi", "gauss-seidel", "adaptive"])
def test_python_components_get_the_time_of_the_run(tmp_path: Path, algorithm: str) -> None:
    document = {
        "run": {"start": -2.0, "stop": -1.0, "step": 0.25, "algorithm": algorithm},
        "components": {"c": {"model": f"{__name__}:Clock"}},
    }
    run = ran(document, tmp_path)
    assert run.t.tolist() == [-2.0, -1.75, -1.5, -1.25, -1.0]
    assert run.column("c.t").tolist()[1:] == [-2.0, -1.75, -1.5, -1.25]
    assert run.metadata["start"] == -2.0


class Clock:
    """Its output is the time at which its last step began."""

    kind = "continuous"
    inputs = parameters = ()
    outputs = (Port("t", (), "s"),)

    def initialize(self, values: Any) -> None:
        """There is nothing to start."""

    def initial(self, inputs: Any) -> dict[str, Any]:
        """Before the first step."""
        return {"t": np.nan_to_num(0.0)}

    def step(self, t: float, h: float, inputs: Any) -> dict[str, Any]:
        """The time of the step."""
        return {"t": t}

    def get_state(self) -> None:
        """It has none."""

    def set_state(self, state: None) -> None:
        """It has none."""


def test_what_begins_before_or_ends_too_soon_is_refused(tmp_path: Path) -> None:
    components = {"m": {"model": str(fmu(tmp_path))}}
    run = {"start": 5.0, "stop": 6.0, "step": 0.1}
    event = {"at": 1.0, "set": {"m.u": 1.0}}
    for document, message in (
        ({"run": {**run, "stop": 3.0}}, "found 5 s, expected a time before run.stop, 3 s"),
        ({"run": run, "events": [event]}, "expected 5 s or more, where the run starts"),
        ({"run": {**run, "start": 5.05}}, "0.95 s is not a multiple of the base step"),
        ({"run": run, "bus": {"can0": {"bitrate": 500_000}}}, "simulated buses (can0)"),
    ):
        with pytest.raises(ScenarioError) as caught:
            assemble(build({"components": components, **document}, tmp_path / "s.toml"))
        assert message in str(caught.value)


def test_nodes_begin_at_0(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="expected 0 with a deployment: its nodes begin at 0"):
        load_system(TELEOPERATION, "can", ["run.start=1 s"])


def test_an_ssp_has_it_in_its_default_experiment(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text(
        f'[run]\nstart = 5.0\nstop = 6.0\nstep = 0.1\n[components.m]\nmodel = "{fmu(tmp_path)}"\n'
    )
    write(load(path), assemble(load(path)), tmp_path / "s.ssp")
    with zipfile.ZipFile(tmp_path / "s.ssp") as archive:
        text = archive.read("SystemStructure.ssd").decode()
    assert 'startTime="5.0" stopTime="6.0"' in text
    assert ran(tmp_path / "s.ssp", tmp_path).t[[0, -1]].tolist() == [5.0, 6.0]


def test_one_recorded_signal_needs_no_brackets(tmp_path: Path) -> None:
    for given, names in (("all", {"u", "p", "y", "now"}), ("now", {"now"})):
        settings = {"run.record.signals": given}
        run = ran(fmu(tmp_path), tmp_path / given, set=settings)
        assert {name.removeprefix("plain2.") for name in run.names} == names


def test_a_scenario_with_an_fmu_that_begins_elsewhere_is_told_so(tmp_path: Path) -> None:
    path = fmu(tmp_path)
    document = {"run": {"stop": 1.0, "step": 0.1}, "components": {"m": {"model": str(path)}}}
    found = []
    for start in (0.0, 5.0):
        document["run"] |= {"start": start, "stop": start + 1.0}
        loaded = build(document, tmp_path / "s.toml")
        found.append([f for f in check(loaded, assemble(loaded)) if f.rule == "start"])
    (said,), nothing = found
    assert said.reason == (
        "the DefaultExperiment of the FMU begins at 5 s, the run goes from 0 s to 1 s"
    )
    assert said.advice == "set run.start = 5, unless the model does not depend on the time"
    assert not nothing


def test_an_operating_point_is_a_time_of_the_run(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text(
        "[run]\nstart = 5.0\nstop = 6.0\nstep = 0.1\n[components.m]\n"
        f'model = "{fmu(tmp_path)}"\nkind = "sampled"\n'
    )
    with pytest.raises(ScenarioError, match="expected a time of the run, 5 to 6 s"):
        linearized(path, time=1.0)
    assert linearized(path, time=5.5, inputs=["m.u"], outputs=["m.y"]).time == pytest.approx(5.5)


def test_a_sweep_over_the_start(tmp_path: Path) -> None:
    """A run that goes back to the start of another begins at its own time."""
    (tmp_path / "s.toml").write_text(
        "[run]\nstop = 9.0\nstep = 0.1\n[components.m]\n"
        f'model = "{fmu(tmp_path)}"\n'
        '[metrics.first]\nkind = "error"\nof = ["m.y"]\ntarget = [0.0]\nwithin = 1.0\n'
    )
    (tmp_path / "study.toml").write_text(
        'scenario = "s.toml"\n[vary.start]\npath = "run.start"\nvalues = [5.0, 0.0, 8.0]\n'
    )
    swept = cosim.sweep(tmp_path / "study.toml", tmp_path / "swept", jobs=1)
    assert sorted(row["first.settle_s"] for row in swept.records) == [0.0, 5.0, 8.0]


def test_links_count_from_the_start_and_the_report_begins_there(tmp_path: Path) -> None:
    """Nothing of the teleoperator depends on the time: its run is the same, 2 s later."""
    runs = []
    for start in (0.0, 2.0):
        document = teleoperation(stop=start + 1.0)
        document["run"]["start"] = start
        runs.append(simulated(document, tmp_path / f"{start:g}"))
    at_0, later = runs
    assert np.allclose(later.t, at_0.t + 2.0, rtol=0, atol=1e-12)
    for name in at_0.names:
        assert np.array_equal(at_0.column(name), later.column(name))
    drawn = page_data(write_report(later).read_text(encoding="utf-8"))
    assert (drawn["begin"], drawn["start"], drawn["end"]) == (2.0, 2.0, 3.0)
    t, _ = decoded(drawn["signals"]["master.q[0]"])  # from where the page begins
    assert t[0] == 0.0 and t[-1] == pytest.approx(1.0)
    frames = np.frombuffer(base64.b64decode(drawn["arms"][0]["q"][0]), "<f4")
    assert len(frames) == pytest.approx(1.0 / drawn["frame"], abs=2)
    assert frames[-1] == pytest.approx(later.column("master.q[0]")[-1], rel=1e-5)
