"""All rules over one scenario."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from functools import partial

from cosim.checks import (
    Finding,
    channels,
    laws,
    merge_findings,
    reachability,
    wiring,
)
from cosim.predict.facts import DynamicFeedback, TipContact
from cosim.predict.system import AnalyzedSystem, system
from cosim.scenario.spec import Scenario
from cosim.schedule.plan import Plan

Rule = Callable[[AnalyzedSystem], Iterator[Finding]]


def _rules(module: str, concerned: Callable[[AnalyzedSystem], bool], *names: str) -> Iterator[Rule]:
    """Rules of a module that is imported only for the systems that it concerns."""
    for name in names:
        yield partial(_rule, module, concerned, name)


def _rule(
    module: str, concerned: Callable[[AnalyzedSystem], bool], name: str, known: AnalyzedSystem
) -> Iterator[Finding]:
    if concerned(known):
        yield from getattr(importlib.import_module(f"cosim.checks.{module}"), name)(known)


def _tips(known: AnalyzedSystem) -> bool:
    """True if an arm is controlled or held at its tip."""
    return any(
        isinstance(facts, TipContact)
        or (isinstance(facts, DynamicFeedback) and facts.task is not None)
        for facts in known.facts.values()
    )


def _commands(known: AnalyzedSystem) -> bool:
    """True if an arm takes positions or velocities."""
    return bool(known.commands)


def _required(known: AnalyzedSystem) -> bool:
    """True if the scenario declares requirements."""
    return bool(known.scenario.require)


def _plants(known: AnalyzedSystem) -> bool:
    """True if a wire connects two plants."""
    plants = {s.name for s in known.plan.components if s.component.kind == "continuous"}
    wires = known.plan.wires
    return any(w.source.component in plants and w.target.component in plants for w in wires)


def _drawn_links(known: AnalyzedSystem) -> bool:
    """True if links have queues, or two of them join the same components."""
    links = known.plan.links
    ends = {(x.source.component, x.target.component) for x in links}
    return len(ends) < len(links) or any(x.semantics == "queue" for x in known.scenario.links)


#: Other rules that can find an error or a warning; they take milliseconds together.
RULES: tuple[Rule, ...] = (
    reachability.unreached_robots,
    reachability.spanning_tree,
    reachability.unconnected_rows,
    reachability.age_limit_without_age,
    laws.degenerate,
    laws.no_integral,
    laws.gravity,
    *_rules("tasks", _tips, "passivity", "singular", "missing", "spanning_tree"),
    *_rules("tasks", _tips, "sampled_contact"),
    channels.constant_delay,
    *_rules("plants", _plants, "coupled"),
    *_rules("servos", _commands, "gains", "inertia", "torque", "bandwidth", "holding"),
    channels.unbounded_delay,
    channels.buffer,
    *_rules("receivers", _drawn_links, "growing_queue", "skew"),
    channels.lost_frames,
    lambda known: wiring.unconnected_inputs(known.plan),
    lambda known: wiring.unitless_connections(known.plan),
    lambda known: wiring.remarks(known.plan),
    reachability.start_limits,
    reachability.doubtful_bodies,
    wiring.ignored_values,
    lambda known: wiring.ignored_descriptions(known.plan),
    wiring.start_time,
    wiring.size,
    *_rules("requirements", _required, "intervals", "decided"),
)
#: Rules that run the scenario and compute its poles: tenths of a second together.
COMPUTED: tuple[Rule, ...] = (
    *_rules("loops", lambda known: True, "nominal", "poles", "saturation"),
)
#: Rules that only ever note something.
NOTES: tuple[Rule, ...] = (
    *_rules("ports", lambda known: True, "passivity", "settling", "delays_to_spare"),
    laws.prediction,
    *_rules("tasks", _tips, "stiffness", "free_joints"),
    channels.simulated_response,
    channels.reordered_samples,
    channels.zero_minimum_delay,
    wiring.jacobi,
    wiring.unchecked_components,
)


def check(scenario: Scenario, plan: Plan, *, notes: bool = True) -> tuple[Finding, ...]:
    """Findings about a scenario and its plan, worst first; without `notes`, no mere notes.

    The scenario is run and its poles are computed.

    An error in the facts of a model is not raised; it becomes a note.
    """
    return findings(system(scenario, plan), notes=notes)


def findings(
    known: AnalyzedSystem, *, notes: bool = True, computed: bool = True
) -> tuple[Finding, ...]:
    """The same of a scenario whose roles are known; without `computed`, nothing is run."""
    found = [f for rule in (*(COMPUTED if computed else ()), *RULES) for f in rule(known)]
    if notes:
        found += [f for rule in NOTES for f in rule(known)]
    return merge_findings(f for f in found if notes or f.severity != "note")
