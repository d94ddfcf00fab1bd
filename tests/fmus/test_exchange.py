"""Plants as FMUs for model exchange: the motion of co-simulation, and their derivatives."""

from __future__ import annotations

import ctypes as c
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Model
from fmpy.fmi3 import FMU3Model
from fmpy.validation import validate_fmu
from typer.testing import CliRunner

from cosim.base.component import Port
from cosim.base.errors import FmuError
from cosim.engine import algebraic_loops
from cosim.engine.engine import Engine
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build as scenario
from fmus.build.archive import Version, find
from fmus.cli import app
from fmus.model import Model, exchanged
from fmus.models import arm, pd, planar2r, pointmass
from tests.cosim.algorithms.masses import Spring

VERSIONS: tuple[Version, ...] = ("2.0", "3.0")
EVERY = pytest.mark.parametrize("version", VERSIONS)
#: Start values and parameters of each plant, and inputs that are held.
PLANTS: dict[str, tuple[Model, dict[str, Any]]] = {
    "pointmass": (pointmass.model(), {"x": 0.3, "dx": -1.0, "m": 2.0, "b": 0.7, "f": 1.5}),
    "planar2r": (
        planar2r.model(),
        {"q": [0.4, -0.8], "dq": [1.0, -2.0], "theta_g": [3.0, 1.0], "k_p": [4.0, 3.0],
         "tau": [0.5, -0.2], "q_h": [0.1, 0.2], "q_w": [0.5, 9.0], "k_w": [50.0, 0.0]},
    ),
    "arm": (
        arm.model(3),
        {"q": [0.4, -0.8, 0.2], "dq": [1.0, -2.0, 0.5], "damping": [0.1, 0.2, 0.3],
         "tau": [0.5, -0.2, 0.1], "k_p": [4.0, 3.0, 2.0]},
    ),
}  # fmt: skip
PLANT = pytest.mark.parametrize("name", list(PLANTS))


def recorded(model: Model, version: Version, given: dict[str, Any], **keys: Any) -> np.ndarray:
    """Outputs of the first declaration after each of 500 steps of a millisecond."""
    outputs = [v.name for v in model.variables if v.causality == "output"]
    inputs = {v.name for v in model.variables if v.causality == "input"}
    component = {
        "model": str(find(model, version)), **keys,
        "parameters": {k: v for k, v in given.items() if k not in inputs},
        "start": {k: v for k, v in given.items() if k in inputs},
    }  # fmt: skip
    document = {"run": {"step": 1e-3, "stop": 0.5}, "components": {"x": component}}
    plan = assemble(scenario(document, Path("exchange.toml").absolute()))
    rows = np.empty((plan.ticks, plan.n_signals))
    with Engine(plan) as engine:
        engine.initialize()
        engine.run(plan.ticks, rows)
    slots = [plan.slots()[f"x.{name}"] for name in outputs]
    return np.hstack([rows[:, s.start : s.start + s.size] for s in slots])


@PLANT
@EVERY
def test_the_engine_integrates_it_to_the_motion_of_co_simulation(
    name: str, version: Version
) -> None:
    model, given = PLANTS[name]
    expected = recorded(model, version, given)
    found = recorded(exchanged(model), version, given, solver="rk4")
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert np.ptp(expected, axis=0).max() > 0.1


@PLANT
@EVERY
def test_cvode_takes_its_directional_derivatives(name: str, version: Version) -> None:
    model, given = PLANTS[name]
    expected = recorded(model, version, given)
    found = recorded(exchanged(model), version, given, solver="cvode", tolerance=1e-9)
    assert found == pytest.approx(expected, rel=1e-4, abs=1e-5)


