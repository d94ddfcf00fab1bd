"""Many FMUs that start together: the calls of each, and what is said of the one that fails."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from cosim.base.component import Component, Port
from cosim.base.errors import ScenarioError
from cosim.engine.engine import Engine
from cosim.fmi import FmuComponent
from cosim.scenario.component_types import Sorts
from cosim.schedule.parts import Step, Wire
from cosim.schedule.plan import Plan, compile_plan
from fmus.models import planar2r
from tests.cosim.fmi.exporter import export, strict2, strict3

MANY, BAD = 20, 13
LOGGED = "the FMU logged nothing; log = true in its component, or --fmu-log, may tell more"
JUMPS = 4
Values = dict[str, tuple[float, ...]]


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("strict")
    return {
        fmi: export(text, folder / f"{fmi}.fmu")
        for fmi, text in (("2.0", strict2()), ("3.0", strict3()))
    }


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], list[str]]:
    """The calls since they were asked for last."""
    path = tmp_path / "calls"
    monkeypatch.setenv("STRICT_CALLS", str(path))

    def found() -> list[str]:
        lines = path.read_text().splitlines()
        path.unlink()
        return lines

    return found


def plan_of_many(
    components: Sequence[Component], values: Sequence[Values], wires: Sequence[tuple[int, int]] = ()
) -> Plan:
    """Components x00, x01, ...; wires go from the first output to the first input, times 2."""
    at, steps, sorts = 0, [], Sorts()
    for i, (component, given) in enumerate(zip(components, values, strict=True)):
        name = f"x{i:02}"
        inputs, outputs, at = sorts.of(component).slots(name, at, {})
        steps.append(Step(name, component, component.kind, 1, given, inputs, outputs, {}))
    made = [Wire(steps[a].outputs[0], steps[b].inputs[0], 2.0, 0.5) for a, b in wires]
    return compile_plan(0.1, 3, steps, made, [])


def strict(path: Path, values: Sequence[Values], wires: Sequence[tuple[int, int]] = ()) -> Plan:
    components = [FmuComponent(path, f"x{i:02}") for i in range(len(values))]
    return plan_of_many(components, values, wires)


def failure(plan: Plan) -> str:
    with Engine(plan) as engine, pytest.raises(ScenarioError) as caught:
        engine.initialize()
    return str(caught.value)


#: Two kinds, and their FMUs take turns: one has its parameter set.
VALUES: list[Values] = [{"gain": (float(i),)} if i % 3 else {} for i in range(MANY)]


@pytest.mark.parametrize(
    ("fmi", "call", "terminated"),
    [
        *[("2.0", x, 0) for x in ("SetupExperiment", "SetReal", "EnterInitializationMode")],
        *[("2.0", "SetReal start", 0), ("3.0", "SetFloat64 start", 0)],
        *[("2.0", "GetReal", 0), ("2.0", "ExitInitializationMode", BAD)],
        *[("3.0", x, 0) for x in ("SetFloat64", "EnterInitializationMode", "GetFloat64")],
        ("3.0", "ExitInitializationMode", BAD),
    ],
)
def test_the_call_that_one_of_many_refuses_is_named(
    fmus, calls, monkeypatch: pytest.MonkeyPatch, fmi: str, call: str, terminated: int
) -> None:
    """The others are terminated if they have left Initialization Mode, and all are freed."""
    monkeypatch.setenv("STRICT_REFUSES", f"x{BAD} {call}")
    said = failure(strict(fmus[fmi], VALUES))
    assert said == f"x{BAD} does not start: fmi{fmi[0]}{call.split()[0]} returned error: {LOGGED}"
    made = Counter(calls())
    assert made["Instantiate"] == made["FreeInstance"] == MANY
    assert made["Terminate"] == terminated
    assert made["ExitInitializationMode"] == (terminated + 1 if terminated else 0)
    assert not any("ILLEGAL" in line for line in made)


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_one_of_many_that_cannot_be_instantiated_is_named(fmus, monkeypatch, fmi: str) -> None:
    monkeypatch.setenv("STRICT_REFUSES", f"x{BAD} Instantiate")
    what = "Instantiate" if fmi == "2.0" else "InstantiateCoSimulation"
    said = failure(strict(fmus[fmi], VALUES))
    assert said == f"x{BAD} does not start: fmi{fmi[0]}{what} failed: {LOGGED}"


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_each_of_many_gets_the_calls_that_it_gets_alone(fmus, calls, fmi: str) -> None:
    found = []
    for values in ([VALUES[1]], [VALUES[0]], [*VALUES[:6]]):
        with Engine(strict(fmus[fmi], values)) as engine:
            engine.initialize()
        found.append(Counter(calls()))
    alone, unset, many = found
    assert alone != unset
    assert many == Counter({k: 4 * alone[k] + 2 * unset[k] for k in alone | unset})


def test_a_value_that_one_of_many_does_not_take_is_named(fmus) -> None:
    values: list[Values] = [{"how": (0.0,), "gain": (5.0,)} for _ in range(MANY)]
    values[BAD] = {"how": (3.0,), "gain": (5.0,)}
    assert failure(strict(fmus["2.0"], values)) == (
        f"x{BAD} does not start: the FMU did not accept these values: parameter gain was set to 5, "
        "after initialization it is 2; set a value that it accepts, or leave it out"
    )


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (-1.0, "k_p = -1 is below its minimum 0"),
        (float("nan"), "k_p = nan is not a valid Real; expected a number from -inf to inf"),
    ],
)
def test_a_start_value_of_one_of_many_that_is_not_allowed_is_named(value: float, said: str) -> None:
    values: list[Values] = [{"k_p": (1.0, float(i))} for i in range(MANY)]
    values[BAD] = {"k_p": (1.0, value)}
    components = [FmuComponent(planar2r.fmu("2.0"), f"x{i:02}") for i in range(MANY)]
    assert failure(plan_of_many(components, values)) == f"x{BAD} does not start: {said}"


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_outputs_that_change_on_leaving_reach_those_behind_and_before(fmus, calls, fmi) -> None:
    """Each gives 0 until it has left Initialization Mode, and then its gain.

    Inputs are set once for all, and again in the three that are fed by one that leaves sooner.
    """
    values: list[Values] = [{"how": (float(JUMPS),), "gain": (i + 1.0,)} for i in range(6)]
    wires = [(0, 1), (1, 2), (5, 3), (4, 0), (2, 5)]
    plan = strict(fmus[fmi], values, wires)
    with Engine(plan) as engine:
        engine.initialize()
        signals = engine.signals
        outputs = [float(signals[s.outputs[0].start]) for s in plan.components]
        inputs = [float(signals[s.inputs[0].start]) for s in plan.components]
    assert outputs == [i + 1.0 for i in range(6)]
    assert inputs[1:4] == [2.5, 4.5, 12.5] and (inputs[0], inputs[5]) == (10.5, 6.5)
    assert inputs[4] == 0.0  # nothing feeds it
    assert Counter(calls())["SetReal" if fmi == "2.0" else "SetFloat64"] == 6 + 3


class Passing:
    """A Python component whose output is its input."""

    kind = "continuous"
    inputs = (Port("u"),)
    outputs = (Port("y"),)
    parameters = ()

    def initialize(self, values):
        self.asked = 0

    def initial(self, u):
        self.asked += 1
        return {"y": u["u"]}

    def step(self, t, h, u):
        return {"y": u["u"]}


def test_values_travel_against_the_order_of_components(fmus) -> None:
    """Each component is asked once, and again for each new input."""
    components: list[Component] = [Passing() for _ in range(5)]
    components.append(FmuComponent(fmus["2.0"], "x05"))
    plan = plan_of_many(components, [{}] * 5 + [{"x": (4.0,)}], [(i + 1, i) for i in range(5)])
    with Engine(plan) as engine:
        engine.initialize()
        outputs = [float(engine.signals[s.outputs[0].start]) for s in plan.components]
    assert outputs == [4.0 * 2**n + 0.5 * (2**n - 1) for n in (5, 4, 3, 2, 1, 0)]
    assert [x.asked for x in components[:5]] == [6, 5, 4, 3, 2]
