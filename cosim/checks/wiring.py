"""Inputs, limits, and how much a run will write."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cosim.checks import Finding, Severity
from cosim.fmi.components import default_start, has_unit, is_simulator, simulator_remarks
from cosim.fmi.components import ignored as ignored_in
from cosim.predict.system import AnalyzedSystem
from cosim.schedule.parts import Link, Slot, Wire
from cosim.schedule.plan import Plan

#: A recording of more bytes is worth a warning.
LARGE = 2e9


def unconnected_inputs(plan: Plan) -> Iterator[Finding]:
    """Inputs that nothing feeds and the scenario does not set: a wire may have been forgotten.

    Not those that their model declares optional (:class:`cosim.base.component.Port`).
    """
    fed = np.zeros(plan.n_signals, dtype=np.bool_)
    for slot in _connected_inputs(plan):
        fed[slot.start : slot.start + slot.size] = True
    for step in plan.components:
        for slot, port in zip(step.inputs, step.component.inputs, strict=True):
            connected = fed[slot.start : slot.start + slot.size]
            if port.optional or port.name in step.start or connected.all():
                continue
            idle = [n for n, is_fed in zip(slot.scalars(), connected, strict=True) if not is_fed]
            which = slot.name if len(idle) == slot.size else ", ".join(idle)
            yield Finding(
                rule="unfed",
                severity="warning",
                where=which,
                number=float(len(idle)),
                unit="1",
                reason="the input is unconnected, and the scenario sets no start value for it",
                advice=f'components.{step.name}.inputs.{port.name} = "COMPONENT.OUTPUT", or '
                f"components.{step.name}.start.{port.name} = ... if a constant value is intended",
            )


def unitless_connections(plan: Plan) -> Iterator[Finding]:
    """Connections whose number is not converted, since one end is an FMU's without a unit."""
    edges: tuple[Wire | Link, ...] = (*plan.wires, *plan.links)
    for edge in edges:
        if edge.source.unit == edge.target.unit:
            continue
        ends = (edge.source, edge.target)
        declared = [has_unit(plan.component(s.component).component, s.port) for s in ends]
        if all(declared):
            continue
        bare, other = ends[::-1] if declared[0] else ends
        if other.unit != "1":
            yield Finding(
                rule="unitless",
                severity="warning",
                where=f"{edge.source.name} -> {edge.target.name}",
                number=1.0,
                unit="1",
                reason=f"the FMU declares no unit for {bare.name}"
                + (f" that is known ({bare.unit})" if bare.unit != "1" else "")
                + f", so the number in [{other.unit}] is taken as it is",
                advice="check the unit that the FMU means; gain = ... in the connection converts",
            )


def ignored_values(system: AnalyzedSystem) -> Iterator[Finding]:
    """Statements of an SSP that are not used, such as values for variables no FMU has, which the
    standard has ignored.
    """
    if system.scenario.path.suffix != ".ssp":
        return
    from cosim.ssp.document import ignored

    for sentence in ignored(system.scenario.path):
        yield Finding(
            rule="ignored",
            severity="warning",
            where="parameters",
            number=1.0,
            unit="1",
            reason=sentence,
            advice="correct the parameter set or its mapping, if this is not meant",
        )


def remarks(plan: Plan) -> Iterator[Finding]:
    """Statements in files of robots that a component does not follow."""
    for step in plan.components:
        for sentence in (*step.remarks, *simulator_remarks(step.component, step.values)):
            yield Finding(
                rule="file",
                severity="warning",
                where=step.name,
                number=1.0,
                unit="1",
                reason=sentence,
            )


def start_time(system: AnalyzedSystem) -> Iterator[Finding]:
    """An FMU whose DefaultExperiment begins at another time than the run."""
    begin, end = system.plan.start, system.plan.end
    alone = system.scenario.path.suffix == ".fmu"
    for step in system.plan.components:
        start = default_start(step.component)
        if start != begin and (start or alone):
            yield Finding(
                rule="start",
                severity="warning",
                where=step.name,
                number=start,
                unit="s",
                reason=f"the DefaultExperiment of the FMU begins at {start:g} s, the run goes "
                f"from {begin:g} s to {end:g} s",
                advice=f"set run.start = {start:g}, unless the model does not depend on the time",
            )


def ignored_descriptions(plan: Plan) -> Iterator[Finding]:
    """Statements in descriptions of FMUs that are not used, once for each FMU."""
    said: set[str] = set()
    for step in plan.components:
        for sentence in ignored_in(step.component):
            if sentence not in said:
                said.add(sentence)
                yield Finding(
                    rule="ignored",
                    severity="warning",
                    where=step.name,
                    number=1.0,
                    unit="1",
                    reason=sentence,
                    advice="ask the exporter of the FMU for a description without this",
                )


def _connected_inputs(plan: Plan) -> list[Slot]:
    found = [w.target for w in plan.wires] + [x.target for x in plan.links]
    found += [x.age for x in plan.links if x.age is not None]
    return found + [p.target for p in plan.players]


def size(system: AnalyzedSystem) -> Iterator[Finding]:
    """The size of the recorded data, uncompressed."""
    from cosim.engine.simulate import recorded_slots

    spec, plan = system.scenario.run.record, system.plan
    place = system.scenario.place("run.record.signals")
    count = sum(slot.size for slot in recorded_slots(plan, spec.signals, place))
    total = 8.0 * (count + 1) * (plan.ticks // spec.every + 1)
    severity: Severity = "warning" if total > LARGE else "note"
    yield Finding(
        rule="size",
        severity=severity,
        where="run.record",
        number=total / 1e6,
        unit="MB",
        reason=f"the recording will have {total / 1e6:.3g} MB uncompressed ({count} columns,"
        f" {plan.ticks // spec.every + 1} rows)",
        advice="record fewer signals or fewer ticks (run.record.every)"
        if severity == "warning" else "",
    )  # fmt: skip


def jacobi(system: AnalyzedSystem) -> Iterator[Finding]:
    """All components use values of the previous tick: one more sample of delay in each loop."""
    if system.plan.algorithm == "jacobi":
        yield Finding(
            rule="jacobi",
            severity="note",
            where="run.algorithm",
            number=system.plan.h,
            unit="s",
            reason="all components read the previous tick: the torque is one more sample late",
            advice='use algorithm = "sampled", except to compare with other masters',
        )


def unchecked_components(system: AnalyzedSystem) -> Iterator[Finding]:
    """Components of which nothing is known: what was not checked."""
    for step in system.plan.components:
        if step.name in system.silent:
            why = f"its facts are not available: {system.silent[step.name]}"
        elif step.name in system.controls.values() and step.name not in system.facts:
            why = "its model offers no facts"
        elif system.scenario.components[step.name].model.endswith(".fmu"):
            why = "an FMU file offers no facts"
        elif is_simulator(step.component):
            why = "a scene of MuJoCo offers no facts"
        else:
            continue
        yield Finding(
            rule="unknown",
            severity="note",
            where=step.name,
            number=float("nan"),
            unit="",
            reason=f"{why}: its law, inertia and limits are not checked",
        )
