"""Keys of a scenario for FMUs: units, items, texts, sizes, log, isolate, timeout, build."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cosim.base.errors import CosimError, RunError, ScenarioError
from cosim.engine.simulate import simulate
from cosim.record import Run
from cosim.scenario.spec import build
from tests.cosim.fmi.exporter import export, nasty2, passing3


def scenario(path: Path, **component):
    document = {
        "run": {"step": 0.1, "stop": 0.5},
        "components": {"x": {"model": str(path), **component}},
    }
    return build(document, path.with_suffix(".toml"))


@pytest.fixture(scope="module")
def passing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(passing3(), tmp_path_factory.mktemp("fmu") / "passing3.fmu")


@pytest.fixture(scope="module")
def nasty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(nasty2(), tmp_path_factory.mktemp("fmu") / "nasty2.fmu")


def test_sizes_items_texts_and_units_of_the_fmu(passing: Path, tmp_path: Path) -> None:
    given = scenario(
        passing,
        parameters={"factor": "180 deg", "mode": "fast", "n": 1},
        start={"label": "left", "blob": "00ff", "A": "3 kN.m", "u_Enumeration": "fast"},
    )
    simulate(given, tmp_path / "run")
    run = Run.open(tmp_path / "run")
    assert run.column("x.B[0,0]")[-1] == pytest.approx(1500.0, rel=1e-15)
    assert run.column("x.y_Enumeration")[-1] == 2.0
    facts = json.loads((tmp_path / "run" / "run.json").read_text())
    assert facts["texts"] == {"x.said": ["left"], "x.sent": ["00ff"]}


@pytest.mark.parametrize(
    ("component", "message"),
    [
        ({"parameters": {"mode": "faster"}}, "at components.x.parameters.mode: mode has no item"),
        ({"parameters": {"factor": "1 m"}}, r"\[m\] cannot feed"),
        ({"parameters": {"n": 2.5}}, "n is a size"),
        (
            {"inputs": {"u_Int8": "x.said"}},
            "x.said is a String variable, x.u_Int8 expects a number",
        ),
        (
            {"inputs": {"label": "x.y_Int8"}},
            "x.y_Int8 is a number, x.label expects a String variable",
        ),
        ({"timeout": 0}, "at components.x.timeout: 0 s must be positive"),
        ({"timeout": "2 m"}, "at components.x.timeout"),
    ],
)
def test_what_does_not_fit_is_said_with_its_place(
    passing: Path, tmp_path: Path, component: dict, message: str
) -> None:
    with pytest.raises(CosimError, match=message) as caught:
        simulate(scenario(passing, **component), tmp_path / "run")
    assert isinstance(caught.value, ScenarioError) or "components.x" in str(caught.value)


def test_a_crash_leaves_rows_log_and_last_ticks(nasty: Path, tmp_path: Path) -> None:
    given = scenario(
        nasty, isolate=True, log=True, timeout="5 s", parameters={"how": 1, "when": 0.25}
    )
    with pytest.raises(RunError, match="SIGSEGV"):
        simulate(given, tmp_path / "run")
    assert len(Run.open(tmp_path / "run")) >= 4
    assert "going down at 0.3" in (tmp_path / "run" / "x.fmu.log").read_text()


def test_sources_are_built(tmp_path: Path) -> None:
    path = export(nasty2(), tmp_path / "sources.fmu", sources=True)
    with pytest.raises(CosimError, match="build = true"):
        simulate(scenario(path), tmp_path / "run")
    simulate(scenario(path, build=True), tmp_path / "run")
