"""FMI 1.0 for co-simulation: the same as FMPy, the order of calls, and what is refused."""

from __future__ import annotations

import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest

from cosim.base.errors import CosimError, FmuError, RunError
from cosim.fmi import FmuComponent, FmuOptions
from tests.cli.command import Command
from tests.cosim.fmi.exporter import column, library, plan_of, run

ISOLATE = pytest.mark.parametrize("isolate", [False, True])
ERROR, FATAL, DISCARD = 1, 2, 3
STEPS = 10


def old1(alone: str = "CoSimulation_StandAlone", more: str = "") -> str:
    def scalar(name: str, reference: int, kind: str, words: str, rest: str = "") -> str:
        return (
            f'<ScalarVariable name="{name}" valueReference="{reference}" {words}>'
            f"<{kind} {rest}/></ScalarVariable>"
        )

    fixed = 'variability="parameter"'
    variables = (
        scalar("u", 0, "Real", 'causality="input"', 'start="0" unit="N"'),
        scalar("gain", 1, "Real", fixed, 'start="2" min="0" max="100"'),
        scalar("when", 2, "Real", fixed, 'start="1e9" unit="s"'),
        scalar("x", 3, "Real", "", 'start="1" fixed="true"'),
        scalar("y", 4, "Real", 'causality="output"', 'unit="m"'),
        scalar("same", 4, "Real", 'alias="alias"'),
        scalar("minus", 4, "Real", 'alias="negatedAlias"'),
        scalar("how", 10, "Integer", fixed, 'start="0"'),
        scalar("count", 11, "Integer", 'causality="input" variability="discrete"', 'start="0"'),
        scalar("mode", 12, "Enumeration", 'causality="input" variability="discrete"',
               'declaredType="Mode" start="1"'),
        scalar("counted", 13, "Integer", 'causality="output" variability="discrete"'),
        scalar("flag", 20, "Boolean", 'causality="input" variability="discrete"', 'start="false"'),
        scalar("up", 21, "Boolean", 'causality="output" variability="discrete"'),
        scalar("label", 30, "String", fixed, 'start="nothing"'),
        scalar("said", 31, "String", 'causality="output" variability="discrete"'),
    )  # fmt: skip
    capable = (
        '<Capabilities canHandleVariableCommunicationStepSize="true" canHandleEvents="false"/>'
    )
    run_by = f"<Implementation><{alone}>{capable}</{alone}></Implementation>" if alone else ""
    return f"""<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="1.0"
 modelName="old" modelIdentifier="old1" guid="{{old}}" numberOfContinuousStates="0"
 numberOfEventIndicators="0"><UnitDefinitions><BaseUnit unit="N"/><BaseUnit unit="m"/>
<BaseUnit unit="s"/></UnitDefinitions><TypeDefinitions><Type name="Mode"><EnumerationType>
<Item name="slow"/><Item name="fast"/></EnumerationType></Type></TypeDefinitions>
<DefaultExperiment startTime="0" stopTime="1" tolerance="1e-6"/><ModelVariables>
{"".join(variables)}{more}</ModelVariables>{run_by}</fmiModelDescription>"""


def written(text: str, path: Path) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)
        archive.writestr("binaries/linux64/old1.so", library("old1"))
    return path


