"""All rules over one scenario."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from cosim.analysis.system import AnalyzedSystem, system
from cosim.checks import (
    buses,
    channels,
    couplings,
    laws,
    reachability,
    sampling,
    servos,
    tasks,
    wiring,
)
from cosim.checks.finding import Finding, merge_findings
from cosim.scenario.spec import Scenario
from cosim.schedule.plan import Plan

Rule = Callable[[AnalyzedSystem], Iterator[Finding]]

#: Rules that can find an error or a warning; they take milliseconds together.
RULES: tuple[Rule, ...] = (
    reachability.unreached_robots,
    reachability.spanning_tree,
    reachability.unconnected_rows,
    reachability.age_limit_without_age,
    sampling.feedback,
    sampling.adaptation,
    sampling.contact,
    sampling.sampled_hand,
    laws.passivity,
    laws.grip,
    laws.degenerate,
    laws.no_integral,
    laws.gravity,
    tasks.feedback,
    tasks.passivity,
    tasks.singular,
    tasks.missing,
    tasks.spanning_tree,
    tasks.sampled_contact,
    couplings.ground_damping,
    couplings.constant_delay,
    servos.gains,
    servos.inertia,
    servos.torque,
    servos.bandwidth,
    servos.holding,
    channels.unbounded_delay,
    channels.buffer,
    buses.lost_frames,
    lambda known: wiring.unconnected_inputs(known.plan),
    lambda known: wiring.unitless_connections(known.plan),
    wiring.ignored_values,
    wiring.saturation,
    wiring.size,
)
#: Rules that only ever note something.
NOTES: tuple[Rule, ...] = (
    laws.prediction,
    tasks.stiffness,
    tasks.free_joints,
    buses.simulated_response,
    channels.reordered_samples,
    channels.zero_minimum_delay,
    wiring.jacobi,
    wiring.unchecked_components,
)


def check(scenario: Scenario, plan: Plan, *, notes: bool = True) -> tuple[Finding, ...]:
    """Findings about a scenario and its plan, worst first; without `notes`, no mere notes.

    An error in the facts of a model is not raised; it becomes a note.
    """
    known = system(scenario, plan)
    found = [f for rule in RULES for f in rule(known)]
    if notes:
        found += [f for rule in NOTES for f in rule(known)]
    return merge_findings(f for f in found if notes or f.severity != "note")
