"""Inputs as lines for FMUs of FMI 2.0 that take slopes (fmi2SetRealInputDerivatives)."""

from __future__ import annotations

import ctypes as c
from math import exp
from pathlib import Path

import numpy as np
import pytest
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

from cosim.base.component import Port
from cosim.base.errors import CosimError
from cosim.engine.engine import Engine
from cosim.engine.simulate import simulate
from cosim.scenario.spec import build
from cosim.schedule.plan import Plan
from tests.cosim.fmi.exporter import export, nasty2, sloped2
from tests.cosim.scenarios import plan

H = 0.25
STEPS = 16
COURSES = "tests.cosim.fmi.test_slopes:Courses"


class Courses:
    """Continuous: y = (1 + 2 t, t²) in km, n = the step it is."""

    kind = "continuous"
    inputs = ()
    outputs = (Port("y", (2,), "km"), Port("n"))
    parameters = ()

    def initialize(self, values):
        pass

    def initial(self, u):
        return {"y": courses(0.0) / 1000.0, "n": 0.0}

    def step(self, t, h, u):
        return {"y": courses(t + h) / 1000.0, "n": round((t + h) / h)}


def courses(t: float) -> np.ndarray:
    """What the input is at t (s), in m: (2,)."""
    return np.array([1.0 + 2.0 * t, t * t])


def lag(x: np.ndarray, u: np.ndarray, slope: np.ndarray, h: float = H) -> np.ndarray:
    """x' = u + slope (t - t_k) - x over a step, in closed form: (2,)."""
    decay = exp(-h)
    return decay * x + (1.0 - decay) * u + (h - 1.0 + decay) * slope


@pytest.fixture(scope="module")
def sloped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(sloped2(), tmp_path_factory.mktemp("fmu") / "sloped2.fmu")


def of(path: Path, algorithm: str = "jacobi", period: float = H, **component) -> Plan:
    """The courses into the FMU, as lines."""
    inputs = {"u": "a.y", "count": "a.n", "held": "a.n"}
    x = {"model": str(path), "inputs": inputs, "extrapolate": "linear", "period": period}
    return plan(
        {"a": {"model": COURSES}, "x": {**x, **component}},
        algorithm=algorithm, step=H, stop=H * STEPS,
    )  # fmt: skip


def recorded(made: Plan) -> dict[str, np.ndarray]:
    """Every port of `x` at the start and after every tick: (STEPS + 1, scalars)."""
    with Engine(made) as engine:
        engine.initialize()
        rows = [engine.signals.copy()]
        for _ in range(STEPS):
            engine.run(1)
            rows.append(engine.signals.copy())
    slots = (s for s in made.slots().values() if s.component == "x")
    return {s.port: np.array(rows)[:, s.start : s.start + s.size] for s in slots}


def expected(ahead: bool) -> np.ndarray:
    """The recursion of closed forms: (STEPS + 1, 2)."""
    x, last = [np.zeros(2)], courses(0.0)
    for k in range(STEPS):
        here, there = courses(k * H), courses((k + 1) * H)
        slope = (here - last if ahead else there - here) / H
        x.append(lag(x[-1], here, slope))
        last = here
    return np.array(x)


@pytest.mark.parametrize("algorithm", ["jacobi", "sampled", "gauss-seidel"])
def test_value_and_slope_are_those_where_the_step_begins(sloped: Path, algorithm: str) -> None:
    found = recorded(of(sloped, algorithm))
    ahead = algorithm != "gauss-seidel"
    assert found["x"] == pytest.approx(expected(ahead), abs=1e-12)
    first = 2 if ahead else 1
    assert found["slope"][first:, 0] == pytest.approx(2.0, abs=1e-12)
    assert found["slopes"][:, 0].tolist() == [2.0 * k for k in range(STEPS + 1)]


def test_between_two_known_ends_a_line_is_solved_without_error(sloped: Path) -> None:
    """x' = 1 + 2 t - x from 0: x = 2 t - 1 + exp(-t)."""
    t = H * np.arange(STEPS + 1)
    found = recorded(of(sloped, "gauss-seidel"))["x"][:, 0]
    assert found == pytest.approx(2.0 * t - 1.0 + np.exp(-t), abs=1e-12)


