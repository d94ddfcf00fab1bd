"""A scenario, linearized: which of its signals are inputs and outputs, and where."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.fmi.components import fmu_of, observable
from cosim.linear.loop import linear_loop, operating_point
from cosim.linear.model import LinearModel, reduced
from cosim.linear.opened import OpenLoop, open_loop
from cosim.loading.files import load
from cosim.scenario.assemble import assemble
from cosim.scenario.connect import unknown
from cosim.scenario.spec import Scenario
from cosim.schedule.parts import Slot, Step
from cosim.schedule.plan import Plan


def linearized(
    path: Path,
    settings: Sequence[str] = (),
    time: float | None = None,
    component: str = "",
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    size: float = 1e-3,
    say: Callable[[str], None] = lambda text: None,
) -> LinearModel:
    """The linear model of the scenario in a file, or of one `component` in it, at `time` (s).

    By default at the end of the run, from the inputs that nothing feeds to the outputs of the
    continuous components, or from all inputs to all outputs of `component`. An input that is fed
    gets what arrives and the input of the model. `size`: the change of each value for the
    differences, in its unit, for values up to 1, and relative above. Raises ScenarioError for names
    and times that are not there, RunError for what has no linear model.
    """
    plan = observed(load(path, settings))
    if component and component not in {c.name for c in plan.components}:
        raise ScenarioError(unknown(component, [c.name for c in plan.components], "component"))
    u = _chosen(plan, inputs, into=True) or _inputs(plan, component)
    y = _chosen(plan, outputs, into=False) or _outputs(plan, component)
    at = operating_point(plan, plan.end if time is None else time)
    if component:
        at = replace(at, ticks=plan.component(component).period)
    loop = linear_loop(plan, at, u, y, size, component, say)
    return reduced(loop, plan.time(at.tick), _named(u), _named(y))


def opened(
    scenario: Scenario,
    time: float | None = None,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
) -> OpenLoop:
    """The loop of a scenario with its links cut, at `time` (s), by default at the end of the run.

    `inputs` and `outputs`: signals besides those of the links, by default none. Raises
    ScenarioError for names and times that are not there, RunError for what has no linear model.
    """
    plan = observed(scenario)
    u, y = _chosen(plan, inputs, into=True), _chosen(plan, outputs, into=False)
    return open_loop(plan, operating_point(plan, plan.end if time is None else time), u, y)


def observed(scenario: Scenario, plan: Plan | None = None) -> Plan:
    """The plan, with the local variables of FMUs among the outputs: some are states.

    `plan`: of the scenario as it is, if it is there already.
    """
    plan = plan or assemble(scenario)
    inside = tuple(f"{s.name}.{v}" for s in plan.components for v in _locals(s))
    if not inside:
        return plan
    record = replace(scenario.run.record, signals=inside)
    return assemble(replace(scenario, run=replace(scenario.run, record=record)))


def _locals(step: Step) -> list[str]:
    fmu = fmu_of(step.component)
    names = observable(step.component)
    return [n for n in names if fmu and fmu.groups[n].first.causality == "local"]


def _chosen(plan: Plan, names: Sequence[str], *, into: bool) -> list[Slot]:
    """Slots by name, of whole ports or of entries. Raises ScenarioError."""
    known: dict[str, Slot] = {}
    for c in plan.components:
        for slot in c.inputs if into else (*c.outputs, *c.inputs):
            known[slot.name] = slot
            for i, entry in enumerate(slot.scalars()):
                known[entry] = Slot(entry, c.name, slot.port, slot.start + i, (), slot.unit)
    for name in names:
        if name not in known:
            raise ScenarioError(unknown(name, known, "input" if into else "signal"))
    return [known[name] for name in names]


def _inputs(plan: Plan, component: str) -> list[Slot]:
    if component:
        return list(plan.component(component).inputs)
    fed = np.zeros(plan.n_signals, bool)
    edges = (plan.wires, plan.links, plan.players)
    for target in (e.target for some in edges for e in some):
        fed[target.start : target.start + target.size] = True
    slots = [s for c in plan.components for s in c.inputs]
    return [s for s in slots if not fed[s.start : s.start + s.size].any()]


def _outputs(plan: Plan, component: str) -> list[Slot]:
    steps = [plan.component(component)] if component else plan.components
    return [
        s
        for c in steps
        for s in c.outputs
        if (component or c.kind == "continuous") and s.port not in _locals(c)
    ]


def _named(slots: Sequence[Slot]) -> list[tuple[str, str]]:
    return [(name, s.unit) for s in slots for name in s.scalars()]
