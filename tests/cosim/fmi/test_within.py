"""Intermediate update (FMI 3.0.2 §4.2.2): inputs that are lines within a step, and early return."""

from __future__ import annotations

import threading
from pathlib import Path
from time import monotonic

import numpy as np
import pytest

from cosim.base.errors import RunError
from cosim.engine.engine import Engine
from cosim.fmi import FmuComponent
from cosim.schedule.plan import Plan
from tests.cosim.fmi.exporter import export
from tests.cosim.fmi.test_slopes import COURSES, STEPS, H, expected
from tests.cosim.scenarios import plan

WITHIN = 'providesIntermediateUpdate="true"'
EARLY = (
    f'{WITHIN} canReturnEarlyAfterIntermediateUpdate="true" '
    'canHandleVariableCommunicationStepSize="true"'
)
ISOLATE = pytest.mark.parametrize("isolate", [False, True])


def within3(flags: str = WITHIN, of_u: str = 'intermediateUpdate="true"') -> str:
    values = "".join(
        f'<Float64 name="{name}" valueReference="{r}" causality="{causality}" {more}/>'
        for name, r, causality, more in (
            ("parts", 20, "parameter", 'variability="fixed" start="4"'),
            ("slow", 21, "parameter", 'variability="fixed" start="0"'),
            ("fails", 22, "parameter", 'variability="fixed" start="0"'),
            ("updates", 30, "output", ""), ("set", 31, "output", ""), ("reached", 32, "output", ""),
        )
    )  # fmt: skip
    return f"""<fmiModelDescription fmiVersion="3.0" modelName="within" instantiationToken="t">
<CoSimulation modelIdentifier="within3" {flags}/><ModelVariables>
<Float64 name="u" valueReference="0" causality="input" start="0 0" unit="m" {of_u}>
<Dimension start="2"/></Float64><Float64 name="x" valueReference="10" causality="output" unit="m">
<Dimension start="2"/></Float64>{values}</ModelVariables><ModelStructure/></fmiModelDescription>"""


@pytest.fixture(scope="module")
def within(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(within3(), tmp_path_factory.mktemp("fmu") / "within3.fmu")


def of(path: Path, algorithm: str, extrapolate: str = "linear", **component) -> Plan:
    x = {"model": str(path), "inputs": {"u": "a.y"}, "extrapolate": extrapolate, **component}
    return plan(
        {"a": {"model": COURSES}, "x": x}, algorithm=algorithm, step=H, stop=H * STEPS
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


@ISOLATE
@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel"])
def test_an_input_follows_its_line_within_the_step(within, algorithm: str, isolate: bool) -> None:
    """The same as an FMU of FMI 2.0 with the slope: `expected` is the closed form of that."""
    found = recorded(of(within, algorithm, isolate=isolate))
    assert found["x"] == pytest.approx(expected(algorithm == "jacobi"), abs=1e-12)
    assert found["set"][:, 0].tolist() == [8.0 * k for k in range(STEPS + 1)]
    assert found["updates"][:, 0].tolist() == [12.0 * k for k in range(STEPS + 1)]


@pytest.mark.parametrize("isolate", [False, True])
def test_an_input_that_is_held_is_not_set_within_the_step(within, isolate: bool) -> None:
    found = recorded(of(within, "jacobi", "hold", isolate=isolate))
    assert found["set"][-1] == 0.0 and found["updates"][-1] == 12.0 * STEPS


@pytest.mark.parametrize(
    ("flags", "of_u"),
    [("", 'intermediateUpdate="true"'), (WITHIN, "")],
)
def test_where_a_line_is_not_possible_the_input_is_its_mean(
    tmp_path, flags: str, of_u: str
) -> None:
    path = export(within3(flags, of_u), tmp_path / "x.fmu")
    assert FmuComponent(path).sloped == frozenset()
    assert recorded(of(path, "jacobi"))["set"][-1] == 0.0


def test_a_discrete_input_is_never_set_within_a_step(tmp_path: Path) -> None:
    of_u = 'intermediateUpdate="true" variability="discrete"'
    assert FmuComponent(export(within3(WITHIN, of_u), tmp_path / "x.fmu")).sloped == frozenset()


@ISOLATE
def test_an_input_that_is_refused_within_a_step_is_a_sentence(within, isolate: bool) -> None:
    with pytest.raises(
        RunError, match=r"setting inputs returned error \(no such input\) at tick 1"
    ):
        recorded(of(within, "jacobi", parameters={"fails": 1.0}, isolate=isolate))


@ISOLATE
def test_a_long_step_is_left_early_when_the_run_stops(tmp_path: Path, isolate: bool) -> None:
    path = export(within3(EARLY), tmp_path / "x.fmu")
    made = of(path, "jacobi", parameters={"slow": 1.0, "parts": 3000}, isolate=isolate)
    with Engine(made) as engine:
        engine.initialize()
        timer = threading.Timer(0.3, engine.stop)
        timer.start()
        begin = monotonic()
        record = np.zeros((STEPS, made.n_signals))
        rows = engine.run(STEPS, record)
        timer.join()
        assert monotonic() - begin < 15.0  # the step would take 30 s
        assert rows == 1 and engine.tick == 0
