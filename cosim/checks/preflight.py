"""All rules over one scenario."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from cosim.analysis.system import AnalyzedSystem, system
from cosim.checks import channels, couplings, laws, reachability, sampling, wiring
from cosim.checks.finding import Finding, merged
from cosim.scenario.spec import Scenario
from cosim.schedule.plan import Plan

Rule = Callable[[AnalyzedSystem], Iterator[Finding]]

#: Rules that can find an error or a warning; they take milliseconds together.
RULES: tuple[Rule, ...] = (
    reachability.unreached,
    reachability.spanning_tree,
    reachability.unheard,
    reachability.stale,
    sampling.feedback,
    sampling.adaptation,
    sampling.contact,
    sampling.hand,
    laws.passivity,
    laws.grip,
    laws.degenerate,
    laws.no_integral,
    laws.gravity,
    couplings.ground,
    couplings.constant_delay,
    channels.bounded,
    channels.buffer,
    lambda known: wiring.unfed(known.plan),
    wiring.saturation,
    wiring.size,
)
#: Rules that only ever note something.
NOTES: tuple[Rule, ...] = (
    laws.prediction,
    channels.backwards,
    channels.like_a_wire,
    wiring.jacobi,
    wiring.unknown,
)


def check(scenario: Scenario, plan: Plan, *, notes: bool = True) -> tuple[Finding, ...]:
    """What is found in a scenario and its plan, worst first; without `notes` only what warns.

    Raises nothing for what a model does: a model whose facts cannot be had is a note.
    """
    known = system(scenario, plan)
    found = [f for rule in RULES for f in rule(known)]
    if notes:
        found += [f for rule in NOTES for f in rule(known)]
    return merged(f for f in found if notes or f.severity != "note")
