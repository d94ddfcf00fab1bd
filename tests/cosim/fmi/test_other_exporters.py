"""FMUs that PythonFMU (FMI 2.0) and PythonFMU3 (FMI 3.0) made: exact, here and isolated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.base.errors import RunError
from cosim.fmi import FmuOptions
from tests.cosim.fmi.exporter import column, plan_of, run

SLAVES = Path(__file__).parent / "slaves"
STEPS, H = 200, 0.01


@pytest.fixture(scope="module", params=["pythonfmu", "pythonfmu3"])
def fmu(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    builder = pytest.importorskip(f"{request.param}.builder", reason="not installed")
    two = request.param == "pythonfmu"
    script = SLAVES / ("oscillator.py" if two else "oscillator3.py")
    folder = tmp_path_factory.mktemp(request.param)
    build = builder.FmuBuilder.build_FMU
    return Path(build(str(script), dest=folder))


def expected(k: float, u: np.ndarray) -> list[float]:
    x, v, found = 1.0, 0.0, [1.0]
    for force in u.tolist():
        v += H * (force - k * x)
        x += H * v
        found.append(x)
    return found


@pytest.mark.parametrize("isolate", [False, True])
def test_it_runs_to_the_last_bit(fmu: Path, isolate: bool) -> None:
    u = np.sin(np.arange(STEPS) * 0.1)
    plan = plan_of(fmu, STEPS, h=H, values={"k": (9.0,)}, options=FmuOptions(isolate=isolate))
    rows, engine = run(plan, {"u": u})
    with engine:
        assert column(plan, rows, "x").tolist() == expected(9.0, u)
        assert column(plan, rows, "n")[-1] == STEPS
        assert set(column(plan, rows, "up").tolist()) == {0.0, 1.0}
        assert engine.texts() == ({"x.who": ["me"]} if "x.who" in engine.texts() else {})


@pytest.mark.parametrize("isolate", [False, True])
def test_its_exceptions_are_a_sentence(fmu: Path, isolate: bool) -> None:
    plan = plan_of(
        fmu, 3, h=H, values={"k": (-1.0,)}, options=FmuOptions(isolate=isolate, log=True)
    )
    with pytest.raises(RunError, match="a negative spring") as caught:
        run(plan)
    assert "\n" not in str(caught.value)
    assert str(caught.value).endswith("at tick 0 (t = 0 s)")