@pytest.fixture(scope="module")
def old(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(old1(), tmp_path_factory.mktemp("fmu") / "old1.fmu")


FEED = {
    "u": np.linspace(0.0, 3.0, STEPS),
    "count": np.arange(STEPS) % 4,
    "mode": 1 + np.arange(STEPS) % 2,
    "flag": np.arange(STEPS) % 2,
}


@ISOLATE
def test_the_values_are_those_of_fmpy(old: Path, isolate: bool) -> None:
    options = FmuOptions(isolate=isolate, given={"label": "left"})
    plan = plan_of(old, STEPS, values={"gain": (3.0,), "x": (0.5,)}, options=options)
    rows, engine = run(plan, FEED)
    with engine:
        assert engine.texts() == {"x.said": ["left at 1"]}
    found = np.array([column(plan, rows, name) for name in ("y", "counted", "up")]).T
    times = np.arange(STEPS) * 0.1
    kinds = [("time", float), ("u", float), ("count", np.int32), ("mode", np.int32), ("flag", bool)]
    given = np.array([*zip(times, *FEED.values(), strict=True)], dtype=kinds)
    theirs = fmpy.simulate_fmu(
        str(old), stop_time=1.0, step_size=0.1, output_interval=0.1, input=given,
        start_values={"gain": 3.0, "x": 0.5, "label": "left"}, output=["y", "counted", "up"],
    )  # fmt: skip
    expected = np.array([[float(v) for v in row.tolist()[1:]] for row in theirs])
    assert found[:, 1:].tolist() == expected[:, 1:].tolist()
    assert found[:, 0] == pytest.approx(expected[:, 0], abs=1e-14)  # FMPy interpolates u


def test_a_lag_is_solved(old: Path) -> None:
    plan = plan_of(old, STEPS, start={"u": (1.0,)})
    rows, engine = run(plan)
    engine.close()
    t = 0.1 * np.arange(STEPS + 1)
    assert column(plan, rows, "y") == pytest.approx(2.0 - np.exp(-t), abs=1e-14)


def test_causality_variability_and_start_in_the_words_of_later_versions(old: Path) -> None:
    fmu = FmuComponent(old)
    assert [p.name for p in fmu.inputs] == ["u", "count", "mode", "flag"]
    assert [p.name for p in fmu.outputs] == ["y", "counted", "up"]
    assert [p.name for p in fmu.parameters] == ["gain", "when", "x", "how"]
    assert fmu.discrete == {"count", "mode", "flag"}
    assert set(fmu.observable) == {"gain", "when", "x", "how", "same"}  # no negated alias
    assert fmu.number("mode", "fast") == 2
    assert [p.unit for p in (*fmu.inputs[:1], *fmu.outputs[:1])] == ["N", "m"]
    assert fmu.description.default_stop == 1.0


@ISOLATE
@pytest.mark.parametrize(
    ("how", "message"), [(ERROR, "error"), (FATAL, "fatal"), (DISCARD, "discard")]
)
def test_what_it_logs_is_in_the_error(old: Path, isolate: bool, how: int, message: str) -> None:
    values = {"how": (float(how),), "when": (0.25,)}
    said = rf"x: doStep returned {message} \(no step from 0.3 on\) at tick 3"
    with pytest.raises(RunError, match=said):
        run(plan_of(old, STEPS, values=values, options=FmuOptions(isolate=isolate)))


def test_two_instances_log_apart(old: Path) -> None:
    engines = [run(plan_of(old, 1, options=FmuOptions(log=True)))[1] for _ in range(2)]
    for engine in engines:
        engine.close()
    assert "x is made, 1" in engines[1].logs()["x"]


def test_another_token_is_refused_with_what_it_says(tmp_path: Path) -> None:
    path = written(old1().replace('guid="{old}"', 'guid="{new}"'), tmp_path / "x.fmu")
    with pytest.raises(CosimError, match=r"fmiInstantiateSlave failed: the token is '\{new\}'"):
        run(plan_of(path, 1))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (old1("CoSimulation_Tool"), "found FMI 1.0 for co-simulation by a tool"),
        (old1(more='<ScalarVariable name="z" valueReference="4" causality="output" '
                   'alias="negatedAlias"><Real/></ScalarVariable>'), "'z' is a negated alias"),
    ],
)  # fmt: skip
def test_what_cannot_be_run_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(FmuError, match=message):
        FmuComponent(written(text, tmp_path / "x.fmu"))


def test_commands_know_it(old: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    cosim = Command(monkeypatch, capsys)
    found = cosim("info", old)
    assert found.code == 0 and "1.0 co-simulation" in found.out
    assert "FMPy found no problems" in found.out
    out = tmp_path / "run"
    done = cosim("run", old, "--set", "gain=3", "--no-plot", "--out", out)
    assert done.code == 0
