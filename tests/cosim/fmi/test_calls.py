"""Which functions of an FMU are called, in which order, and what is not called after an error.

The FMUs, ``strict2.c`` and ``strict3.c``, write down every call, and mark those that the standard
does not allow in the state they are in.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cosim.base.errors import CosimError, RunError
from cosim.engine.engine import Engine, Termination
from cosim.fmi import FmuComponent, FmuOptions
from cosim.schedule.parts import Slot, Step
from cosim.schedule.plan import Plan, compile_plan
from tests.cosim.fmi.exporter import column, export, plan_of, run, strict2, strict3
from tests.cosim.oracle import execute

NORMAL, RESETS, LATER, IGNORES, JUMPS, RETURNS, ENDS, EVENT = range(8)
DISCARD, ERROR, FATAL, PENDING = 2, 3, 4, 5
EVENTS = 'hasEventMode="true"'

Make = Callable[..., Plan]


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("strict")
    descriptions = {"2.0": strict2(), "3.0": strict3(), "3.0 events": strict3(EVENTS)}
    return {
        name: export(text, folder / f"{name.replace(' ', '')}.fmu")
        for name, text in descriptions.items()
    }


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], list[str]]:
    """The calls so far."""
    path = tmp_path / "calls"
    path.touch()
    monkeypatch.setenv("STRICT_CALLS", str(path))
    return lambda: path.read_text().splitlines()


ALL = pytest.mark.parametrize("fmi", ["2.0", "3.0", "3.0 events"])
ISOLATE = pytest.mark.parametrize("isolate", [False, True])


def plan_that(path: Path, how: int, status: int = 0, when: float = 1e9, *, isolate: bool = False,
              gain: float | None = None) -> Plan:  # fmt: skip
    values = {"how": (float(how),), "status": (float(status),), "when": (when,)}
    if gain is not None:
        values["gain"] = (gain,)
    start = {"u": (1.0,)}
    return plan_of(path, 10, values=values, start=start, options=FmuOptions(isolate=isolate))


# ---- parameters and start values ----------------------------------------------------------------


@ISOLATE
@pytest.mark.parametrize(
    ("fmi", "how"),
    [(fmi, how) for fmi in ("2.0", "3.0", "3.0 events") for how in (NORMAL, LATER)]
    + [("2.0", RESETS)],  # FMI 3.0 has no fmi2SetupExperiment
)
def test_parameters_that_an_exporter_resets_are_set_all_the_same(
    fmus: dict[str, Path], fmi: str, how: int, isolate: bool
) -> None:
    plan = plan_that(fmus[fmi], how, gain=5.0, isolate=isolate)
    rows, engine = run(plan)
    engine.close()
    assert column(plan, rows, "y")[1:] == pytest.approx([1.0 + 0.5 * (k + 1) for k in range(10)])


@ALL
@ISOLATE
def test_a_start_value_that_an_exporter_resets_is_set_all_the_same(fmus, fmi, isolate) -> None:
    values = {"how": (float(LATER),), "x": (7.0,)}
    plan = plan_of(fmus[fmi], 1, values=values, options=FmuOptions(isolate=isolate))
    rows, engine = run(plan)
    engine.close()
    assert column(plan, rows, "y").tolist() == [7.0, 7.0]


@ALL
@ISOLATE
def test_a_parameter_that_is_not_taken_is_named_with_both_values(fmus, fmi, isolate) -> None:
    with pytest.raises(CosimError) as caught:
        run(plan_that(fmus[fmi], IGNORES, gain=5.0, isolate=isolate))
    assert str(caught.value) == (
        "x does not start: the FMU did not accept these values: parameter gain was set to 5, after "
        "initialization it is 2; set a value that it accepts, or leave it out"
    )


# ---- the tolerance ------------------------------------------------------------------------------


@ALL
@ISOLATE
@pytest.mark.parametrize(
    ("default", "given", "expected"),
    [(None, None, []), (1e-5, None, [1e-5]), (1e-5, 1e-7, [1e-7]), (None, 1e-7, [1e-7])],
)
def test_the_tolerance_of_a_scenario_or_else_of_the_fmu_is_handed_over(
    tmp_path: Path, calls, fmi: str, isolate: bool, default, given, expected
) -> None:
    text = strict2() if fmi == "2.0" else strict3(EVENTS if "events" in fmi else "")
    experiment = f'<DefaultExperiment tolerance="{default}"/><ModelVariables>'
    text = text if default is None else text.replace("<ModelVariables>", experiment)
    options = FmuOptions(isolate=isolate, tolerance=given)
    _, engine = run(plan_of(export(text, tmp_path / "x.fmu"), 1, options=options))
    engine.close()
    found = [float(line.split()[1]) for line in calls() if line.startswith("tolerance")]
    assert found == expected


# ---- the first row ------------------------------------------------------------------------------


@ALL
@ISOLATE
def test_the_first_row_is_that_after_initialization(fmus, fmi: str, isolate: bool) -> None:
    rows, engine = run(plan_that(fmus[fmi], JUMPS, gain=5.0, isolate=isolate))
    engine.close()
    assert column(engine.plan, rows, "y")[0] == 5.0


class Follower:
    """A Python component that gives what it is given: at the start, and with each step."""

    inputs: tuple = ()
    outputs: tuple = ()
    parameters: tuple = ()

    def __init__(self, kind: str) -> None:
        from cosim.base.component import Port

        self.kind = kind
        self.inputs, self.outputs = (Port("u"),), (Port("y"),)

    def initialize(self, values) -> None:
        pass

    def initial(self, u):
        return {"y": u["u"]}

    def step(self, t, h, u):
        return {"y": u["u"] + 0.0}


def chain(path: Path, second: Path, isolate: bool, **of_a: float) -> Plan:
    """jumping FMU `a` -> sampled Python `b`; a -> (2 ticks late) -> FMU `d` -> Python `e`."""
    from cosim.base.component import Port
    from cosim.schedule.parts import Link, Wire
    from tests.cosim.links.tables import table_of

    options = FmuOptions(isolate=isolate)
    components = {
        "a": FmuComponent(path, "a", None, options), "b": Follower("sampled"),
        "d": FmuComponent(second, "d", "sampled", options), "e": Follower("continuous"),
    }  # fmt: skip
    jumps = {"how": float(JUMPS), "gain": 5.0}
    values = {"a": {k: (v,) for k, v in (of_a or jumps).items()}, "b": {}, "e": {},
              "d": {"how": (float(JUMPS),), "gain": (3.0,)}}  # fmt: skip
    at, steps, slots = 0, [], {}
    for name, component in components.items():
        sides = []
        for ports in (component.inputs, component.outputs):
            side = []
            for p in ports:
                assert isinstance(p, Port)
                slot = Slot(f"{name}.{p.name}", name, p.name, at, p.shape, p.unit)
                slots[slot.name] = slot
                side.append(slot)
                at += p.size
            sides.append(tuple(side))
        start = {"u": (1.0,)} if name == "a" else {}
        steps.append(Step(name, component, component.kind, 1, values[name], *sides, start))
    table = table_of(delay={"law": "constant", "delay": 0.2}, name="l", h=0.1, ticks=10)
    wires = [Wire(slots["a.y"], slots["b.u"]), Wire(slots["d.y"], slots["e.u"], 2.0, 1.0)]
    return compile_plan(0.1, 10, steps, wires, [Link("l", slots["a.y"], slots["d.u"], table)])


@ALL
@ISOLATE
def test_everybody_sees_the_right_value_at_tick_0(fmus, fmi: str, isolate: bool) -> None:
    plan = chain(fmus[fmi], fmus["2.0"], isolate)
    record = np.zeros((10, plan.n_signals))
    with Engine(plan) as engine:
        engine.initialize()
        first = engine.signals.copy()
        engine.run(10, record)
    found = {n: record[:3, s.start].tolist() for n, s in plan.slots().items()}
    assert found["a.y"][0] == found["b.u"][0] == found["b.y"][0] == 5.0
    assert found["d.u"][:2] == [5.0, 5.0]  # what the link holds before anything has come
    assert first[plan.slots()["e.u"].start] == 7.0  # 2 x 3 + 1
    assert execute(chain(fmus[fmi], fmus["2.0"], isolate))[:-1].tobytes() == record.tobytes()


# ---- statuses -----------------------------------------------------------------------------------


def completed(plan: Plan) -> None:
    """All ten steps, and the end."""
    with Engine(plan) as engine:
        engine.initialize()
        engine.run(10)


def after(calls: list[str], name: str) -> list[str]:
    return calls[len(calls) - calls[::-1].index(name) :]


@ALL
@ISOLATE
@pytest.mark.parametrize(
    ("status", "words", "then"),
    [
        (DISCARD, "discard", ["Terminate", "FreeInstance"]),
        (ERROR, "error", ["FreeInstance"]),
        (FATAL, "fatal", []),
        (-1, "the unknown status -1", ["FreeInstance"]),
        (99, "the unknown status 99", ["FreeInstance"]),
    ],
)
def test_what_is_called_after_a_status(
    fmus, calls, fmi: str, isolate: bool, status: int, words: str, then: list[str]
) -> None:
    plan = plan_that(fmus[fmi], RETURNS, status, when=0.25, isolate=isolate)
    with (
        pytest.raises(RunError, match=f"x: doStep returned {words} .* at tick 3"),
        Engine(plan) as engine,
    ):
        engine.initialize()
        engine.run(10)
    asked = ["GetBooleanStatus"] if status == DISCARD and fmi == "2.0" else []
    assert after(calls(), "DoStep") == [*asked, *then]
    assert not [line for line in calls() if "ILLEGAL" in line]


def test_a_pending_step_is_not_freed(fmus, calls) -> None:
    with (
        pytest.raises(RunError, match="doStep returned pending"),
        Engine(plan_that(fmus["2.0"], RETURNS, PENDING, when=0.0)) as engine,
    ):
        engine.initialize()
        engine.run(10)
    assert after(calls(), "DoStep") == []


def test_after_fatal_no_instance_of_that_fmu_is_called(fmus, calls) -> None:
    fails = {"how": float(RETURNS), "status": float(FATAL), "when": 0.0}
    with (
        pytest.raises(RunError, match="a: doStep returned fatal"),
        Engine(chain(fmus["2.0"], fmus["2.0"], isolate=False, **fails)) as engine,
    ):
        engine.initialize()
        engine.run(10)
    assert after(calls(), "DoStep") == []


@ALL
@ISOLATE
def test_a_whole_run_keeps_to_the_state_machine(fmus, calls, fmi: str, isolate: bool) -> None:
    completed(plan_that(fmus[fmi], NORMAL, isolate=isolate, gain=3.0))
    found = calls()
    assert not [line for line in found if "ILLEGAL" in line]
    assert found[-2:] == ["Terminate", "FreeInstance"]
    setting = "SetReal start" if fmi == "2.0" else "SetFloat64 start"
    entered = found.index("EnterInitializationMode")
    assert found.index(setting) < entered
    if fmi == "2.0":
        assert found.index("SetupExperiment") < found.index(setting)


@ALL
def test_what_was_not_initialized_is_not_terminated(fmus, calls, fmi: str) -> None:
    component = FmuComponent(fmus[fmi], "x")
    component.initialize({})
    component.close()
    assert after(calls(), "EnterInitializationMode") == ["FreeInstance"]


# ---- an FMU that wants to end -------------------------------------------------------------------


@ISOLATE
def test_fmi2_is_asked_after_discard_and_ends_the_run(fmus, calls, isolate: bool) -> None:
    plan = plan_that(fmus["2.0"], ENDS, when=0.25, isolate=isolate)
    record = np.full((10, plan.n_signals), -1.0)
    with Engine(plan) as engine:
        engine.initialize()
        assert engine.run(10, record) == 4
    assert engine.ended == Termination("x", pytest.approx(0.325))
    assert str(engine.ended) == "ended by x at t = 0.325 s"
    assert engine.tick == 3
    assert after(calls(), "DoStep") == [
        "GetBooleanStatus", "GetRealStatus", "Terminate", "FreeInstance",
    ]  # fmt: skip
    assert not [line for line in calls() if "ILLEGAL" in line]


@ISOLATE
@pytest.mark.parametrize(
    ("fmi", "how", "time"),
    [("3.0", ENDS, 0.35), ("3.0 events", ENDS, 0.35), ("3.0 events", EVENT, 0.4)],
)
def test_fmi3_ends_the_run_after_its_step(fmus, calls, isolate, fmi, how, time) -> None:
    plan = plan_that(fmus[fmi], how, when=0.25, isolate=isolate)
    record = np.full((10, plan.n_signals), -1.0)
    with Engine(plan) as engine:
        engine.initialize()
        assert engine.run(10, record) == 4
        assert engine.run(6, record) == 0
        last = engine.signals.copy()
    assert engine.ended == Termination("x", pytest.approx(time))
    assert engine.tick == 4
    assert last[plan.slots()["x.y"].start] == pytest.approx(1.8)
    assert not [line for line in calls() if "ILLEGAL" in line]
    assert calls()[-2:] == ["Terminate", "FreeInstance"]


@ISOLATE
def test_an_fmu_may_end_the_run_in_the_event_at_its_start(fmus, calls, isolate) -> None:
    plan = plan_that(fmus["3.0 events"], EVENT, when=-1.0, isolate=isolate)
    with Engine(plan) as engine:
        engine.initialize()
        assert engine.run(10) == 0
    assert engine.ended == Termination("x", 0.0)
    assert "DoStep" not in calls()
    assert not [line for line in calls() if "ILLEGAL" in line]
