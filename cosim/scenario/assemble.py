"""Scenario -> components and connections that fit together -> plan.

Here names become objects: components with their values, and the ticks of their periods. What runs
between them is :mod:`cosim.scenario.connect`'s. Every error names its place in the scenario.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from cosim.base.component import Component, NativeComponent, Preparation
from cosim.base.convert import Number
from cosim.base.errors import CosimError, PlanError, ScenarioError
from cosim.base.python import without_collections
from cosim.fmi.components import fmu_of, is_fmu
from cosim.scenario import connect
from cosim.scenario.component_types import Sort, Sorts
from cosim.scenario.connect_links import computed, stepped_buses
from cosim.scenario.connect_links import links as connected_links
from cosim.scenario.exposed import ExposedVariables
from cosim.scenario.models import LoadedComponent, load_alike, load_component
from cosim.scenario.spec import ComponentSpec, InputSpec, Scenario
from cosim.schedule.parts import Player, Step
from cosim.schedule.plan import Plan, compile_plan

#: Ticks of a run: a tick is a whole number that float64 has exactly, and in ns it has 64 bits.
MOST_TICKS = 2**53


#: A function that loads a component, like :func:`cosim.scenario.models.load_component`.
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
    wires, late = computed(parts, connect.wires(parts))
    links, players = [*connected_links(parts), *late], _players(parts)
    connect.check_single_sources(parts, wires, links, players)
    adaptive = None
    if scenario.run.algorithm == "adaptive" or scenario.run.adaptive is not None:
        from cosim.scenario.macro import adaptive_settings

        adaptive = adaptive_settings(scenario)
    try:
        plan = compile_plan(
            parts.h, parts.ticks, list(parts.steps.values()), wires, links,
            scenario.run.algorithm, players, scenario.run.order,
            buses=stepped_buses(parts, links), adaptive=adaptive, start=parts.start,
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
    start = _start(scenario, stop)
    if not 0 < h < float("inf") or not start < stop < float("inf"):
        raise ScenarioError(f"step {h} s and stop {stop} s must be positive", scenario.place("run"))
    ticks = _ticks(stop - start, h, scenario.place("run.stop"))
    sorts: dict[str, Sort] = {}
    steps = _steps(scenario, h, load, sorts)
    return connect.ScenarioComponents(scenario, {c.name: c for c in steps}, h, ticks, sorts, start)


def _start(scenario: Scenario, stop: float) -> float:
    """The time at which a run begins, s. Raises ScenarioError for one that cannot be."""
    start, place = scenario.seconds(scenario.run.start, "run.start"), scenario.place("run.start")
    if start and not -float("inf") < start < stop:
        raise ScenarioError(
            f"found {start:g} s, expected a time before run.stop, {stop:g} s", place
        )
    if start and scenario.buses:
        named = ", ".join(scenario.buses)
        raise ScenarioError(
            f"found {start:g} s in a scenario with simulated buses ({named}), whose time begins at "
            "0; expected 0", place
        )  # fmt: skip
    return start


def _steps(scenario: Scenario, h: float, load: Load, sorts: dict[str, Sort]) -> list[Step]:
    """The components, sorted by name; `sorts` gets the sort of each."""
    steps: list[Step] = []
    start = 0
    load = load_alike() if load is load_component else load
    exposed, known = ExposedVariables(scenario), Sorts()
    ticks: dict[Number, int] = {}
    folder, components = scenario.path.parent, scenario.place("components")
    for name, spec in sorted(scenario.components.items()):
        place = f"{components}.{name}"
        component, presets, prepared = load(name, spec, folder, place)
        exposed.expose(name, component)
        period = h if spec.period is None else spec.period
        if period not in ticks:
            seconds = scenario.seconds(period, "components", name, "period")
            ticks[period] = _ticks(seconds, h, f"{place}.period")
        if not is_fmu(component) and isinstance(component, NativeComponent):
            component.check_period(scenario.seconds(period), f"{place}.period")
        sort = sorts[name] = known.of(component)
        if 0 in spec.sizes.values():
            spec = _effective(name, spec, sort, folder, place)
        inputs, outputs, start = sort.slots(name, start, prepared.units)
        values, starts = _values(spec, component, sort, presets, prepared, place)
        steps.append(
            Step(
                name=name,
                component=component,
                kind=component.kind,
                period=ticks[period],
                values=values,
                inputs=inputs,
                outputs=outputs,
                start=starts,
                extrapolate=spec.extrapolate == "linear",
                discrete=sort.discrete,
                sloped=sort.sloped,
                files=prepared.files,
                remarks=prepared.remarks,
            )
        )
    return steps


def _effective(
    name: str, spec: ComponentSpec, sort: Sort, folder: Path, place: str
) -> ComponentSpec:
    """The component without parameters that have no effect because a size of it is 0.

    Its model has them with a size of 1: the coupling gain of a robot, for instance, which belongs
    to each of its neighbours. So one table serves all robots of a graph.
    """
    unknown = spec.parameters.keys() - sort.parameters.keys() - sort.inputs.keys()
    if not unknown:
        return spec
    sizes = {size: n or 1 for size, n in spec.sizes.items()}
    larger = spec.replaced(sizes=sizes, parameters={}, start={})
    try:
        component, _, _ = load_component(name, larger, folder, place)
    except CosimError:
        return spec  # whose unknown parameter is refused
    unknown &= {p.name for p in component.parameters}
    left = {key: value for key, value in spec.parameters.items() if key not in unknown}
    return spec.replaced(parameters=left)


def _values(
    spec: ComponentSpec,
    component: Component,
    sort: Sort,
    presets: Mapping[str, Any],
    prepared: Preparation,
    place: str,
) -> tuple[dict[str, tuple[float, ...]], dict[str, tuple[float, ...]]]:
    """(parameters and start values, start values of inputs), flattened."""
    given: dict[str, tuple[Any, str]] = {k: (v, "options") for k, v in prepared.values.items()}
    if spec.preset is not None:
        if spec.preset not in presets:
            raise ScenarioError(connect.unknown(spec.preset, presets, "preset"), f"{place}.preset")
        given |= {k: (v, "preset") for k, v in presets[spec.preset].items()}
    given |= {k: (v, "parameters") for k, v in spec.parameters.items()}
    given |= {k: (v, "start") for k, v in spec.start.items()}
    given = sort.joined(given, place, prepared.units)
    fmu = fmu_of(component)
    taken = () if fmu is None else fmu.taken
    values: dict[str, tuple[float, ...]] = {}
    starts: dict[str, tuple[float, ...]] = {}
    for key, value in given.items():
        if key not in taken:
            into = values if key in sort.parameters else starts
            into[key] = sort.numbers(key, value, place, prepared.units)
    return values, starts


# ---- ticks ----------------------------------------------------------------------------------


def _ticks(seconds: float, h: float, place: str) -> int:
    """The number of base steps in `seconds`. Raises ScenarioError for no whole number."""
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
