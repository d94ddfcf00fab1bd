"""FMI 1.0 for model exchange: values of FMPy, events, and sources with the headers of FMI 1.0."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

from cosim.base.errors import CosimError
from cosim.engine.simulate import simulate
from cosim.fmi import FmuComponent
from cosim.record import Run
from cosim.scenario.spec import build

SOURCE = Path(__file__).parent / "c" / "ball1.c"
NAMES = ("h", "v", "bounces", "colours", "red")


def described(token: str = "{ball}") -> str:
    def scalar(name: str, reference: int, words: str, typed: str) -> str:
        begin = f'<ScalarVariable name="{name}" valueReference="{reference}" {words}>'
        return f"{begin}{typed}</ScalarVariable>"

    out = 'causality="output"'
    variables = (
        scalar("h", 0, out, '<Real start="1" fixed="true"/>'),
        scalar("v", 1, out, '<Real start="0" fixed="true"/>'),
        scalar("push", 2, 'causality="input"', '<Real start="0"/>'),
        scalar("e", 3, 'variability="parameter"', '<Real start="0.7"/>'),
        scalar("bounces", 4, out, "<Real/>"), scalar("colours", 5, out, "<Real/>"),
        scalar("red", 10, f'{out} variability="discrete"', "<Boolean/>"),
    )  # fmt: skip
    return f"""<fmiModelDescription fmiVersion="1.0" modelName="ball" modelIdentifier="ball1"
 guid="{token}" numberOfContinuousStates="2" numberOfEventIndicators="1">
<ModelVariables>{"".join(variables)}</ModelVariables></fmiModelDescription>"""


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With the library that our build makes of its sources, which need the headers of FMI 1.0."""
    folder = tmp_path_factory.mktemp("ball")
    source = packed(folder / "source.fmu", {"sources/ball1.c": SOURCE.read_bytes()})
    ran(source, folder, build=True)
    library = FmuComponent(source).archive.folder / "binaries" / "linux64" / "ball1.so"
    return packed(folder / "ball.fmu", {"binaries/linux64/ball1.so": library.read_bytes()})


def packed(path: Path, files: dict[str, bytes], token: str = "{ball}") -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", described(token))
        for name, data in files.items():
            archive.writestr(name, data)
    return path


def ran(path: Path, folder: Path, **component: Any) -> Run:
    document = {
        "run": {"step": 0.125, "stop": 1.5, "record": {"events": True}},
        "components": {"x": {"model": str(path), **component}},
    }
    given = build(document, folder / "s.toml")
    return Run.open(simulate(given, folder / "run", force=True).folder)


@pytest.mark.parametrize("solver", ["rk4", "cvode"])
def test_the_values_are_those_of_fmpy(ball: Path, tmp_path: Path, solver: str) -> None:
    """Free fall is exact with RK4; FMPy integrates with CVODE to 1e-10."""
    run = ran(ball, tmp_path, solver=solver, tolerance=1e-10, start={"push": 1.0})
    theirs = fmpy.simulate_fmu(
        str(ball), stop_time=1.5, output_interval=0.125, relative_tolerance=1e-10,
        start_values={"push": 1.0}, output=list(NAMES), record_events=False,
    )  # fmt: skip
    assert np.allclose(theirs["time"], run.t)
    for name in NAMES:
        assert run.column(f"x.{name}") == pytest.approx(theirs[name].astype(float), abs=1e-6), name


def test_events_are_located(ball: Path, tmp_path: Path) -> None:
    run = ran(ball, tmp_path)
    lines = (run.path.parent / "events.csv").read_text().splitlines()[1:]
    times = [float(line.split(",")[0]) for line in lines]
    fall = (2.0 / 9.81) ** 0.5
    bounces = [fall, fall * 2.4, fall * (2.4 + 0.98)]
    expected = sorted([*(0.3 * k for k in range(1, 6)), *(t for t in bounces if t <= 1.5)])
    assert [t for t in times if t > 0.0] == pytest.approx(expected, abs=1e-9)
    assert run.column("x.bounces")[-1] == 2.0 + (bounces[2] <= 1.5)
    assert run.column("x.red")[-1] == 1.0


@pytest.mark.parametrize("isolate", [False, True])
def test_parameters_isolation_and_what_is_refused(
    ball: Path, tmp_path: Path, isolate: bool
) -> None:
    document = {
        "run": {"step": 0.125, "stop": 1.5},
        "components": {"x": {"model": str(ball), "parameters": {"e": 0.6}, "isolate": isolate}},
    }
    found = Run.open(simulate(build(document, tmp_path / "s.toml"), tmp_path / "run").folder)
    assert found.column("x.bounces")[-1] == 3.0
    files = {"binaries/linux64/ball1.so": zipfile.ZipFile(ball).read("binaries/linux64/ball1.so")}
    wrong = packed(tmp_path / "wrong.fmu", files, token="{other}")
    with pytest.raises(CosimError, match="fmiInstantiateModel failed: the token is"):
        ran(wrong, tmp_path / "wrong", isolate=False)