def test_who_takes_no_slopes_is_given_means(tmp_path: Path, sloped: Path) -> None:
    found = recorded(of(export(sloped2(""), tmp_path / "x.fmu"), "gauss-seidel"))
    assert found["slopes"][-1] == 0.0
    x = np.zeros(2)
    for k in range(STEPS):
        mean = (courses(k * H) + courses((k + 1) * H)) / 2.0
        x = lag(x, mean, np.zeros(2))
        assert found["x"][k + 1] == pytest.approx(x, abs=1e-12)
    t = H * STEPS
    exact = 2.0 * t - 1.0 + exp(-t)
    assert abs(found["x"][-1, 0] - exact) > 1e-3


def test_discrete_and_integer_inputs_are_not_sloped(sloped: Path) -> None:
    component = of(sloped).component("x").component
    assert component.sloped == {"u"}
    held = recorded(of(sloped, inputs={"u": "a.y"}))
    assert held["slopes"][-1] == 2 * STEPS


def test_what_is_held_has_no_slope(sloped: Path) -> None:
    found = recorded(of(sloped, extrapolate="hold"))
    assert found["slopes"][-1] == 0.0
    assert found["x"][1] == pytest.approx(lag(np.zeros(2), courses(0.0), np.zeros(2)))


def test_slower_than_its_source_it_has_the_slope_over_its_own_step(sloped: Path) -> None:
    found = recorded(of(sloped, "gauss-seidel", period=4 * H))
    t = 4 * H * np.arange(STEPS // 4 + 1)
    assert found["x"][::4, 0] == pytest.approx(2.0 * t - 1.0 + np.exp(-t), abs=1e-12)
    assert found["slope"][4::4, 0] == pytest.approx(2.0, abs=1e-12)


def test_in_a_process_of_its_own_it_is_the_same_to_the_bit(sloped: Path) -> None:
    here, there = recorded(of(sloped)), recorded(of(sloped, isolate=True))
    assert {k: v.tobytes() for k, v in here.items()} == {k: v.tobytes() for k, v in there.items()}


def test_the_same_calls_by_fmpy_give_the_same_bits(sloped: Path) -> None:
    fed = recorded(of(sloped))
    description = read_model_description(str(sloped), validate=False)
    fmu = FMU2Slave(
        guid=description.guid, unzipDirectory=extract(str(sloped)), modelIdentifier="sloped2"
    )
    fmu.instantiate()
    fmu.setupExperiment(startTime=0.0)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    references, orders = (c.c_uint32 * 2)(0, 1), (c.c_int32 * 2)(1, 1)
    last = courses(0.0) / 1000.0 * 1000.0
    for k in range(STEPS):
        value = fed["u"][k + 1]
        slope = (c.c_double * 2)(*((value - last) / H))
        fmu.setReal([0, 1], list(value))
        fmu.fmi2SetRealInputDerivatives(fmu.component, references, 2, orders, slope)
        fmu.doStep(currentCommunicationPoint=k * H, communicationStepSize=H)
        assert np.array(fmu.getReal([10, 11])).tobytes() == fed["x"][k + 1].tobytes()
        last = value
    fmu.terminate()
    fmu.freeInstance()


def test_a_refused_slope_stops_the_run_with_what_the_fmu_said(sloped: Path) -> None:
    with pytest.raises(CosimError, match=r"x: .*a slope of 2\.\d+.* at tick"):
        recorded(of(sloped, parameters={"most": 2.1}))


def test_a_binary_without_the_function_it_promises_is_refused(tmp_path: Path) -> None:
    promising = nasty2('canInterpolateInputs="true"').replace('unit="Nm"', "")
    path = export(promising, tmp_path / "x.fmu")
    with pytest.raises(CosimError, match="the binary lacks fmi2SetRealInputDerivatives"):
        recorded(of(path, inputs={"u": "a.n"}))


def test_a_scenario_runs_with_it(sloped: Path, tmp_path: Path) -> None:
    components = {
        "a": {"model": COURSES},
        "x": {"model": str(sloped), "inputs": {"u": "a.y"}, "extrapolate": "linear"},
    }
    document = {"run": {"step": H, "stop": 4.0}, "components": components}
    simulate(build(document, tmp_path / "it.toml"), tmp_path / "run")
    assert (tmp_path / "run" / "run.json").is_file()
