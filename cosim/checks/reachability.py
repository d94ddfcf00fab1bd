"""Robots: reached from the operator's arm, with senders, within their limits, of sound bodies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from cosim.base.names import listed, signal_of
from cosim.checks import Finding
from cosim.predict.facts import DynamicFeedback
from cosim.predict.system import AnalyzedSystem, values_of
from cosim.scenario.connect import topology
from cosim.schedule.parts import Wire


def arms_acted_on(system: AnalyzedSystem) -> tuple[str, ...]:
    """The arms on which an operator acts: those in [analysis], or those that are held or pushed."""
    named = system.scenario.analysis.force.split(".")[0]
    return (named,) if named in system.arms else system.held()


def reachable_components(system: AnalyzedSystem, start: Sequence[str]) -> frozenset[str]:
    """Components that what `start` does gets to, along wires, links and edges that last."""
    return _closure(_connections(system), start)


def _connections(system: AnalyzedSystem) -> dict[str, set[str]]:
    """The components that each component reaches directly."""
    silent = {
        e.link.name for e in system.edges if e.link is not None and not e.recurrent
    }  # links of edges whose weight is 0 for ever
    dead = {(e.receiver, e.sender) for e in system.edges if e.link is None and not e.recurrent}
    wires: dict[tuple[str, str], list[Wire]] = {}
    for wire in system.plan.wires:
        wires.setdefault((wire.target.component, wire.source.component), []).append(wire)
    edges: dict[str, set[str]] = {}
    for (target, source), several in wires.items():
        if (target, source) not in dead and not _has_zero_weight(system, target, several):
            edges.setdefault(source, set()).add(target)
    for link in system.plan.links:
        if link.name not in silent:
            edges.setdefault(link.source.component, set()).add(link.target.component)
    return edges


def _has_zero_weight(system: AnalyzedSystem, target: str, wires: Sequence[Wire]) -> bool:
    """True if the wires from one component to another carry only rows whose weight is always 0."""
    law = system.with_facts(DynamicFeedback).get(target)
    if law is None or any(w.target.port != law.received for w in wires):
        return False
    edges = system.edges_to.get(target, ())
    rows = {e.row: e.recurrent for e in edges if e.link is None}
    slot = next(s for s in system.plan.component(target).inputs if s.port == law.received)
    width = slot.size // slot.shape[0]
    return all(
        not any(
            rows.get(row, True)
            for row in range(
                (w.target.start - slot.start) // width,
                (w.target.start + w.target.size - slot.start - 1) // width + 1,
            )
        )
        for w in wires
    )


def _closure(edges: Mapping[str, set[str]], start: Sequence[str]) -> frozenset[str]:
    found, waiting = set(start), list(start)
    while waiting:
        for other in sorted(edges.get(waiting.pop(), set()) - found):
            found.add(other)
            waiting.append(other)
    return frozenset(found)


# ---- rules --------------------------------------------------------------------------------------


def unreached_robots(system: AnalyzedSystem) -> Iterator[Finding]:
    """Theorems 3 to 5: a held robot must be a root, or its position does not reach the others."""
    start = arms_acted_on(system)
    if not start:
        return
    found = reachable_components(system, start)
    exchanging = _exchanging_controllers(system)
    missed = sorted(c for c in set(system.controls.values()) - found if c in exchanging)
    if not missed:
        return
    roots = _roots(system)
    yield Finding(
        rule="root",
        severity="error",
        where=", ".join(start),
        number=float(len(missed)),
        unit="1",
        reason=f"an action here never reaches {listed(missed)}: not a root of the "
        "communication graph",
        advice=f"hold {listed(roots, ' or ')}, whose signals reach all arms, or add a link" if roots
        else "add links: no arm's signals reach all others",
    )  # fmt: skip


def _exchanging_controllers(system: AnalyzedSystem) -> set[str]:
    """Controllers that exchange signals with others."""
    ends = {name for e in system.edges for name in (e.receiver, e.sender)}
    linked = {name for x in system.plan.links for name in (x.source.component, x.target.component)}
    arms = {system.controls[a] for a in linked if a in system.controls}
    return (ends | linked | arms) & set(system.controls.values())


def _roots(system: AnalyzedSystem) -> list[str]:
    """The arms from which all controllers that exchange signals are reached.

    If there is one, then the last arm from which those before it had not been reached is one, and
    the others are those that reach it.
    """
    wanted, edges = _exchanging_controllers(system), _connections(system)
    found: set[str] = set()
    last = ""
    for arm in sorted(system.arms):
        if arm not in found:
            last = arm
            found |= _closure(edges, [arm])
    if not last or not wanted <= _closure(edges, [last]):
        return []
    backwards: dict[str, set[str]] = {}
    for source, targets in edges.items():
        for target in targets:
            backwards.setdefault(target, set()).add(source)
    before = _closure(backwards, [last])
    return [arm for arm in sorted(system.arms) if arm in before]


def spanning_tree(system: AnalyzedSystem) -> Iterator[Finding]:
    """Theorems 3 and 4: the graphs that last have a spanning tree together."""
    try:
        graphs = topology(system.scenario)
    except ValueError:  # what the plan was made of is not there any more
        return
    if graphs is not None and not graphs.has_joint_spanning_tree:
        yield Finding(
            rule="spanning-tree",
            severity="warning",
            where="topology",
            number=0.0,
            unit="1",
            reason="the union of the recurrent graphs has no spanning tree: the arms do not agree"
            " (Theorem 3)",
            advice="add edges, or let the schedule repeat",
        )


def unconnected_rows(system: AnalyzedSystem) -> Iterator[Finding]:
    """A row that nothing feeds, with a weight: the controller is tied to the number it holds."""
    for e in system.edges:
        law = system.with_facts(DynamicFeedback)[e.receiver]
        if not e.fed and e.recurrent and law.lambda_ > 0:
            yield Finding(
                rule="unheard",
                severity="warning",
                where=f"{e.receiver}.{law.received}[{e.row}]",
                number=e.weight,
                unit="1",
                reason=f"the row is unconnected, but its weight is {e.weight:g}: the arm is drawn"
                " towards the constant xi of the row",
                advice=f"connect it, or set {law.weights}[{e.row}] = 0",
            )


def age_limit_without_age(system: AnalyzedSystem) -> Iterator[Finding]:
    """An age limit without an age never finds anything stale."""
    fed = {signal_of(x.age.name) for x in system.plan.links if x.age is not None}
    fed |= {signal_of(w.target.name) for w in system.plan.wires}
    for name, law in system.with_facts(DynamicFeedback).items():
        age = f"{name}.{law.age}"
        if law.age and law.age_max < 1e8 and age not in fed:
            held_age = values_of(system.plan.component(name)).get(law.age, ())
            if not any(held_age):
                yield Finding(
                    rule="stale",
                    severity="warning",
                    where=age,
                    number=law.age_max,
                    unit="s",
                    reason=f"age_max is {law.age_max:g} s, but the age is unconnected: no sample"
                    " ever becomes stale",
                    advice='give the link age = "' + age + '[0]"',
                )


def start_limits(system: AnalyzedSystem) -> Iterator[Finding]:
    """Joints that start outside of their limits, where no stop would refuse it."""
    for name, arm in system.arms.items():
        for j, (low, high) in enumerate(zip(arm.lower, arm.upper, strict=True)):
            if low <= arm.q[j] <= high:
                continue
            yield Finding(
                rule="limits",
                severity="warning",
                where=f"{name}.{arm.position}[{j}]",
                number=arm.q[j],
                unit="rad",
                reason=f"the joint starts at {arm.q[j]:.4g} rad, outside of its limits {low:.4g} to"
                f" {high:.4g}; no stop acts there",
                advice=f"components.{name}.start.{arm.position} within the limits; k_s and b_s make"
                " stops",
            )


def doubtful_bodies(system: AnalyzedSystem) -> Iterator[Finding]:
    """Links whose mass, centre and inertia do not fit the size of the arm."""
    for name, arm in system.arms.items():
        for doubt in arm.doubts:
            yield Finding(
                rule="body",
                severity="warning",
                where=name,
                number=1.0,
                unit="1",
                reason=doubt,
                advice="compare the numbers and their units (kg, m, kg.m2) with those of the maker",
            )
