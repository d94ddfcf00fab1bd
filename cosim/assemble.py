"""Scenario -> components, wires and links that fit together -> plan.

Here names become objects. Shapes and units of every wire are checked; every error names its place
in the scenario.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from cosim.component import Component, Parameter, Port
from cosim.errors import PlanError, ScenarioError, UnitError
from cosim.fmi import FmuComponent
from cosim.links.spec import link_table
from cosim.models import load_component
from cosim.plan import Link, Plan, Slot, Step, Wire, compile_plan
from cosim.scenario import ComponentSpec, LinkSpec, Scenario, WireSpec, numbers
from cosim.units import Unit, conversion

_ENDPOINT = re.compile(r"([A-Za-z_]\w*)\.([^\[\]]+?)(?:\[(\d+(?:,\d+)*)\])?$")


def assemble(scenario: Scenario) -> Plan:
    """The plan of a scenario. Raises ScenarioError, FmuError or PlanError."""
    h = scenario.seconds(scenario.run.step, "run.step")
    stop = scenario.seconds(scenario.run.stop, "run.stop")
    if not 0 < h < float("inf") or not 0 < stop < float("inf"):
        raise ScenarioError(f"step {h} s and stop {stop} s must be positive", scenario.place("run"))
    ticks = _ticks(stop, h, scenario.place("run.stop"))
    steps = _steps(scenario, h)
    slots = {s.name: s for c in steps for s in (*c.inputs, *c.outputs)}
    by_name = {c.name: c for c in steps}
    wires = [w for c in steps for w in _wires(scenario, c, by_name, slots)]
    links = _links(scenario, h, ticks, by_name, slots)
    fed = [(w.target, w.source.name) for w in wires]
    fed += [(x.target, x.source.name) for x in links]
    fed += [(x.age, f"the age of {x.name}") for x in links if x.age is not None]
    _check_single_source(scenario, fed)
    _check_start_inputs(scenario, steps, {target.name for target, _ in fed})
    try:
        return compile_plan(h, ticks, steps, wires, links, scenario.run.algorithm)
    except PlanError as error:
        raise PlanError(f"{scenario.path}: {error}") from None


# ---- components -----------------------------------------------------------------------------


def _steps(scenario: Scenario, h: float) -> list[Step]:
    steps: list[Step] = []
    start = 0
    for name, spec in sorted(scenario.components.items()):
        place = scenario.place("components", name)
        component, presets = load_component(name, spec, scenario.path.parent, place)
        period = h
        if spec.period is not None:
            period = scenario.seconds(spec.period, "components", name, "period")
        inputs, start = _slots(name, component.inputs, start)
        outputs, start = _slots(name, component.outputs, start)
        values, starts = _values(spec, component, presets, place)
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
    spec: ComponentSpec, component: Component, presets: Mapping[str, Any], place: str
) -> tuple[dict[str, tuple[float, ...]], dict[str, tuple[float, ...]]]:
    """(parameters and start values, start values of inputs), flattened."""
    settable = {p.name: p for p in component.parameters}
    inputs = {p.name: p for p in component.inputs}
    given: dict[str, tuple[Any, str]] = {}
    if spec.preset is not None:
        if spec.preset not in presets:
            known = ", ".join(sorted(presets)) or "none"
            raise ScenarioError(f"no preset {spec.preset!r}; there are: {known}", f"{place}.preset")
        given |= {k: (v, f"{place}.preset") for k, v in presets[spec.preset].items()}
    given |= {k: (v, f"{place}.parameters.{k}") for k, v in spec.parameters.items()}
    given |= {k: (v, f"{place}.start.{k}") for k, v in spec.start.items()}
    values: dict[str, tuple[float, ...]] = {}
    starts: dict[str, tuple[float, ...]] = {}
    for key, (value, where) in given.items():
        if key in settable:
            p = settable[key]
            values[key] = numbers(value, p.shape, p.unit, where)
            _check_type(p, values[key], where)
        elif key in inputs:
            starts[key] = numbers(value, inputs[key].shape, inputs[key].unit, where)
        else:
            raise ScenarioError(_unknown(key, [*settable, *inputs], "parameter or start"), where)
    return values, starts


def _check_type(parameter: Parameter, values: tuple[float, ...], place: str) -> None:
    if parameter.type == "integer" and any(v != int(v) for v in values):
        raise ScenarioError(f"{parameter.name} is an integer, found {list(values)}", place)
    if parameter.type == "boolean" and any(v not in (0.0, 1.0) for v in values):
        raise ScenarioError(f"{parameter.name} is a Boolean, found {list(values)}", place)


def _unknown(name: str, known: Iterable[str], what: str) -> str:
    names = sorted(known)
    close = difflib.get_close_matches(name, names, 1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    return f"no {what} {name!r}{hint} (there are: {', '.join(names) or 'none'})"


# ---- connections ----------------------------------------------------------------------------


def _wires(
    scenario: Scenario, step: Step, steps: Mapping[str, Step], slots: Mapping[str, Slot]
) -> list[Wire]:
    wires = []
    for port, source in scenario.components[step.name].inputs.items():
        place = scenario.place("components", step.name, "inputs", port)
        spec = source if isinstance(source, WireSpec) else WireSpec(source=source)
        target = _endpoint(f"{step.name}.{port}", "input", steps, slots, place)
        origin = _endpoint(spec.source, "output", steps, slots, place)
        gain, offset = _fit(origin, target, steps, place)
        wires.append(Wire(origin, target, spec.gain * gain, spec.gain * offset + spec.offset))
    return wires


def _links(
    scenario: Scenario,
    h: float,
    ticks: int,
    steps: Mapping[str, Step],
    slots: Mapping[str, Slot],
) -> list[Link]:
    links: list[Link] = []
    for i, spec in enumerate(scenario.links):
        place = scenario.place("links", i)
        source = _endpoint(spec.source, "output", steps, slots, f"{place}.from")
        target = _endpoint(spec.target, "input", steps, slots, f"{place}.to")
        gain, offset = _fit(source, target, steps, place)
        name = spec.name or f"{source.name}->{target.name}"
        if name in {x.name for x in links}:
            raise ScenarioError(f"a second link is called {name!r}", place)
        table = link_table(
            delay=spec.delay,
            loss=spec.loss,
            semantics=spec.semantics,
            playout=spec.playout,
            name=spec.channel or name,
            seed=scenario.run.seed,
            h=h,
            sender_period=steps[source.component].period,
            receiver_period=steps[target.component].period,
            folder=scenario.path.parent,
            place=place,
            ticks=ticks,
        )
        initial = _initial(spec, target, place)
        age = _age(spec, target, steps, slots, place)
        links.append(Link(name, source, target, table, gain, offset, initial, age))
    return links


def _age(
    spec: LinkSpec,
    target: Slot,
    steps: Mapping[str, Step],
    slots: Mapping[str, Slot],
    place: str,
) -> Slot | None:
    if not spec.age:
        return None
    age = _endpoint(spec.age, "input", steps, slots, f"{place}.age")
    if age.component != target.component or age.size != 1:
        raise ScenarioError(
            f"{age.name} is to get the age of {target.name}; expected a scalar input of "
            f"{target.component}",
            f"{place}.age",
        )
    return age


def _initial(spec: LinkSpec, target: Slot, place: str) -> tuple[float, ...] | None:
    if spec.initial is None:
        return None
    return numbers(spec.initial, target.shape, target.unit, f"{place}.initial")


def _endpoint(
    text: str,
    causality: str,
    steps: Mapping[str, Step],
    slots: Mapping[str, Slot],
    place: str,
) -> Slot:
    """The slot ``component.port`` or ``component.port[i]`` names."""
    match = _ENDPOINT.match(text)
    if match is None:
        raise ScenarioError(f"{text!r} is no endpoint; expected 'component.port'", place)
    name, port, index = match[1], match[2], match[3]
    if name not in steps:
        raise ScenarioError(_unknown(name, steps, "component"), place)
    step = steps[name]
    found = {s.port: s for s in (step.inputs if causality == "input" else step.outputs)}
    if port not in found:
        other = step.outputs if causality == "input" else step.inputs
        if any(s.port == port for s in other):
            raise ScenarioError(f"{name}.{port} is not an {causality}", place)
        raise ScenarioError(_unknown(port, found, f"{causality} of {name}"), place)
    return _part(found[port], index, place) if index else found[port]


def _part(slot: Slot, index: str, place: str) -> Slot:
    at = tuple(int(i) for i in index.split(","))
    if len(at) > len(slot.shape) or any(i >= n for i, n in zip(at, slot.shape, strict=False)):
        raise ScenarioError(
            f"[{index}] is outside of {slot.name}, which has shape {list(slot.shape)}", place
        )
    start, shape = slot.start, slot.shape
    for i in at:
        shape = shape[1:]
        part = replace(slot, shape=shape)
        start += i * part.size
    return replace(slot, name=f"{slot.name}[{index}]", start=start, shape=shape)


def _fit(source: Slot, target: Slot, steps: Mapping[str, Step], place: str) -> tuple[float, float]:
    """(gain, offset) between two slots of one shape. Raises ScenarioError."""
    if source.shape != target.shape:
        raise ScenarioError(
            f"{source.name} has shape {list(source.shape)}, {target.name} expects "
            f"{list(target.shape)}",
            place,
        )
    if source.unit == target.unit:
        return 1.0, 0.0
    try:
        return conversion(_unit(source, steps), _unit(target, steps))
    except UnitError:
        raise ScenarioError(
            f"units do not fit: {source.name} is in [{source.unit}], {target.name} expects "
            f"[{target.unit}]",
            place,
        ) from None


def _unit(slot: Slot, steps: Mapping[str, Step]) -> str | Unit:
    component = steps[slot.component].component
    if isinstance(component, FmuComponent):
        return component.description.units.get(slot.unit, slot.unit)
    return slot.unit


def _check_single_source(scenario: Scenario, fed: Iterable[tuple[Slot, str]]) -> None:
    sources: dict[int, str] = {}
    for target, source in fed:
        for i, scalar in enumerate(target.scalars()):
            at = target.start + i
            if at in sources:
                raise ScenarioError(
                    f"{scalar} is fed twice: by {sources[at]} and by {source}", str(scenario.path)
                )
            sources[at] = source


def _check_start_inputs(scenario: Scenario, steps: list[Step], fed: set[str]) -> None:
    for step in steps:
        for port in step.start:
            if f"{step.name}.{port}" in fed:
                raise ScenarioError(
                    f"{step.name}.{port} is fed by a connection; a start value would not be used",
                    scenario.place("components", step.name, "start", port),
                )


# ---- ticks ----------------------------------------------------------------------------------


def _ticks(seconds: float, h: float, place: str) -> int:
    """How many base steps `seconds` are. Raises ScenarioError when they are not a whole number."""
    ticks = round(seconds / h)
    if ticks < 1 or abs(ticks * h - seconds) > 1e-9 * max(seconds, h):
        near = ", ".join(
            f"{n * h:g}" for n in sorted({max(1, int(seconds / h)), int(seconds / h) + 1})
        )
        raise ScenarioError(
            f"{seconds:g} s is not a multiple of the base step {h:g} s (nearest: {near} s)", place
        )
    return ticks
