"""What our importer calls, of FMUs from here and from other exporters: judged by the standards.

The FMUs are those that go wrong or ask for something in every way (tests/cosim/fmi/c), our models,
and what exporters on PyPI make.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from cosim.base.errors import CosimError
from cosim.engine.engine import Engine
from fmus.build.archive import find
from fmus.model import exchanged
from fmus.models import pd, planar2r
from tests.cosim.fmi.exporter import (
    clocked3,
    events3,
    exchange2,
    exchange3,
    export,
    nasty2,
    passing3,
    sloped2,
    strict2,
    strict3,
    timed3,
)
from tests.cosim.fmi.test_calls import (
    DISCARD,
    ENDS,
    ERROR,
    EVENT,
    FATAL,
    IGNORES,
    JUMPS,
    LATER,
    PENDING,
    RESETS,
    RETURNS,
)
from tests.cosim.fmi.test_rollback import SAVES
from tests.cosim.fmi.test_scheduled import scheduled3
from tests.cosim.fmi.test_slopes import COURSES
from tests.cosim.fmi.test_within import EARLY, within3
from tests.cosim.scenarios import plan
from tests.fmi.runs import Watch, ran

Made = Callable[..., Watch]
ISOLATE = pytest.mark.parametrize("isolate", [False, True], ids=["here", "isolated"])
EVENTS = 'hasEventMode="true"'
STRICT = {"2.0": strict2(), "3.0": strict3(), "3.0 events": strict3(EVENTS)}
OTHERS = {
    "types of FMI 2": nasty2(), "types of FMI 3": passing3(), "slopes": sloped2(),
    "events": events3(), "clocks": clocked3(),
    "an interval": events3('intervalVariability="tunable" intervalDecimal="0.2"'),
    "changing clocks": timed3(), "changing clocks, no early return": timed3(""),
    "intervals as fractions": timed3(clock='supportsFraction="true"'),
}  # fmt: skip


@pytest.fixture
def watch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Made:
    def made(fmu: str | Path) -> Watch:
        path = tmp_path / "x.fmu"
        path = export(fmu, path) if isinstance(fmu, str) else Path(shutil.copy(fmu, path))
        return Watch(path, tmp_path, monkeypatch)

    return made


def test_the_judge_would_notice(watch: Made) -> None:
    """Values of a run are in the list: instance, state, times, and the end."""
    found = watch(strict2())
    assert ran(found, 3, values={"gain": 3.0}, start={"u": 1.0}) == []
    names = [call.name for call in found.calls()]
    assert names[:3] == ["Instantiate", "SetupExperiment", "SetReal"]
    assert names.count("DoStep") == 3
    assert names[-2:] == ["Terminate", "FreeInstance"]


@ISOLATE
@pytest.mark.parametrize("fmi", STRICT)
@pytest.mark.parametrize("how", [0, RESETS, LATER, IGNORES, JUMPS, ENDS, EVENT])
def test_an_fmu_that_does_as_it_likes(watch: Made, fmi: str, how: int, isolate: bool) -> None:
    values = {"how": how, "gain": 3.0, "when": 0.25, "x": 2.0, "rate": 0.5}
    assert ran(watch(STRICT[fmi]), values=values, start={"u": 1.0}, isolate=isolate) == []


@ISOLATE
@pytest.mark.parametrize("fmi", STRICT)
@pytest.mark.parametrize("status", [1, DISCARD, ERROR, FATAL, PENDING, 99])
def test_an_fmu_whose_step_returns(watch: Made, fmi: str, status: int, isolate: bool) -> None:
    values = {"how": RETURNS, "status": status, "when": 0.25}
    assert ran(watch(STRICT[fmi]), values=values, isolate=isolate) == []


@ISOLATE
@pytest.mark.parametrize("what", OTHERS)
@pytest.mark.parametrize(("h", "period"), [(0.1, 1), (0.05, 2)])
def test_types_events_and_clocks(
    watch: Made, what: str, h: float, period: int, isolate: bool
) -> None:
    assert ran(watch(OTHERS[what]), 20, h, period=period, isolate=isolate) == []


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
@pytest.mark.parametrize("solver", ["rk4", "cvode"])
@pytest.mark.parametrize("model", range(10))
def test_model_exchange(watch: Made, fmi: str, solver: str, model: int) -> None:
    made = exchange2() if fmi == "2.0" else exchange3()
    values = {"model": model, "status": DISCARD, "when": 0.6}
    start = {"u": 1.0, "gear": 2.0}
    assert ran(watch(made), 10, 0.25, values=values, start=start, solver=solver) == []


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_model_exchange_of_both_interfaces_with_a_jacobian(watch: Made, fmi: str) -> None:
    if fmi == "2.0":
        text = exchange2('providesDirectionalDerivative="true" completedIntegratorStepNotNeeded='
                         '"true"', '<CoSimulation modelIdentifier="exchange2"/>')  # fmt: skip
    else:
        text = exchange3('providesDirectionalDerivatives="true"')
    values = {"model": 2, "x0": 2.0, "mu": 50.0}
    found = watch(text)
    assert ran(found, 4, 0.5, values=values, solver="cvode", interface="ModelExchange") == []
    assert "GetDirectionalDerivative" in {call.name for call in found.calls()}
    assert "CompletedIntegratorStep" not in {call.name for call in found.calls()}


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
@pytest.mark.parametrize("model", [pd, planar2r], ids=["pd", "planar2r"])
def test_our_models(watch: Made, model: object, fmi: str) -> None:
    assert ran(watch(find(model.model(), fmi)), 20, 1e-3) == []  # type: ignore[attr-defined]


@ISOLATE
@pytest.mark.parametrize("exporter", ["pythonfmu", "pythonfmu3"])
def test_what_python_exporters_make(
    watch: Made, tmp_path: Path, exporter: str, isolate: bool
) -> None:
    builder = pytest.importorskip(f"{exporter}.builder", reason="not installed")
    from tests.cosim.fmi.test_other_exporters import SLAVES

    script = SLAVES / ("oscillator.py" if exporter == "pythonfmu" else "oscillator3.py")
    fmu = builder.FmuBuilder.build_FMU(str(script), dest=tmp_path)
    assert ran(watch(Path(fmu)), 5, 0.01, values={"k": 9.0}, isolate=isolate) == []


def looped(watch: Watch, document: dict[str, Any]) -> list[str]:
    """A scenario of several instances of the FMU, to its end or failure; what is violated."""
    with suppress(CosimError):
        p = plan(document.pop("components"), **document)
        with Engine(p) as engine:
            engine.initialize()
            engine.run(p.ticks)
    return watch.violations()


@pytest.mark.parametrize("fmi", ["2.0", "3.0", "3.0 events", "2.0 exchange", "3.0 exchange"])
@pytest.mark.parametrize("how", [0, RETURNS, ENDS])
def test_steps_that_are_gone_back_to(watch: Made, fmi: str, how: int) -> None:
    """``algorithm = "adaptive"``: states are saved, and steps done again from them."""
    saves = SAVES[fmi[:3]]
    if "exchange" in fmi:
        found = watch(exchange2(saves) if fmi[0] == "2" else exchange3(saves))
        parameters, x, y, u = {"model": 1.0}, "x1", "x1", "u"
    else:
        events = f" {EVENTS}" if "events" in fmi else ""
        found = watch(strict2(saves) if fmi[0] == "2" else strict3(saves + events))
        parameters, x, y, u = {"gain": 1.0, "how": how, "when": 0.8, "status": 2.0}, "x", "y", "u"
    model = {"model": str(found.path), "parameters": parameters}
    components = {
        "a": {**model, "start": {x: 1.0}, "inputs": {u: f"b.{y}"}},
        "b": {**model, "start": {x: 0.0}, "inputs": {u: {"from": f"a.{y}", "gain": -1.0}}},
    }
    given = {"algorithm": "adaptive", "adaptive": {"tolerance": 1e-3}, "step": 0.5, "stop": 2.0}
    assert looped(found, {"components": components, **given}) == []
    names = {call.name.lower() for call in found.calls()}
    assert {"getfmustate", "setfmustate", "freefmustate"} <= names


@pytest.mark.parametrize("algorithm", ["sampled", "jacobi", "gauss-seidel"])
@pytest.mark.parametrize("fmi", STRICT)
def test_fmus_that_are_connected(watch: Made, fmi: str, algorithm: str) -> None:
    found = watch(STRICT[fmi])
    model = {"model": str(found.path), "parameters": {"gain": 0.5}}
    components = {
        "a": {**model, "inputs": {"u": "b.y"}},
        "b": {**model, "kind": "sampled", "period": 0.2, "inputs": {"u": "a.y"}},
        "c": {**model, "inputs": {"u": "a.y"}, "extrapolate": "linear"},
    }
    given = {"algorithm": algorithm, "step": 0.1, "stop": 1.0}
    assert looped(found, {"components": components, **given}) == []


@ISOLATE
def test_scheduled_execution(watch: Made, isolate: bool) -> None:
    found = watch(scheduled3())
    assert ran(found, start={"u": 1.0, "u_fast": 2.0}, isolate=isolate) == []
    assert "ActivateModelPartition" in {call.name for call in found.calls()}


@ISOLATE
@pytest.mark.parametrize("extrapolate", ["hold", "linear"])
def test_intermediate_update(watch: Made, extrapolate: str, isolate: bool) -> None:
    found = watch(within3())
    x = {
        "model": str(found.path), "inputs": {"u": "a.y"}, "extrapolate": extrapolate,
        "isolate": isolate,
    }  # fmt: skip
    given = {"algorithm": "jacobi", "step": 0.25, "stop": 1.0}
    assert looped(found, {"components": {"a": {"model": COURSES}, "x": x}, **given}) == []
    inside = {call.name for call in found.calls() if call.depth}
    assert inside == ({"SetFloat64"} if extrapolate == "linear" else set())


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
@pytest.mark.parametrize("solver", ["rk4", "cvode"])
def test_our_plants_for_model_exchange(watch: Made, fmi: str, solver: str) -> None:
    path = find(exchanged(planar2r.model()), fmi)  # type: ignore[arg-type]
    found = watch(path)
    assert ran(found, 5, 0.01, solver=solver) == []
    names = {call.name for call in found.calls()}
    assert ("GetDirectionalDerivative" in names) == (solver == "cvode")


@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel"])
def test_intermediate_update_with_early_return(watch: Made, algorithm: str) -> None:
    found = watch(within3(EARLY))
    components = {
        "a": {"model": COURSES},
        "x": {"model": str(found.path), "inputs": {"u": "a.y"}, "extrapolate": "linear"},
    }
    given = {"algorithm": algorithm, "step": 0.1, "stop": 1.0}
    assert looped(found, {"components": components, **given}) == []
    inside = [call for call in found.calls() if call.depth]
    assert inside and {call.name for call in inside} == {"SetFloat64"}