@PLANT
@EVERY
def test_fmpy_finds_no_problem_and_simulates_it(name: str, version: Version) -> None:
    model, given = PLANTS[name]
    path = find(exchanged(model), version)
    assert validate_fmu(str(path)) == []
    start = {}
    for key, value in given.items():
        if isinstance(value, list) and version == "2.0":
            start |= {f"{key}[{i}]": x for i, x in enumerate(value)}
        else:
            start[key] = np.array(value) if isinstance(value, list) else value
    first = next(v.name for v in model.variables if v.name in ("x", "q"))
    output = f"{first}[0]" if version == "2.0" and first == "q" else first
    rows = fmpy.simulate_fmu(
        str(path), stop_time=0.499, output_interval=0.001, solver="CVode", relative_tolerance=1e-9,
        start_values=start, output=[output],
    )  # fmt: skip
    place = [v.name for v in model.variables if v.causality == "output"].index(first)
    assert place == 0
    end = np.ravel(rows[output][-1])[0]
    assert end == pytest.approx(recorded(model, version, given)[-1, 0], abs=1e-5)


def instance(path: Path, version: Version) -> Any:
    """An FMPy instance in Continuous-Time Mode, and the value references by name."""
    folder = fmpy.extract(str(path))
    description = fmpy.read_model_description(folder)
    kind = FMU2Model if version == "2.0" else FMU3Model
    x = kind(guid=description.guid, unzipDirectory=folder, instanceName="x",
             modelIdentifier=description.modelExchange.modelIdentifier)  # fmt: skip
    x.instantiate()
    if version == "2.0":
        x.setupExperiment()
    x.enterInitializationMode()
    return x, {v.name: v.valueReference for v in description.modelVariables}


@EVERY
def test_directional_derivatives_are_those_of_the_closed_form(version: Version) -> None:
    x, reference = instance(find(exchanged(pointmass.model()), version), version)
    set_, get = (x.setReal, x.getReal) if version == "2.0" else (x.setFloat64, x.getFloat64)
    set_([reference[k] for k in ("m", "b", "f", "dx")], [2.0, 0.5, 3.0, -1.0])
    x.exitInitializationMode()
    if version == "2.0":
        x.newDiscreteStates()
        x.enterContinuousTimeMode()
    else:
        x.updateDiscreteStates()
        x.enterContinuousTimeMode()
    known = [reference[k] for k in ("x", "dx", "f", "b_add")]
    found = np.array([
        x.getDirectionalDerivative([reference["dx"], reference["ddx"]], [k], [1.0]) for k in known
    ])  # fmt: skip
    # ddx = (f - (b + b_add) dx) / m
    assert found == pytest.approx(np.array([[0, 0], [1, -0.25], [0, 0.5], [0, 0.5]]), abs=1e-10)
    assert get([reference["ddx"]]) == [pytest.approx((3.0 + 0.5) / 2.0)]
    x.terminate()
    x.freeInstance()


@EVERY
def test_directional_derivatives_of_an_arm_are_those_of_central_differences(
    version: Version,
) -> None:
    model, given = PLANTS["planar2r"]
    x, reference = instance(find(exchanged(model), version), version)
    set_, get = (x.setReal, x.getReal) if version == "2.0" else (x.setFloat64, x.getFloat64)
    if version == "2.0":
        refer = {k: [reference[f"{k}[{i}]"] for i in range(2)] for k in ("q", "dq", "ddq", "tau_h")}
        for key, value in given.items():
            set_([reference[f"{key}[{i}]"] for i in range(2)], value)
    else:
        refer = {k: [reference[k]] for k in ("q", "dq", "ddq", "tau_h")}
        for key, value in given.items():
            set_([reference[key]], value)
    x.exitInitializationMode()
    x.newDiscreteStates() if version == "2.0" else x.updateDiscreteStates()
    x.enterContinuousTimeMode()
    states = np.array([*given["q"], *given["dq"]])
    values = c.c_double * 4

    def outputs(y: np.ndarray) -> np.ndarray:
        x.setContinuousStates(values(*y), 4)
        if version == "2.0":
            return np.array(get([*refer["ddq"], *refer["tau_h"]]))
        return np.array([*get(refer["ddq"], 2), *get(refer["tau_h"], 2)])

    for k in range(4):
        change = np.zeros(4)
        change[k] = 1e-6
        expected = (outputs(states + change) - outputs(states - change)) / 2e-6
        outputs(states)
        key, i = ("q", k) if k < 2 else ("dq", k - 2)
        if version == "2.0":
            found = x.getDirectionalDerivative(
                [*refer["ddq"], *refer["tau_h"]], [refer[key][i]], [1.0]
            )
        else:
            found = np.concatenate([
                x.getDirectionalDerivative(refer[u], refer[key], [float(i == 0), float(i == 1)],
                                           nSensitivity=2) for u in ("ddq", "tau_h")
            ])  # fmt: skip
        assert list(found) == pytest.approx(expected.tolist(), rel=1e-6, abs=1e-6)
    x.terminate()
    x.freeInstance()


