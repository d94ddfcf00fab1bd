"""Parameters from data: recovered values, intervals that hold, and what data cannot say."""

from __future__ import annotations

from math import isnan
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.base.errors import CosimError, ScenarioError
from cosim.engine.simulate import columns
from cosim.fitting.errors import errors_of
from cosim.fitting.fit import Fit, Fitting, measured
from cosim.fitting.varied import varied
from cosim.record import Run
from cosim.record.recording import Recording
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from cosim.schedule.plan import Plan
from cosim.study.memory import record
from fmus.models import planar2r
from tests.cli.command import Command
from tests.cli.conftest import cosim as cosim  # the command as a fixture
from tests.cosim.scenarios import document

TRUE = {"m": 2.0, "b": 0.7}
FORCE = {"points": [[0, 0], [0.5, 4], [1.0, -3], [2.0, 1]], "interpolate": "linear"}


def mass(twin: bool = False, **parameters: float) -> Plan:
    """A mass with friction that is pushed for 2 s; `twin`: and another one."""
    model = {"model": "fmus.models.pointmass", "parameters": {**TRUE, **parameters}}
    components: dict[str, Any] = {"mass": {**model, "inputs": {"f": FORCE}}}
    if twin:
        components["twin"] = model
    return assemble(build(document(components, step=0.02, stop=2.0), Path("test.toml")))


def data(noise: float = 0.0, seed: int = 0, every: int = 1) -> Recording:
    """What the true mass does, with errors of this standard deviation."""
    plan = mass()
    run = record(plan, columns(plan, ["mass.x"]))
    q = run.array("mass.x")[:, 0] + np.random.default_rng(seed).normal(0, noise, run.t.size)
    return Recording(Path("data.csv"), run.t[::every] + 0.0, {"x": q[::every]})


def fitted(recording: Recording, *vary: str, twin: bool = False, **start: float) -> Fit:
    plan = mass(twin, **start)
    signals = measured(plan, columns(plan, ["mass.x", "mass.dx"]), recording, {})
    return Fitting(plan, signals, recording.t, varied(plan, vary)).run()


def test_parameters_are_found_in_data_without_errors() -> None:
    found = fitted(data(), "m:0.5..5", "mass.b:0..2", m=3.0, b=0.1)
    assert found.converged
    assert [p.value for p in found.parameters] == pytest.approx([2.0, 0.7], rel=1e-6)
    before, after, unit = found.differences["mass.x"]
    assert before > 0.05 and after < 1e-8 and unit == "m"


def test_data_may_lie_between_the_ticks() -> None:
    found = fitted(data(every=7), "m:0.5..5", m=3.0)
    assert found.parameters[0].value == pytest.approx(2.0, rel=1e-6)


def test_an_interval_of_95_percent_holds_the_truth_about_that_often() -> None:
    held = np.zeros(2)
    for seed in range(60):
        found = fitted(data(0.01, seed), "m=2:1..4", "b=0.7:0..2")
        held += [
            abs(p.value - t) <= p.interval
            for p, t in zip(found.parameters, TRUE.values(), strict=True)
        ]
    assert (held >= 51).all() and held.sum() < 120  # 57 of 60 each on average


def slow_noise(n: int, seed: int, memory: float = 25.0) -> np.ndarray:
    """Noise (n,) of deviation 1 that is correlated over `memory` values."""
    a = np.exp(-1.0 / memory)
    w = np.random.default_rng(seed).normal(size=n)
    noise = np.empty(n)
    noise[0] = w[0]
    for k in range(1, n):
        noise[k] = a * noise[k - 1] + np.sqrt(1 - a * a) * w[k]
    return noise


def test_an_interval_holds_the_truth_with_errors_that_depend_on_each_other() -> None:
    """Of 40 intervals; those for independent errors hold the truth 24 times."""
    plan = mass()
    run = record(plan, columns(plan, ["mass.x"]))
    inside = 0
    for seed in range(20):
        x = run.array("mass.x")[:, 0] + 5e-3 * slow_noise(run.t.size, seed, 3.0)
        found = fitted(Recording(Path("data.csv"), run.t + 0.0, {"x": x}), "m:0.5..5", "b:0..2")
        for p, true in zip(found.parameters, (2.0, 0.7), strict=True):
            inside += abs(p.value - true) <= p.interval
        assert found.independent["mass.x"] < 60 < found.values
    assert inside >= 34, inside


