"""The theorems of the paper beside a certificate: the scenarios they cover, and where they end.

Theorems 4 and 5 (H. Wang, Towards Manipulability of Interactive Lagrangian Systems) cover large
motions of free robots, whatever the bounds of the delays, in continuous time. Their proof needs the
estimates to adapt, which stops at rest. So they prove nothing about the sampled linear loop.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import isinf

from cosim.base.names import listed
from cosim.checks.reachability import spanning_tree
from cosim.predict.ages import age_bound
from cosim.predict.facts import DynamicFeedback
from cosim.predict.system import AnalyzedSystem, system
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario

NAME = "Theorems 4 and 5 (continuous time, all bounded delays)"


def theorem(scenario: Scenario) -> str:
    """A sentence on whether the theorems cover the robots of a scenario; "": it has another law."""
    known = system(scenario, assemble(scenario))
    laws = known.with_facts(DynamicFeedback)
    if not known.arms or set(known.controls.values()) != set(laws):
        return ""
    found = next(_reasons(known), "")
    if found:
        return f"{NAME} do not apply: {found}"
    return (
        f"{NAME} cover large motions of these free robots; the proof needs estimates that adapt, "
        "which stops at rest"
    )


def _reasons(known: AnalyzedSystem) -> Iterator[str]:
    """Conditions of the theorems that do not hold."""
    if held := known.held():
        yield f"a hand holds or pushes {listed(held)}, and they are about free robots"
    if walls := [name for name, arm in sorted(known.arms.items()) if arm.wall.is_present]:
        yield f"a wall is before {listed(walls)}, and they are about free robots"
    for name, law in sorted(known.with_facts(DynamicFeedback).items()):
        if min((law.alpha, law.lambda_M, law.lambda_, *law.K, *law.Gamma), default=0.0) <= 0:
            yield f"a gain of {name} is not positive"
        if law.beyond or law.task is not None or law.gravity == "adapted":
            yield f"{name} is not the law of (61) in joints without gravity"
    for link in known.plan.links:
        if isinf(age_bound(link.table)):
            yield f"the delays of links.{link.name} have no bound"
    for finding in spanning_tree(known):
        yield finding.reason
