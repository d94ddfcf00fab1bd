"""Clocks without a period, in an FMU that insists on the rules of FMI 3.0.2 (2.2.8)."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from fmpy import extract, read_model_description
from fmpy.fmi3 import FMU3Slave

from cosim.base.errors import CosimError, ScenarioError
from cosim.engine.engine import Engine
from cosim.fmi import FmuOptions
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario, build
from cosim.ssp.export import write
from tests.cli.command import Command
from tests.cosim.fmi.exporter import clocked3, column, export, outputs, plan_of, run, timed3

STEPS = 14  # of 0.1 s
PULSES = (0.2, 0.3, 0.55, 0.55, 0.7, 0.9, 1.0, 1.25, 1.25)  # s
PULSE, START, DELAY, DONE = 1, 2, 3, 4
OUTPUTS = {"y_pulse": 20, "at_pulse": 21, "y_done": 22, "at_done": 23}
OF = {20: PULSE, 21: PULSE, 22: DONE, 23: DONE}
#: `start` rises in steps 1, 5 and 9, the others say which step sees them.
FED = {
    "start": np.repeat([0.0, 1.0, 2.0, 3.0], [1, 4, 4, STEPS - 9]),
    "u_start": 100.0 + np.arange(STEPS),
    "u_pulse": np.arange(STEPS, dtype=float),
}
ARMED = (1, 5, 9)


@pytest.fixture(scope="module")
def timed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(timed3(), tmp_path_factory.mktemp("fmu") / "timed3.fmu")


def held(events: list[tuple[float, float]], first: float) -> list[float]:
    """The values of (time, value) as they stand at the start and after every step; ticks at the end
    of a step belong to the next."""
    found = [first]
    for k in range(STEPS):
        inside = [v for t, v in events if t < 0.1 * (k + 1) - 1e-6]
        found.append(inside[-1] if inside else first)
    return found


@pytest.mark.parametrize("isolate", [False, True])
@pytest.mark.parametrize("kind", ["continuous", "sampled"])
def test_clocks_tick_when_they_were_said_to(timed, kind, isolate) -> None:
    found = outputs(plan_of(timed, STEPS, kind=kind, options=FmuOptions(isolate=isolate)), FED)
    assert found["at_pulse"] == pytest.approx(held([(t, t) for t in PULSES], -1.0))
    seen = [int(t / 0.1 + 1e-6) for t in PULSES]
    assert found["y_pulse"] == held([*zip(PULSES, np.cumsum(seen), strict=True)], -1.0)
    done = [(0.1 * k + 0.15, 100.0 + k) for k in ARMED]
    assert found["y_done"] == held(done, -1.0)
    assert found["at_done"] == pytest.approx(held([(t, t) for t, _ in done], -1.0))
    assert found["done"] == held([(t, i + 1.0) for i, (t, _) in enumerate(done)], 0.0)


def test_a_countdown_of_nothing_ticks_in_the_same_event(timed: Path) -> None:
    found = outputs(plan_of(timed, STEPS, values={"wait": (0.0,)}), FED)
    assert found["at_done"] == pytest.approx(held([(0.1 * k, 0.1 * k) for k in ARMED], -1.0))


def test_a_countdown_much_shorter_than_a_step_ticks_after_it(timed: Path) -> None:
    """Two times are one if they are closer than 1e-9 of a step (0.1 ns here); 5 ns are two."""
    found = outputs(plan_of(timed, STEPS, values={"wait": (5e-9,)}), FED)
    ticks = [0.1 * k + 5e-9 for k in ARMED]
    assert found["at_done"] == pytest.approx(held([(t, t) for t in ticks], -1.0), rel=0, abs=1e-9)


@pytest.mark.parametrize("isolate", [False, True])
def test_intervals_as_fractions_give_the_same(tmp_path: Path, timed: Path, isolate: bool) -> None:
    path = export(timed3(clock='supportsFraction="true"'), tmp_path / "x.fmu")
    found = outputs(plan_of(path, STEPS, options=FmuOptions(isolate=isolate)), FED)
    decimal = outputs(plan_of(timed, STEPS), FED)
    assert found["at_pulse"] == pytest.approx(decimal["at_pulse"])
    assert found["at_done"] == pytest.approx(decimal["at_done"])
    assert {**found, "at_pulse": 0, "at_done": 0, "time": 0} == {
        **decimal, "at_pulse": 0, "at_done": 0, "time": 0
    }  # fmt: skip


def test_a_fraction_without_a_resolution_stops_the_run(tmp_path: Path) -> None:
    path = export(timed3(clock='supportsFraction="true"'), tmp_path / "x.fmu")
    with pytest.raises(CosimError, match=r"gave none of 0 s or more.* at tick 2"):
        run(plan_of(path, STEPS, values={"lenient": (2.0,)}), FED)


@pytest.mark.parametrize("isolate", [False, True])
def test_texts_of_clocks_are_kept_from_their_last_tick(tmp_path: Path, isolate: bool) -> None:
    text = '<String name="said" valueReference="60" causality="output" clocks="4"/>'
    path = export(timed3(variables=text), tmp_path / "x.fmu")
    plan = plan_of(path, STEPS, options=FmuOptions(isolate=isolate))
    _, engine = run(plan, FED)
    with engine:
        assert engine.texts() == {"x.said": ["109"]}
    _, engine = run(plan)
    with engine:
        assert engine.texts() == {}


@pytest.mark.parametrize("isolate", [False, True])
def test_where_steps_cannot_be_cut_ticks_are_late_and_counted(tmp_path, isolate: bool) -> None:
    path = export(timed3(flags=""), tmp_path / "x.fmu")
    options = FmuOptions(isolate=isolate)
    plan = plan_of(path, STEPS, values={"lenient": (1.0,)}, options=options)
    rows, engine = run(plan, FED)
    with engine:
        count, most = engine.late_clock_ticks()["x"]
    at = column(plan, rows, "at_pulse")
    assert at[[3, 4, 7]] == pytest.approx([0.2, 0.3, 0.6])
    assert count > 3 and most == pytest.approx(0.05)
    with pytest.raises(CosimError, match="a step over a tick"):
        run(plan_of(path, STEPS, options=options), FED)


def test_a_run_says_that_ticks_were_late(tmp_path: Path, monkeypatch, capsys) -> None:
    path = export(timed3(flags=""), tmp_path / "x.fmu")
    scenario = tmp_path / "x.toml"
    scenario.write_text(
        'run = { step = 0.1, stop = 1.0 }\n[components.x]\nfmi = "3.0"\n'
        f'model = "{path}"\nparameters = {{ lenient = 1.0 }}\n'
    )
    done = Command(monkeypatch, capsys)("run", scenario, "--no-plot", "--out", tmp_path / "run")
    assert done.code == 0
    assert re.search(r"x: clocks ticked late \d times, by up to \d+ ms: it takes no", done.err)
    assert json.loads((tmp_path / "run/run.json").read_text())["late_clocks"]["x"][0] > 0


def test_an_interval_that_is_none_stops_the_run(timed: Path) -> None:
    with pytest.raises(CosimError, match=r"gave none of 0 s or more.* at tick 2"):
        run(plan_of(timed, STEPS, values={"lenient": (2.0,)}), FED)


def test_on_the_grid_nothing_is_late(timed: Path) -> None:
    _, engine = run(plan_of(timed, STEPS * 2, h=0.05))
    with engine:
        assert engine.late_clock_ticks() == {}


def test_fmpy_sees_the_same_values(timed: Path) -> None:
    found = outputs(plan_of(timed, STEPS), FED)
    expected = by_fmpy(timed)
    assert {name: found[name] for name in expected} == expected


def by_fmpy(path: Path) -> dict[str, list[float]]:
    """The same run by FMPy's calls, as the standard's state machine reads."""
    description = read_model_description(str(path), validate=False)
    fmu = FMU3Slave(
        guid=description.guid, unzipDirectory=extract(str(path)), modelIdentifier="timed3"
    )
    fmu.instantiate(eventModeUsed=True)
    fmu.setFloat64([12, 13], [0.15, 0.0])
    fmu.enterInitializationMode()
    now = {name: fmu.getFloat64([r])[0] for name, r in OUTPUTS.items()}
    next_ = {PULSE: interval(fmu, PULSE)[0], DELAY: float("inf")}
    interval(fmu, DELAY)
    fmu.exitInitializationMode()
    event(fmu, 0.0, set(), {}, now, next_)
    found = {name: [value] for name, value in now.items()}
    for k in range(STEPS):
        t, end = k * 0.1, k * 0.1 + 0.1
        u = {PULSE: FED["u_pulse"][k], START: FED["u_start"][k]}
        ticks = {START} if k in ARMED else set()
        while True:
            ticks |= {clock for clock, at in next_.items() if at <= t + 1e-10}
            if ticks:
                fmu.enterEventMode()
                event(fmu, t, ticks, u, now, next_)
                ticks = set()
            until = min(end, *next_.values())
            until = end if until > end - 1e-10 else until
            fmu.doStep(t, 0.1 if t == k * 0.1 and until == end else until - t)
            t = until
            if t == end:
                break
        for name, value in now.items():
            found[name].append(value)
    fmu.terminate()
    fmu.freeInstance()
    return found


def interval(fmu: FMU3Slave, clock: int) -> tuple[float, int]:
    """Interval (s) and qualifier of a clock."""
    import ctypes as c

    found, qualifier = (c.c_double * 1)(), (c.c_int * 1)()
    fmu.fmi3GetIntervalDecimal(fmu.component, (c.c_uint32 * 1)(clock), 1, found, qualifier)
    return found[0], qualifier[0]


def event(fmu: FMU3Slave, t, ticks, u, now, next_) -> None:
    """One Event Mode, `ticks` in the first instant, and what it says of the next ticks."""
    while True:
        for clock in ticks:
            fmu.setClock([clock], [True])
        for clock in ticks & set(u):
            fmu.setFloat64([9 + clock], [u[clock]])
        active = ticks | ({DONE} if DELAY in ticks and fmu.getClock([DONE])[0] else set())
        for name, reference in OUTPUTS.items():
            if OF[reference] in active:
                now[name] = fmu.getFloat64([reference])[0]
        fmu.updateDiscreteStates()
        if DELAY in ticks:
            next_[DELAY] = float("inf")
        again = set()
        for clock in {DELAY} | ({PULSE} & ticks):
            length, qualifier = interval(fmu, clock)
            if qualifier == 2:
                next_[clock] = t + length
                again |= {clock} if length == 0.0 else set()
        ticks = again
        if not ticks:
            break
    fmu.enterStepMode()


# ---- wires from clock to clock --------------------------------------------------------------


def wired(bell: Path, timed: Path, kind: str) -> Scenario:
    """The bell starts a countdown of nothing: what it is then done with is what the bell said."""
    fmu = {"fmi": "3.0", "kind": kind}
    document = {
        "run": {"step": 0.1, "stop": 1.4},
        "components": {
            "a": {"model": str(bell), **fmu},
            "b": {
                "model": str(timed), **fmu, "parameters": {"wait": 0.0},
                "inputs": {"start": "a.bell", "u_start": "a.y_bell"},
            },
        },
    }  # fmt: skip
    return build(document, bell.with_name("x.toml"))


@pytest.mark.parametrize(("kind", "later"), [("sampled", 0.0), ("continuous", 0.1)])
def test_an_output_clock_ticks_the_input_clock_it_is_wired_to(tmp_path, timed, kind, later) -> None:
    """In the same tick where the order of sampled components allows it, else in the next."""
    plan = assemble(wired(export(clocked3(), tmp_path / "bell.fmu"), timed, kind))
    with Engine(plan) as engine:
        engine.initialize()
        slots = plan.slots()
        at, heard = [], []
        for _ in range(plan.ticks):
            engine.run(1)
            at.append(float(engine.signals[slots["b.at_done"].start]))
            heard.append(float(engine.signals[slots["b.y_done"].start]))
    steps = (2, 4, 7, 9, 12)  # in which it rings: every 0.25 s, or at their ends
    ticks = [0.0, *(t for k in steps if (t := 0.1 * k + later) < 1.4 - 1e-6)]
    assert sorted(set(at)) == pytest.approx(ticks)
    assert sorted(set(heard)) == [i + 1.0 for i in range(len(ticks))]


def test_clocks_have_no_connectors_in_an_ssp(tmp_path: Path, timed: Path) -> None:
    scenario = wired(export(clocked3(), tmp_path / "bell.fmu"), timed, "continuous")
    with pytest.raises(ScenarioError, match=r"a.bell is a clock, which SSP 1.0 has no connectors"):
        write(scenario, assemble(scenario), tmp_path / "x.ssp")


def test_a_clock_that_nothing_is_wired_to_never_ticks(timed: Path) -> None:
    found = outputs(plan_of(timed, STEPS), {})
    assert set(found["done"]) == {0.0}


def test_a_true_input_triggers_when_it_rises(timed: Path) -> None:
    """A Boolean: once each time it becomes true."""
    raised = np.array([0, 1, 1, 1, 0, 1] + [1] * (STEPS - 6), dtype=float)
    found = outputs(plan_of(timed, STEPS), {**FED, "start": raised})
    assert max(found["done"]) == 2.0