def test_the_command_builds_plants_and_refuses_others(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["build", "pointmass", "--exchange", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert {p.name for p in tmp_path.iterdir()} == {
        "pointmass_exchange.fmi2.fmu", "pointmass_exchange.fmi3.fmu",
    }  # fmt: skip
    with pytest.raises(FmuError, match="pd gives no derivatives of its states"):
        exchanged(pd.model())
    both = CliRunner().invoke(app, ["build", "pd", "--exchange", "--clock", "5 ms"])
    assert both.exit_code != 0


@EVERY
def test_two_of_them_move_each_on_their_own(version: Version) -> None:
    mass = {"model": str(find(exchanged(pointmass.model()), version)), "solver": "rk4"}
    components = {
        name: {**mass, "parameters": {"b": 0.0, "dx": dx}} for name, dx in (("a", 1.0), ("b", -2.0))
    }
    document = {"run": {"step": 0.25, "stop": 1.0}, "components": components}
    plan = assemble(scenario(document, Path("exchange.toml").absolute()))
    with Engine(plan) as engine:
        engine.initialize()
        engine.run(plan.ticks)
        ends = [engine.signals[plan.slots()[f"{name}.x"].start] for name in "ab"]
    assert ends == pytest.approx([1.0, -2.0])


class SpringInNewtons(Spring):
    """The spring with the units of the point mass."""

    inputs = (Port("x1", (), "m"), Port("v1", (), "m/s"),
              Port("x2", (), "m"), Port("v2", (), "m/s"))  # fmt: skip
    outputs = (Port("force", (2,), "N"),)


@EVERY
def test_it_is_saved_and_restored_in_macro_steps(version: Version) -> None:
    """Two masses that push each other: the plants of model exchange, with rollback."""
    path = str(find(exchanged(pointmass.model()), version))
    spring = {"model": f"{__name__}:SpringInNewtons", "parameters": {"k": 4.0, "d": 0.0}}
    mass = {"model": path, "parameters": {"m": 1.0, "b": 0.0}, "solver": "rk4"}
    document = {
        "run": {"step": 0.1, "stop": 5.0, "algorithm": "adaptive", "adaptive": {"tolerance": 1e-5}},
        "components": {
            "a": {**mass, "parameters": {**mass["parameters"], "x": 1.0},
                  "inputs": {"f": "spring.force[0]"}},
            "b": {**mass, "inputs": {"f": "spring.force[1]"}},
            "spring": {**spring, "inputs": {"x1": "a.x", "v1": "a.dx", "x2": "b.x", "v2": "b.dx"}},
        },
    }  # fmt: skip
    plan = assemble(scenario(document, Path("exchange.toml").absolute()))
    rows = np.empty((plan.ticks, plan.n_signals))
    with Engine(plan) as engine:
        engine.initialize()
        engine.run(plan.ticks, rows)
    t = np.arange(plan.ticks) * plan.h
    expected = 0.5 + 0.5 * np.cos(np.sqrt(8.0) * t)  # the distance has the stiffness 2 k / m
    assert rows[:, plan.slots()["a.x"].start] == pytest.approx(expected, abs=1e-4)


@EVERY
@pytest.mark.parametrize("known", [True, False])
def test_its_directional_derivatives_solve_a_loop_at_the_start(
    version: Version, known: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """q_h = 2 tau_h and tau_h = -k_p (q - q_h): a loop in which iteration diverges."""
    given = []
    real = algebraic_loops.output_derivatives

    def counted(*arguments: Any) -> Any:
        given.append(real(*arguments) if known else None)
        return given[-1]

    monkeypatch.setattr(algebraic_loops, "output_derivatives", counted)
    arm_ = {
        "model": str(find(exchanged(planar2r.model()), version)),
        "parameters": {"q": [0.4, -0.8], "k_p": [4.0, 3.0]},
        "inputs": {"q_h": {"from": "gain.y", "gain": 1.0}},
        "solver": "rk4",
    }
    gain = {"model": f"{__name__}:Doubled", "inputs": {"u": "arm.tau_h"}}
    document = {
        "run": {"step": 1e-3, "stop": 1e-3, "algorithm": "adaptive"},
        "components": {"arm": arm_, "gain": gain},
    }
    plan = assemble(scenario(document, Path("exchange.toml").absolute()))
    with Engine(plan) as engine:
        engine.initialize()
        found = engine.signals[plan.slots()["arm.tau_h"].start :][:2]
    stiffness, q = np.array([4.0, 3.0]), np.array([0.4, -0.8])
    expected = -stiffness * q / (1.0 - 2.0 * stiffness)  # tau = -k (q - 2 tau)
    assert found == pytest.approx(expected, rel=1e-9)
    assert any(x is not None for x in given) == known


@pytest.mark.parametrize("exchange", [False, True])
@EVERY
def test_a_loop_through_its_feedthrough_is_solved_in_macro_steps(
    version: Version, exchange: bool
) -> None:
    """q_h = -2 tau_h and tau_h = -k_p (q - q_h): plain passes diverge, by 8 and 6."""
    model = exchanged(planar2r.model()) if exchange else planar2r.model()
    arm_ = {
        "model": str(find(model, version)),
        "parameters": {"q": [0.4, -0.8], "k_p": [4.0, 3.0]},
        "inputs": {"q_h": {"from": "gain.y", "gain": -1.0}},
    } | ({"solver": "rk4"} if exchange else {})
    gain = {"model": f"{__name__}:Doubled", "inputs": {"u": "arm.tau_h"}}
    document = {
        "run": {"step": 0.01, "stop": 0.5, "algorithm": "adaptive"},
        "components": {"arm": arm_, "gain": gain},
    }
    plan = assemble(scenario(document, Path("exchange.toml").absolute()))
    rows = np.empty((plan.ticks, plan.n_signals))
    with Engine(plan) as engine:
        engine.initialize()
        engine.run(plan.ticks, rows)
    tau, q = (rows[:, plan.slots()[f"arm.{name}"].start :][:, :2] for name in ("tau_h", "q"))
    assert np.ptp(q[:, 0]) > 0.01
    stiffness = np.array([4.0, 3.0])
    assert tau == pytest.approx(-stiffness * q / (1.0 + 2.0 * stiffness), rel=1e-4)


class Doubled:
    """y = 2 u at once, from N.m to rad."""

    kind = "continuous"
    inputs = (Port("u", (2,), "N.m"),)
    outputs = (Port("y", (2,), "rad"),)
    parameters = ()

    def initialize(self, values: Any) -> None:
        """Nothing to do."""

    def initial(self, u: Any) -> Any:
        return {"y": 2.0 * u["u"]}

    def step(self, t: float, h: float, u: Any) -> Any:
        return self.initial(u)

    def get_state(self) -> Any:
        """It has none."""

    def set_state(self, state: Any) -> None:
        """Nothing to do."""
