"""FMUs for model exchange: order of the methods, times of events, order of calls, errors.

The FMUs, ``exchange2.c`` and ``exchange3.c``, write down every call, and mark those that the
standard does not allow in the state they are in. Closed forms are of textbooks.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from math import atan, exp, pi, sin, sqrt
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from cosim.base.errors import CosimError, FmuError, RunError
from cosim.cli.commands import app
from cosim.engine.engine import Engine
from cosim.engine.simulate import simulate
from cosim.fmi import FmuComponent, FmuOptions
from cosim.record import Run
from cosim.scenario.models import load_component
from cosim.scenario.spec import ComponentSpec, build
from cosim.schedule.plan import Plan
from tests.cosim.fmi.exporter import column, exchange2, exchange3, export, plan_of, run, strict2

BALL, GROWS, POL, STICKS, COUNTS, WRAPS, FAILS, LEAVES, SHRINKS, WALLS, FADES = range(11)
SWITCHES, PASSES = range(11, 13)
DISCARD, ERROR, FATAL = 2, 3, 4
BOTH = pytest.mark.parametrize("fmi", ["2.0", "3.0"])
ALONE = pytest.mark.parametrize("fmi", ["2.0"])
#: x0 after 100 s from (2, 0), by SciPy (Radau, relative tolerance 1e-12).
POL_AT_100 = -1.86892415988


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("exchange")
    return {
        "2.0": export(exchange2(), folder / "two.fmu"),
        "3.0": export(exchange3(), folder / "three.fmu"),
        "2.0 jacobian": export(
            exchange2('providesDirectionalDerivative="true"'), folder / "jacobian2.fmu"
        ),
        "3.0 jacobian": export(
            exchange3('providesDirectionalDerivatives="true"'), folder / "jacobian3.fmu"
        ),
    }


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], list[str]]:
    """The calls so far."""
    path = tmp_path / "calls"
    path.touch()
    monkeypatch.setenv("STRICT_CALLS", str(path))
    return lambda: path.read_text().splitlines()


def plan_that(path: Path, model: int, steps: int, h: float, start: dict[str, float] | None = None,
              isolate: bool = False, solver: str = "", max_step: float | None = None,
              tolerance: float | None = None, **values: float) -> Plan:  # fmt: skip
    given = {"model": float(model), **values, **(start or {})}
    options = FmuOptions(
        solver=solver, max_step=max_step, isolate=isolate, tolerance=tolerance
    )  # fmt: skip
    return plan_of(path, steps, h, {k: (v,) for k, v in given.items()}, options=options)


def end_of(plan: Plan) -> dict[str, float]:
    """The outputs after the last step."""
    rows, engine = run(plan)
    engine.close()
    ports = plan.components[0].component.outputs
    return {p.name: float(column(plan, rows, p.name)[-1]) for p in ports}


@BOTH
def test_one_that_ends_at_the_start_has_ended(tmp_path: Path, fmi: str) -> None:
    """Also if all its outputs are reals, which C could read."""
    text = exchange2() if fmi == "2.0" else exchange3()
    for name in ("events", "heard"):
        text = re.sub(rf'(name="{name}"[^>]*?causality=)"output"', r'\1"local"', text)
    plan = plan_that(export(text, tmp_path / "reals.fmu"), COUNTS, 10, 0.2, last=0.0)
    assert {p.name for p in plan.components[0].component.outputs} == {"x0", "x1", "at"}
    with Engine(plan) as engine:
        engine.initialize()
        assert str(engine.ended) == "ended by x at t = 0 s"


# ---- the methods --------------------------------------------------------------------------------


@BOTH
@pytest.mark.parametrize(("solver", "order"), [("euler", 1), ("heun", 2), ("rk4", 4)])
def test_a_method_has_its_declared_order(
    fmus: dict[str, Path], fmi: str, solver: str, order: int
) -> None:
    errors = [
        end_of(plan_that(fmus[fmi], GROWS, 4, 0.5, solver=solver, max_step=h))["x0"] - exp(sin(2.0))
        for h in (0.05, 0.025)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.15)


@ALONE
def test_the_step_of_the_default_experiment_is_the_longest_by_default(
    fmus: dict[str, Path], fmi: str, tmp_path: Path
) -> None:
    text = exchange2().replace(
        "<ModelVariables>", '<DefaultExperiment stepSize="0.05"/><ModelVariables>'
    )
    path = export(text, tmp_path / "x.fmu")
    by_default = end_of(plan_that(path, GROWS, 4, 0.5))["x0"]
    assert by_default == end_of(plan_that(fmus[fmi], GROWS, 4, 0.5, max_step=0.05))["x0"]
    assert by_default != end_of(plan_that(fmus[fmi], GROWS, 4, 0.5))["x0"]


@pytest.mark.parametrize("fmi", ["2.0", "3.0", "2.0 jacobian", "3.0 jacobian"])
def test_cvode_solves_a_stiff_oscillator(
    fmus: dict[str, Path], fmi: str, calls: Callable[[], list[str]]
) -> None:
    plan = plan_that(
        fmus[fmi], POL, 2, 50.0, solver="cvode", tolerance=1e-9, start={"x0": 2.0}, mu=100.0
    )
    assert end_of(plan)["x0"] == pytest.approx(POL_AT_100, abs=1e-6)
    assert ("DirectionalDerivative" in calls()) == ("jacobian" in fmi)
    assert not [call for call in calls() if "ILLEGAL" in call]


@BOTH
def test_a_refused_trial_state_shortens_the_step(fmus: dict[str, Path], fmi: str) -> None:
    found = end_of(plan_that(fmus[fmi], SHRINKS, 1, 0.1, solver="heun"))
    assert 0.0 < found["x0"] < 0.02


# ---- events -------------------------------------------------------------------------------------


def bounces(count: int) -> list[float]:
    """When a ball that falls 1 m touches the ground."""
    times, v = [sqrt(2.0 / 9.81)], sqrt(2.0 * 9.81)
    for _ in range(count - 1):
        v *= 0.7
        times.append(times[-1] + 2.0 * v / 9.81)
    return times


@BOTH
@pytest.mark.parametrize(
    ("solver", "tolerance", "within"),
    [("heun", None, 1e-13), ("rk4", None, 1e-13), ("cvode", 1e-12, 1e-9)],
)
def test_a_ball_bounces_when_it_does(
    fmus: dict[str, Path], fmi: str, solver: str, tolerance: float | None, within: float
) -> None:
    plan = plan_that(fmus[fmi], BALL, 200, 0.0125, solver=solver, tolerance=tolerance)
    rows, engine = run(plan)
    engine.close()
    found = np.unique(column(plan, rows, "at"))[1:]
    expected = bounces(10)
    assert found[:8] == pytest.approx(expected[:8], abs=within, rel=0)
    assert column(plan, rows, "x0").min() >= 0.0


@ALONE
@pytest.mark.parametrize(("solver", "tolerance"), [("rk4", None), ("cvode", 1e-12)])
def test_a_mass_on_a_belt_sticks_and_slips(
    fmus: dict[str, Path], fmi: str, solver: str, tolerance: float | None
) -> None:
    plan = plan_that(
        fmus[fmi], STICKS, 1600, 0.01, solver=solver, tolerance=tolerance, start={"x0": 0.0}
    )
    rows, engine = run(plan)
    engine.close()
    slip, turns = 1.0 / 0.1, 2.0 * pi - 2.0 * atan(0.4 / 0.1)
    found = np.unique(column(plan, rows, "at"))
    assert found[1:3] == pytest.approx([slip, slip + turns], abs=1e-9)


@BOTH
def test_an_indicator_that_comes_to_zero_from_above_is_an_event(
    fmus: dict[str, Path], fmi: str
) -> None:
    found = end_of(plan_that(fmus[fmi], LEAVES, 8, 0.25, solver="euler"))
    assert (found["events"], found["at"]) == (1.0, 1.0)


@BOTH
@pytest.mark.parametrize(("mu", "events", "looks"), [(-1.0, 0, 2), (1.0, 1, 5)])
def test_an_indicator_that_is_zero_at_first(
    fmus: dict[str, Path], fmi: str, calls: Callable[[], list[str]], mu: float, events: int,
    looks: int,
) -> None:  # fmt: skip
    """It is in the domain "<= 0": it stays there if it falls, and leaves at once if it rises."""
    plan = plan_that(fmus[fmi], PASSES, 1, 1.5, start={"x0": 0.0}, mu=mu, solver="euler")
    assert end_of(plan)["x0"] == pytest.approx(1.5)
    assert calls().count("EnterEventMode") == 1 + events  # one for the inputs, at the start
    assert calls().count("EventIndicators") == looks  # one trial finds the event


@ALONE
@pytest.mark.parametrize(
    ("model", "step", "start", "trials"),
    [
        (LEAVES, 1.5, {}, 6), (BALL, 1.5, {}, 32), (STICKS, 11.0, {"x0": 0.0}, 6),
        (FADES, 1.5, {"x0": 0.0, "when": 0.26}, 23), (FADES, 1.5, {"x0": 0.0, "when": 0.9}, 18),
        (SWITCHES, 1.5, {"x0": 0.0, "when": 0.7}, 351),
        (SWITCHES, 1.5, {"x0": 0.0, "when": 2.2}, 372),
    ],
)  # fmt: skip
def test_the_trials_that_find_the_time_of_an_event(
    fmus: dict[str, Path], calls: Callable[[], list[str]], model: int, step: float,
    start: dict[str, float], trials: int, fmi: str,
) -> None:  # fmt: skip
    """Their number is part of what a run costs: a change of the search shows here.

    Lines find a smooth event in some trials; one that jumps, unevenly, takes many.
    """
    steps = 1 + (start.get("when", 0.0) > step)
    plan = plan_that(fmus[fmi], model, steps, step, start=start, solver="rk4", max_step=100.0)
    found = end_of(plan)
    assert calls().count("EventIndicators") == trials
    when = start.get("when", {LEAVES: 1.0, STICKS: 10.0, BALL: bounces(2)[1]}.get(model))
    assert found["at"] == pytest.approx(when, rel=1e-14)


@pytest.mark.parametrize("solver", ["rk4", "cvode"])
def test_each_of_two_indicators_has_its_events(tmp_path: Path, solver: str) -> None:
    """A body between two walls: its place is a triangle wave, turned at both of them."""
    text = exchange2().replace('Indicators="1"', 'Indicators="2"')
    path = export(text, tmp_path / "walls.fmu")
    p = plan_that(path, WALLS, 40, 0.25, start={"x0": 0.5, "x1": -0.75}, solver=solver)
    rows, engine = run(p)
    engine.close()
    t = 0.25 * np.arange(41)
    wave = np.abs((0.5 - 0.75 * t) % 2.0 - 2.0 * ((0.5 - 0.75 * t) % 2.0 > 1.0))
    assert column(p, rows, "x0") == pytest.approx(wave, abs=1e-9)
    assert column(p, rows, "events")[-1] == 7.0
    assert column(p, rows, "at")[-1] == pytest.approx((0.5 + 6.0) / 0.75, abs=1e-9)


@BOTH
@pytest.mark.parametrize("h", [0.1, 0.3, 1.0])
def test_time_events_come_exactly_when_they_were_announced(
    fmus: dict[str, Path], fmi: str, h: float
) -> None:
    found = end_of(plan_that(fmus[fmi], COUNTS, round(3.0 / h), h))
    assert (found["events"], found["at"]) == (12.0, 3.0)


@BOTH
def test_events_without_end_are_an_error(fmus: dict[str, Path], fmi: str) -> None:
    plan = plan_that(fmus[fmi], COUNTS, 1, 0.25, period=0.0, last=1e9)
    with pytest.raises(RunError, match=r"the step does not end: 100000 early returns, events or"):
        end_of(plan)


@BOTH
def test_a_step_event_changes_the_states(fmus: dict[str, Path], fmi: str) -> None:
    plan = plan_that(fmus[fmi], WRAPS, 10, 0.25, solver="euler", start={"x0": 0.0})
    rows, engine = run(plan)
    engine.close()
    expected = [0.0, 0.25, 0.5, 0.75, 1.0, 0.25, 0.5, 0.75, 1.0, 0.25, 0.5]
    assert column(plan, rows, "x0") == pytest.approx(expected)
    assert column(plan, rows, "events")[-1] == 2.0


@BOTH
def test_inputs_are_set_in_event_mode_when_they_change(
    fmus: dict[str, Path], fmi: str, calls: Callable[[], list[str]]
) -> None:
    plan = plan_that(fmus[fmi], GROWS, 4, 0.5, solver="heun")
    u, gear = np.array([0.0, 1.0, 1.0, -1.0]), np.array([0.0, 2.0, 2.0, 3.0])
    rows, engine = run(plan, {"u": u, "gear": gear})
    engine.close()
    assert column(plan, rows, "x1") == pytest.approx([0.0, 0.0, 0.5, 1.0, 0.5])
    assert list(column(plan, rows, "heard")) == [0.0, 0.0, 2.0, 2.0, 3.0]
    assert calls().count("EnterEventMode") == 3
    assert not [call for call in calls() if "ILLEGAL" in call]


# ---- the order of calls, and its end ------------------------------------------------------------


@BOTH
@pytest.mark.parametrize("model", [BALL, COUNTS, WRAPS])
@pytest.mark.parametrize("solver", ["rk4", "cvode"])
def test_calls_are_those_that_the_state_machine_allows(
    fmus: dict[str, Path], fmi: str, model: int, solver: str, calls: Callable[[], list[str]]
) -> None:
    end_of(plan_that(fmus[fmi], model, 10, 0.25, solver=solver))
    found = calls()
    assert not [call for call in found if "ILLEGAL" in call]
    start = found.index("ExitInitializationMode")
    assert "EnterEventMode" not in found[: found.index("EnterContinuousTimeMode")]
    assert found[start + 1 :][0] in ("GetWhole", "NewDiscreteStates")
    assert found[-2:] == ["Terminate", "FreeInstance"]
    assert found.count("EnterEventMode") + 1 == found.count("EnterContinuousTimeMode")


@BOTH
def test_an_fmu_that_needs_no_word_of_completed_steps_gets_none(
    tmp_path: Path, fmi: str, calls: Callable[[], list[str]]
) -> None:
    two = exchange2('completedIntegratorStepNotNeeded="true"')
    path = export(two if fmi == "2.0" else exchange3(""), tmp_path / "x.fmu")
    end_of(plan_that(path, BALL, 4, 0.25))
    assert "CompletedIntegratorStep" not in calls()


@BOTH
@pytest.mark.parametrize("isolate", [False, True])
def test_an_fmu_ends_the_simulation(fmus: dict[str, Path], fmi: str, isolate: bool) -> None:
    plan = plan_that(fmus[fmi], COUNTS, 10, 0.2, last=3.0, isolate=isolate)
    _, engine = run(plan)
    engine.close()
    assert str(engine.ended) == "ended by x at t = 0.75 s"
    assert engine.tick == 4


@BOTH
@pytest.mark.parametrize("solver", ["rk4", "cvode"])
@pytest.mark.parametrize(
    ("status", "last"),
    [(DISCARD, ["Terminate", "FreeInstance"]), (ERROR, ["FreeInstance"]), (FATAL, [])],
)
def test_after_an_error_only_what_is_allowed_is_called(
    fmus: dict[str, Path], fmi: str, solver: str, status: int, last: list[str],
    calls: Callable[[], list[str]],
) -> None:  # fmt: skip
    plan = plan_that(fmus[fmi], FAILS, 10, 0.25, status=float(status), when=0.6, solver=solver)
    with (
        pytest.raises(RunError, match=r"^x: .* at tick 2 \(t = 0\.5 s\)") as error,
        Engine(plan) as engine,
    ):
        engine.initialize()
        engine.run(10)
    if solver == "rk4":
        word = {DISCARD: "discard", ERROR: "error", FATAL: "fatal"}[status]
        assert f"a call of the solver returned {word}" in str(error.value)
    found = calls()
    assert not [call for call in found if "ILLEGAL" in call]
    expected = last[-1:] if solver == "cvode" else last  # CVODE has failed as well
    assert [call for call in found if call in ("Terminate", "FreeInstance")] == expected


@BOTH
def test_in_a_process_of_its_own_the_numbers_are_the_same(fmus: dict[str, Path], fmi: str) -> None:
    here, there = (
        end_of(plan_that(fmus[fmi], BALL, 10, 0.1, isolate=isolate)) for isolate in (False, True)
    )
    assert here == there


# ---- what is refused ----------------------------------------------------------------------------


def test_what_cannot_be_integrated_is_refused(fmus: dict[str, Path], tmp_path: Path) -> None:
    wrong = exchange2().replace('<Unknown index="4"/>', '<Unknown index="99"/>')
    with pytest.raises(FmuError, match=r"ModelStructure: derivative: '99' names no variable"):
        FmuComponent(export(wrong, tmp_path / "wrong.fmu"))
    with pytest.raises(Exception, match=r"unknown solver 'ode45'; expected one of euler, heun"):
        end_of(plan_that(fmus["2.0"], BALL, 1, 0.1, solver="ode45"))
    clock = exchange3().replace(
        "</ModelVariables>",
        '<Clock name="c" valueReference="90" causality="input" intervalVariability="constant" '
        'intervalDecimal="0.1"/></ModelVariables>',
    )
    with pytest.raises(FmuError, match=r"^fmu: has clocks, which are not supported for model exch"):
        FmuComponent(export(clock, tmp_path / "clock.fmu"))


def test_an_fmu_of_both_kinds_is_run_by_co_simulation_unless_asked(tmp_path: Path) -> None:
    both = export(exchange2(more='<CoSimulation modelIdentifier="exchange2"/>'), tmp_path / "x.fmu")
    assert FmuComponent(both).description.states is None
    exchanged = FmuComponent(both, options=FmuOptions(interface="ModelExchange")).description
    assert exchanged.states is not None and exchanged.interfaces == (
        "CoSimulation",
        "ModelExchange",
    )
    info = CliRunner().invoke(app, ["info", str(both), "--no-validate"])
    assert "2.0 co-simulation, model exchange (2 states, 1 event indicator)" in info.output
    with pytest.raises(FmuError, match=r"found solver or max_step for an FMU with its own solver"):
        FmuComponent(both, options=FmuOptions(solver="rk4"))
    for kind, states in (
        ("co-simulation", 0), ("model exchange", 2), ("model-exchange", 2), (None, 0),
    ):  # fmt: skip
        spec = ComponentSpec(model=str(both), kind=kind)
        found = load_component("x", spec, tmp_path, "x")[0]
        assert isinstance(found, FmuComponent) and found.kind == "continuous"
        known = found.description.states
        assert (0 if known is None else known.count) == states
    only = export(exchange2(), tmp_path / "only.fmu")
    with pytest.raises(FmuError, match="found the interfaces ModelExchange"):
        load_component("x", ComponentSpec(model=str(only), kind="co-simulation"), tmp_path, "x")


# ---- in a scenario ------------------------------------------------------------------------------


def scenario(fmus: dict[str, Path], folder: Path, **more: object) -> Path:
    """x1' = 1 in one FMU feeds x1' = u of another, and over 0.2 s an FMU with its own solver."""
    export(strict2(), folder / "strict.fmu")
    given = {"model": GROWS}
    document = {
        "run": {"step": 0.1, "stop": 1.0, "record": {"signals": ["*"]}},
        "components": {
            "a": {"model": str(fmus["2.0"]), "parameters": given, "start": {"u": 1.0}, **more},
            "b": {"model": str(fmus["3.0"]), "solver": "heun", "max_step": "10 ms",
                  "parameters": given, "inputs": {"u": "a.x1"}},
            "c": {"model": "strict.fmu"},
        },
        "links": [{"from": "a.x1", "to": "c.u", "delay": {"law": "constant", "delay": 0.2}}],
    }  # fmt: skip
    simulate(build(document, folder / "s.toml"), folder / "run")
    return folder / "run"


def test_fmus_of_both_kinds_are_connected(fmus: dict[str, Path], tmp_path: Path) -> None:
    found = Run.open(scenario(fmus, tmp_path))
    t = np.arange(11) * 0.1
    assert found.column("a.x1") == pytest.approx(t)
    held = np.concatenate([[0.0], np.cumsum(t[:-1] * 0.1)])  # of a.x1, which b holds over a step
    assert found.column("b.x1") == pytest.approx(held)
    late = np.concatenate([np.zeros(3), t[:-3]])  # 0.2 s, and an input is recorded before it is set
    assert found.column("c.u")[:-1] == pytest.approx(late[:-1])
    assert found.column("a.der(x1)") == pytest.approx(np.ones(11))


def test_keys_for_model_exchange_are_checked(fmus: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(CosimError, match=r"components\.a\.max_step: 0 s must be positive"):
        scenario(fmus, tmp_path, max_step=0)
    with pytest.raises(CosimError, match=r"components\.a\.kind: found model exchange, expected an"):
        scenario(fmus, tmp_path, kind="model exchange", **{"model": "fractions:Fraction"})
