"""Springs between robots over delays: enough damping to the ground, delays that are constant."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import sqrt

from cosim.checks.finding import Finding
from cosim.links.losses import Lossy
from cosim.links.semantics import PlayoutSemantics
from cosim.links.table import DrawnTable
from cosim.predict.facts import SpringDamper
from cosim.predict.system import AnalyzedSystem
from cosim.schedule.parts import Link


def ground_damping(system: AnalyzedSystem) -> Iterator[Finding]:
    """2 ground >= T_rt stiffness (means over the two sides): the delayed spring makes energy.

    T_rt, the longest delay there and back. Lee and Spong (2006): K_d >= T_rt K_p/2; Nuño et al.
    (2009): 4 B_l B_r > (T_l + T_r)² K_l K_r.
    """
    springs = system.with_facts(SpringDamper)
    for (a, b), (there, back) in sorted(_pairs(system).items()):
        one, other = springs[a], springs[b]
        if not (one.needs_ground or other.needs_ground) or not (
            min(one.stiffness) and min(other.stiffness)
        ):
            continue
        T = there + back
        needs = T * sqrt(max(one.stiffness) * max(other.stiffness)) / 2
        has = sqrt(min(one.ground) * min(other.ground))
        if needs <= has:
            continue
        yield Finding(
            rule="damping",
            severity="warning",
            where=f"{a}, {b}",
            number=has,
            unit="N.m.s/rad",
            reason=f"{one.law}: the damping to ground is {has:.3g} N.m.s/rad; a round-trip delay"
            f" of up to {T:.3g} s needs T_rt K/2 = {needs:.3g}",
            advice="raise the damping, lower the stiffness, or shorten the delay",
        )


def _pairs(system: AnalyzedSystem) -> Mapping[tuple[str, str], tuple[float, float]]:
    """Longest delay each way of every two coupled controllers, s."""
    springs = system.with_facts(SpringDamper)
    longest: dict[tuple[str, str], float] = {}
    for link in system.plan.links:
        source = system.controls.get(link.source.component, link.source.component)
        target = link.target.component
        if source in springs and target in springs:
            ends = (source, target)
            longest[ends] = max(longest.get(ends, 0.0), longest_delay(link))
    return {
        (a, b): (T, longest.get((b, a), 0.0))
        for (a, b), T in longest.items()
        if a < b or (b, a) not in longest
    }


def longest_delay(link: Link) -> float:
    """No sample that newly is held was sent longer ago, s, apart from losses."""
    table = link.table
    if not isinstance(table, DrawnTable):
        return table.history * table.grid.n_s * table.grid.h
    return table.rule.buffer if isinstance(table.rule, PlayoutSemantics) else table.law.maximum


def is_constant(link: Link) -> bool:
    """True if the sample that a link holds always has the same age."""
    table = link.table
    if not isinstance(table, DrawnTable):
        return False
    law = table.law.delay if isinstance(table.law, Lossy) else table.law
    if table.law.loses_packets:
        return False
    if isinstance(table.rule, PlayoutSemantics):
        return law.maximum <= table.rule.buffer
    return law.minimum == law.maximum


def constant_delay(system: AnalyzedSystem) -> Iterator[Finding]:
    """Laws that are proved for a constant delay only, on links with a varying delay."""
    springs = system.with_facts(SpringDamper)
    for link in system.plan.links:
        law = springs.get(link.target.component)
        if law is None or not law.constant_delay or is_constant(link):
            continue
        longest = longest_delay(link)
        yield Finding(
            rule="constant-delay",
            severity="warning",
            where=link.target.component,
            number=longest,
            unit="s",
            reason=f"{law.law} is proved for a constant delay, but this delay varies, up to"
            f" {longest:.3g} s",
            advice=f'semantics = "playout" with playout = {longest:.3g} makes it constant',
        )
