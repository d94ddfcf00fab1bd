"""Inputs, limits, and how much a run will write."""

from __future__ import annotations

from collections.abc import Iterator

from cosim.analysis.network import network
from cosim.analysis.system import System
from cosim.check.finding import Finding, Severity
from cosim.check.peaks import peaks
from cosim.plan import Step

#: A recording of more bytes is worth a warning.
LARGE = 2e9


def uncontrolled(system: System) -> Iterator[Finding]:
    """An arm whose torque nothing feeds."""
    for name, arm in sorted(system.arms.items()):
        if name not in system.controls:
            yield Finding(
                rule="uncontrolled",
                severity="warning",
                where=f"{name}.{arm.torque}",
                number=0.0,
                unit="N.m",
                reason="nothing feeds the arm's torque: nobody controls it",
                advice=f'components.{name}.inputs.{arm.torque} = "CONTROLLER.tau"',
            )


def unfed(system: System) -> Iterator[Finding]:
    """Inputs that nothing feeds and the scenario does not set: they keep their default."""
    for step in system.plan.components:
        names = [name for name in _unfed(system, step) if name not in step.start]
        if names:
            yield Finding(
                rule="unfed",
                severity="note",
                where=step.name,
                number=float(len(names)),
                unit="1",
                reason=f"inputs that nothing feeds keep their default: {', '.join(names)}",
            )


def _unfed(system: System, step: Step) -> list[str]:
    targets = [(w.target.start, w.target.size) for w in system.plan.wires]
    targets += [(x.target.start, x.target.size) for x in system.plan.links]
    targets += [(x.age.start, x.age.size) for x in system.plan.links if x.age is not None]
    targets += [(p.target.start, p.target.size) for p in system.plan.players]
    found = []
    for slot in step.inputs:
        end = slot.start + slot.size
        fed = sum(max(0, min(end, at + n) - max(slot.start, at)) for at, n in targets)
        if fed < slot.size:
            found.append(slot.port)
    return found


def saturation(system: System) -> Iterator[Finding]:
    """tau_max against the torque that the linear behaviour from the start will want."""
    for start in system.held():
        net = network(system, start)
        if net is None or net.law.lambda_c:
            continue
        found = peaks(net)
        for name, law, tau in zip(net.names, net.laws, found.tau, strict=True):
            limit = min(law.tau_max)
            if tau <= limit:
                continue
            yield Finding(
                rule="saturation",
                severity="warning",
                where=name,
                number=float(tau),
                unit="N.m",
                reason=f"about {tau:.2g} N.m are wanted on a joint, tau_max is {limit:g}: it"
                " saturates, and nothing adapts meanwhile",
                advice="raise tau_max, or pull more gently",
            )


def size(system: System) -> Iterator[Finding]:
    """How much is recorded, uncompressed."""
    from cosim.simulate import columns

    spec, plan = system.scenario.run.record, system.plan
    count = len(columns(plan, spec.signals, system.scenario.place("run.record.signals")))
    total = 8.0 * (count + 1) * (plan.ticks // spec.every + 1)
    severity: Severity = "warning" if total > LARGE else "note"
    yield Finding(
        rule="size",
        severity=severity,
        where="run.record",
        number=total / 1e6,
        unit="MB",
        reason=f"{total / 1e6:.3g} MB of numbers will be recorded ({count} columns,"
        f" {plan.ticks // spec.every + 1} rows)",
        advice="record fewer signals, or every so many ticks (run.record.every)"
        if severity == "warning" else "",
    )  # fmt: skip


def jacobi(system: System) -> Iterator[Finding]:
    """Everybody sees the tick before: one more sample of delay in each loop."""
    if system.plan.algorithm == "jacobi":
        yield Finding(
            rule="jacobi",
            severity="note",
            where="run.algorithm",
            number=system.plan.h,
            unit="s",
            reason="everybody sees the tick before: a sample more of delay between arm and torque",
            advice='algorithm = "sampled", unless for comparison with other masters',
        )


def unknown(system: System) -> Iterator[Finding]:
    """Components of which nothing is known: what was not checked."""
    for step in system.plan.components:
        if step.name in system.silent:
            why = f"its facts cannot be had: {system.silent[step.name]}"
        elif step.name in system.controls.values() and step.name not in system.facts:
            why = "its model offers no facts"
        elif system.scenario.components[step.name].model.endswith(".fmu"):
            why = "an FMU file offers no facts"
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