def test_covariances_of_errors_are_those_of_the_process() -> None:
    found = errors_of(slow_noise(20_000, 1))
    share = found.covariance[:60] / found.covariance[0]
    assert share == pytest.approx(np.exp(-np.arange(60) / 25.0), abs=0.12)
    assert found.independent == pytest.approx(20_000 / 50, rel=0.3)
    J = np.random.default_rng(0).normal(size=(200, 3))
    short = errors_of(slow_noise(200, 2))
    apart = np.abs(np.subtract.outer(np.arange(200), np.arange(200)))
    assert short.spread(J) == pytest.approx(J.T @ short.covariance[apart] @ J)
    white = errors_of(np.random.default_rng(3).normal(size=5000))
    assert white.independent > 4000


def test_a_parameter_at_its_bound_has_no_interval() -> None:
    found = fitted(data(), "m:0.5..1.5")
    (m,) = found.parameters
    assert m.at_bound and m.value == 1.5 and isnan(m.interval)


def test_what_the_data_do_not_determine_is_said() -> None:
    found = fitted(
        data(), "mass.m:0.5..5", "twin.m=2:1..5", twin=True, m=3.0
    )  # nothing is measured of the twin
    m, twin = found.parameters
    assert m.value == pytest.approx(2.0, rel=1e-6) and m.interval < 1e-6
    assert isnan(twin.interval) and not twin.at_bound


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("m", "expected NAME:LOW..HIGH or NAME=START:LOW..HIGH"),
        ("m:1..x", "'x' is not a number"),
        ("m:2..1", "expected LOW below HIGH"),
        ("m=3:1..2", "the start 3 is not from 1 to 2"),
        ("n:1..2", "no parameter 'n'"),
        ("m[0]:1..2", "m[0] is outside of the shape []"),
        ("m:1..inf", "'inf' is not finite"),
    ],
)
def test_what_cannot_be_varied_is_refused(text: str, message: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        varied(mass(), [text])
    assert message in str(caught.value) and repr(text) in str(caught.value)


def test_refusals_of_data() -> None:
    plan = mass()
    known = columns(plan, ["mass.x"])
    wrong = Recording(Path("data.csv"), np.arange(3.0), {"z": np.zeros(3)})
    with pytest.raises(ScenarioError, match=r"the file has z, the scenario mass\.x"):
        measured(plan, known, wrong, {})
    with pytest.raises(ScenarioError, match="no column 'y'; there are: z"):
        measured(plan, known, wrong, {"mass.x": "y"})
    with pytest.raises(ScenarioError, match=r"found mass\.m more than once"):
        varied(plan, ["m:1..2", "mass.m:1..3"])
    short = Recording(Path("data.csv"), np.array([0.0, 1.0]), {"x": np.zeros(2)})
    with pytest.raises(CosimError, match="fewer measured values than parameters"):
        fitted(short, "m:1..3", "b:0..1")


def write_data(run: Run, u: Recording, path: Path) -> None:
    """Positions of a run, and the torques that moved it, as somebody measures them."""
    torques = [np.interp(run.t, u.t, u.columns[f"tau[{i}]"]) for i in (0, 1)]
    positions = [run.column(f"planar2r.q[{i}]") for i in (0, 1)]
    table = np.stack([run.t, *torques, *positions], axis=1)
    np.savetxt(
        path, table, delimiter=",", header="time,tau[0],tau[1],q[0],q[1]", comments="", fmt="%.17g"
    )


def test_the_command_fits_an_fmu_and_says_how_to_run_it(cosim: Command) -> None:
    path = Path("arm.fmu")
    path.write_bytes(planar2r.fmu("2.0").read_bytes())
    Path("u.csv").write_text("t,tau[0],tau[1]\n0,0,0\n0.2,5,1\n0.4,-3,2\n")
    run = ["run", "arm.fmu", "--no-plot", "--input", "u.csv", "--stop", "0.4"]
    assert cosim(*run, "--out", "data", "--set", "theta=[3.0, 1.1, 0.9]").code == 0
    write_data(Run.open("data"), Recording.read("u.csv"), Path("data.csv"))
    vary = ["--vary", "theta[0]:1..6", "--vary", "theta[2]:0.5..3"]
    start = ["--set", "theta=[3.3, 1.1, 1.0]"]
    done = cosim("fit", "arm.fmu", "data.csv", *vary, *start, "--json", "fit.json")
    assert (done.code, done.err) == (0, "")
    assert "planar2r.theta[0]  3.3" in done.out and "planar2r.q[1]" in done.out
    command = done.out.splitlines()[-1]
    assert command.startswith("with these values: cosim run arm.fmu --set 'theta=[")
    values = [float(x) for x in command.split("[")[1].split("]")[0].split(",")]
    assert values == pytest.approx([3.0, 1.1, 0.9], rel=1e-5)
    assert '"converged": true' in Path("fit.json").read_text()
    assert "no signal 'x'" in cosim.refused(
        "fit", "arm.fmu", "data.csv", "--vary", "theta[0]:1..6", "--match", "x=y"
    )
