"""Sorts of components: what they share changes nothing of the plan."""

import math
from pathlib import Path
from typing import Any

import pytest

from cosim.base.component import Component, Parameter, Port
from cosim.base.errors import ScenarioError
from cosim.fmi.components import fmu_of, model_name
from cosim.loading.files import load
from cosim.scenario import assemble as assembling
from cosim.scenario.assemble import assemble
from cosim.scenario.component_types import Ports, Sort, Sorts
from cosim.scenario.models import load_component
from cosim.schedule.plan import Plan
from tests.cosim.scenarios import plan

MANY = Path(__file__).parents[3] / "configs" / "many.toml"
DIFFERENT = (
    "graphs.net.n=9",
    "components.robot.each.2.start.dq=[1, 2]",
    "components.robot.each.3.parameters.k_w=[0.5, 0.25]",
    "components.control.each.4.period='10 ms'",
    "components.robot.each.5.fmi='3.0'",
    'components.robot.each.6={ inputs = { tau = { from = "control6.tau", gain = 2.0 } } }',
    'run.record.signals=["robot{i}.q", "robot7.theta", "robot8.k_p[1]"]',
)


def alone(_: Sorts, component: Component) -> Sort:
    return Sort(component, (component.inputs, component.outputs, component.parameters))


def contents(found: Plan) -> list[object]:
    """Everything of a plan but the components and tables, which are compared by what they are."""
    steps = [
        (s.name, s.kind, s.period, list(s.values.items()), s.inputs, s.outputs,
         list(s.start.items()), s.discrete, s.sloped, s.component.inputs, s.component.outputs,
         model_name(s.component))
        for s in found.components
    ]  # fmt: skip
    links = [(x.name, x.source, x.target, x.table.facts(), x.gain, x.offset) for x in found.links]
    return [steps, found.wires, links, found.operations, found.order, found.n_signals]


def test_robots_of_one_sort_are_planned_as_if_each_were_the_only_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = assemble(load(MANY, DIFFERENT))
    assert all(fmu_of(s.component).name == s.name for s in made.components)  # type: ignore[union-attr]
    outputs = {s.name: {slot.port for slot in s.outputs} for s in made.components}
    assert outputs["robot7"] - outputs["robot1"] == {"theta"}
    assert outputs["robot8"] - outputs["robot1"] == {"k_p"}
    together = contents(made)
    monkeypatch.setattr(Sorts, "of", alone)
    monkeypatch.setattr(assembling, "load_alike", lambda: load_component)
    assert contents(assemble(load(MANY, DIFFERENT))) == together


TREE = "graphs.net={kind='tree', n=3}"


def test_a_robot_without_neighbours_needs_no_gain_of_the_coupling() -> None:
    """The root of a tree receives from nobody; one table of parameters serves it as well."""
    values = {s.name: s.values for s in assemble(load(MANY, (TREE,))).components}
    assert values["control2"]["lambda"] == values["control3"]["lambda"] == (1.0,)
    assert "lambda" not in values["control1"] and values["control1"]["alpha"] == (1.6,)


@pytest.mark.parametrize("key", ["lamda", "sizes"])
def test_a_parameter_that_no_robot_has_is_refused_of_one_without_neighbours_too(key: str) -> None:
    with pytest.raises(ScenarioError, match=f"control1.parameters.{key}: no parameter or start"):
        assemble(load(MANY, (TREE, f"components.control.each.1.parameters.{key}=1")))


def test_a_size_that_a_model_does_not_take_is_refused_before_its_parameters() -> None:
    sizes = ("components.robot.sizes.links=0", "components.robot.parameters.lambda=1")
    with pytest.raises(ScenarioError, match=r"robot1\.sizes"):
        assemble(load(MANY, sizes))


def test_equal_values_that_are_not_the_same_are_kept_apart() -> None:
    """0.0 equals -0.0."""
    starts = {"a": 0.0, "b": -0.0, "c": 0.0}
    found = plan({k: {"model": "Integrator", "start": {"x": x}} for k, x in starts.items()})
    assert [math.copysign(1, s.values["x"][0]) for s in found.components] == [1, -1, 1]


class Made:
    """A component that makes its ports whenever it is asked."""

    kind = "sampled"
    outputs: tuple[Port, ...] = ()
    parameters: tuple[Parameter, ...] = ()

    def __init__(self, unit: str) -> None:
        self.unit = unit

    @property
    def inputs(self) -> tuple[Port, ...]:
        return (Port("u", (), self.unit),)


def test_ports_that_are_made_anew_do_not_confuse_sorts() -> None:
    sorts = Sorts()
    units = ["s", "ms", "min", "h"] * 5
    found = [sorts.of(Made(unit)) for unit in units]  # type: ignore[arg-type]
    assert [sort.slots("x", 7, {})[0][0].unit for sort in found] == units


def test_units_are_converted_for_each_sort_at_both_ends() -> None:
    inputs = {"inputs": {"u": "clock.y[0]"}}
    found = plan({
        "clock": {"model": "Clock"},
        "a": {"model": "Milliseconds", **inputs}, "b": {"model": "Pair", **inputs},
        "c": {"model": "Milliseconds", **inputs},
        "d": {"model": "Milliseconds", "inputs": {"u": "watch.y[1]"}},
        "watch": {"model": "Clock"},
    })  # fmt: skip
    gains = {w.target.component: w.gain for w in found.wires}
    assert gains == {"a": 1e3, "b": 1.0, "c": 1e3, "d": 1e3}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"start": {"w": 1}}, "components.b.start.w: no parameter or start 'w'"),
        ({"parameters": {"w": 1}}, "components.b.parameters.w: no parameter or start 'w'"),
        ({"inputs": {"u": "clock.y"}}, r"clock.y has shape \[2\], b.u expects \[\]"),
        ({"inputs": {"u": ""}}, "components.b.inputs.u: found none of from, table, points"),
    ],
)
def test_what_is_wrong_in_the_second_of_a_sort_is_refused(
    change: dict[str, Any], said: str
) -> None:
    given = {"model": "Milliseconds", "inputs": {"u": "clock.y[0]"}}
    with pytest.raises(ScenarioError, match=said):
        plan({"clock": {"model": "Clock"}, "a": given, "b": {**given, **change}})


def test_slots_follow_each_other() -> None:
    ports: Ports = ((Port("u", (2,)), Port("v")), (Port("y", (2, 3)), Port("z")), ())
    component = Made("s")
    inputs, outputs, end = Sort(component, ports).slots("x", 10, {})  # type: ignore[arg-type]
    assert [(s.name, s.start, s.shape) for s in (*inputs, *outputs)] == [
        ("x.u", 10, (2,)), ("x.v", 12, ()), ("x.y", 13, (2, 3)), ("x.z", 19, ()),
    ]  # fmt: skip
    assert end == 20
