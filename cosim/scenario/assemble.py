"""Scenario -> components and connections that fit together -> plan.

Here names become objects: components with their values, and the ticks of their periods. What runs
between them is :mod:`cosim.scenario.connect`'s. Every error names its place in the scenario.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from cosim.base.component import Component, NativeComponent, Parameter, Port, Preparation
from cosim.base.convert import numbers
from cosim.base.errors import FmuError, PlanError, ScenarioError
from cosim.base.garbage import without_collections
from cosim.fmi.component import FmuComponent
from cosim.fmi.components import discrete_inputs, fmu_of, is_fmu, sloped_inputs
from cosim.scenario import connect
from cosim.scenario.connect_links import links as connected_links
from cosim.scenario.connect_links import stepped_buses
from cosim.scenario.exposed import ExposedVariables
from cosim.scenario.models import LoadedComponent, load_alike, load_component
from cosim.scenario.spec import ComponentSpec, InputSpec, Scenario
from cosim.schedule.parts import Player, Slot, Step
from cosim.schedule.plan import Plan, compile_plan

#: Ticks of a run: a tick is a whole number that float64 has exactly, and in ns it has 64 bits.
MOST_TICKS = 2**53


#: What loads a component: as :func:`cosim.scenario.models.load_component`.
Load = Callable[[str, ComponentSpec, Path, str], LoadedComponent]


def assemble(scenario: Scenario, load: Load = load_component) -> Plan:
    """The plan of a scenario. Raises ScenarioError, FmuError or PlanError."""
    with without_collections():
        return _assemble(scenario, load)


def _assemble(scenario: Scenario, load: Load) -> Plan:
    parts = scenario_components(scenario, load)
    if any(spec.bus for spec in scenario.components.values()):
        from cosim.scenario.bus_nodes import connect_nodes

        connect_nodes(scenario, list(parts.steps.values()))
    wires, links, players = connect.wires(parts), connected_links(parts), _players(parts)
    connect.check_single_sources(parts, wires, links, players)
    adaptive = None
    if scenario.run.algorithm == "adaptive" or scenario.run.adaptive is not None:
        from cosim.scenario.macro import adaptive_settings

        adaptive = adaptive_settings(scenario)
    try:
        plan = compile_plan(
            parts.h, parts.ticks, list(parts.steps.values()), wires, links,
            scenario.run.algorithm, players, scenario.run.order,
            buses=stepped_buses(parts, links), adaptive=adaptive,
        )  # fmt: skip
    except PlanError as error:
        raise PlanError(f"{scenario.path}: {error}") from None
    if plan.groups:
        from cosim.scenario.macro import check_groups

        check_groups(plan, scenario)
    return plan


def _players(parts: connect.ScenarioComponents) -> list[Player]:
    """The inputs that get values over time: weights of edges, tables, events."""
    given = [x for c in parts.scenario.components.values() for x in c.inputs.values()]
    tables = any(isinstance(x, InputSpec) and not x.source for x in given)
    if not (tables or parts.scenario.events):
        return connect.weight_players(parts)
    from cosim.scenario.timed import event_players, table_players

    return [*connect.weight_players(parts), *table_players(parts), *event_players(parts)]


def scenario_components(
    scenario: Scenario, load: Load = load_component
) -> connect.ScenarioComponents:
    """The components of a scenario with their ticks. Raises ScenarioError, FmuError."""
    h = scenario.seconds(scenario.run.step, "run.step")
    stop = scenario.seconds(scenario.run.stop, "run.stop")
    if not 0 < h < float("inf") or not 0 < stop < float("inf"):
        raise ScenarioError(f"step {h} s and stop {stop} s must be positive", scenario.place("run"))
    ticks = _ticks(stop, h, scenario.place("run.stop"))
    steps = _steps(scenario, h, load)
    return connect.ScenarioComponents(scenario, {c.name: c for c in steps}, h, ticks)


def _steps(scenario: Scenario, h: float, load: Load) -> list[Step]:
    steps: list[Step] = []
    start = 0
    load = load_alike() if load is load_component else load
    exposed = ExposedVariables(scenario)
    for name, spec in sorted(scenario.components.items()):
        place = scenario.place("components", name)
        component, presets, prepared = load(name, spec, scenario.path.parent, place)
        exposed.expose(name, component)
        period = h
        if spec.period is not None:
            period = scenario.seconds(spec.period, "components", name, "period")
        if not is_fmu(component) and isinstance(component, NativeComponent):
            component.check_period(period, f"{place}.period")
        inputs, start = _slots(name, component.inputs, start)
        outputs, start = _slots(name, component.outputs, start)
        values, starts = _values(spec, component, presets, prepared, place)
        steps.append(
            Step(
                name=name,
                component=component,
                kind=component.kind,
                period=_ticks(period, h, scenario.place("components", name, "period")),
                values=values,
                inputs=inputs,
                outputs=outputs,
                start=starts,
                extrapolate=spec.extrapolate == "linear",
                discrete=discrete_inputs(component),
                sloped=sloped_inputs(component),
                files=prepared.files,
            )
        )
    return steps


def _slots(name: str, ports: Iterable[Port], start: int) -> tuple[tuple[Slot, ...], int]:
    slots = []
    for port in ports:
        slots.append(Slot(f"{name}.{port.name}", name, port.name, start, port.shape, port.unit))
        start += port.size
    return tuple(slots), start


def _values(
    spec: ComponentSpec,
    component: Component,
    presets: Mapping[str, Any],
    prepared: Preparation,
    place: str,
) -> tuple[dict[str, tuple[float, ...]], dict[str, tuple[float, ...]]]:
    """(parameters and start values, start values of inputs), flattened."""
    settable = {p.name: p for p in component.parameters}
    inputs = {p.name: p for p in component.inputs}
    given: dict[str, tuple[Any, str]] = {
        k: (v, f"{place}.options") for k, v in prepared.values.items()
    }
    if spec.preset is not None:
        if spec.preset not in presets:
            raise ScenarioError(connect.unknown(spec.preset, presets, "preset"), f"{place}.preset")
        given |= {k: (v, f"{place}.preset") for k, v in presets[spec.preset].items()}
    given |= {k: (v, f"{place}.parameters.{k}") for k, v in spec.parameters.items()}
    given |= {k: (v, f"{place}.start.{k}") for k, v in spec.start.items()}
    values: dict[str, tuple[float, ...]] = {}
    starts: dict[str, tuple[float, ...]] = {}
    fmu = fmu_of(component)
    for key, (value, where) in given.items():
        if fmu is not None and key in fmu.taken:
            continue
        if key in settable:
            values[key] = _numbers(fmu, settable[key], value, where)
            _check_type(settable[key], values[key], where)
        elif key in inputs:
            starts[key] = _numbers(fmu, inputs[key], value, where)
        else:
            raise ScenarioError(
                connect.unknown(key, [*settable, *inputs], "parameter or start"), where
            )
    return values, starts


def _numbers(
    fmu: FmuComponent | None, p: Parameter | Port, value: Any, place: str
) -> tuple[float, ...]:
    """Values of a parameter or port, in an FMU with its own units and names of items."""
    if fmu is None:
        return numbers(value, p.shape, p.unit, place)
    try:
        value = fmu.number(p.name, value)
    except FmuError as error:
        raise ScenarioError(str(error), place) from None
    return numbers(value, p.shape, fmu.unit(p.unit), place)


def _check_type(parameter: Parameter, values: tuple[float, ...], place: str) -> None:
    if parameter.type == "integer" and any(v != int(v) for v in values):
        raise ScenarioError(f"{parameter.name} is an integer, found {list(values)}", place)
    if parameter.type == "boolean" and any(v not in (0.0, 1.0) for v in values):
        raise ScenarioError(f"{parameter.name} is a Boolean, found {list(values)}", place)


# ---- ticks ----------------------------------------------------------------------------------


def _ticks(seconds: float, h: float, place: str) -> int:
    """How many base steps `seconds` are. Raises ScenarioError when they are not a whole number."""
    if seconds / h > MOST_TICKS:
        raise ScenarioError(
            f"{seconds:g} s are {seconds / h:.3g} base steps of {h:g} s; expected at most "
            f"{MOST_TICKS:.3g}", place
        )  # fmt: skip
    ticks = round(seconds / h)
    if ticks < 1 or abs(ticks * h - seconds) > 1e-9 * max(seconds, h):
        near = ", ".join(
            f"{n * h:g}" for n in sorted({max(1, int(seconds / h)), int(seconds / h) + 1})
        )
        raise ScenarioError(
            f"{seconds:g} s is not a multiple of the base step {h:g} s (nearest: {near} s)", place
        )
    return ticks
