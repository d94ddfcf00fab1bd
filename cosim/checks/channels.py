"""Links: what their laws bound, lose and reorder, and the buses they are on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import inf, isinf
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.checks import Finding, Severity
from cosim.links.semantics import (
    PacketSemantics,
    PlayoutSemantics,
    QueueSemantics,
    SignalSemantics,
)
from cosim.links.table import DrawnTable
from cosim.predict.ages import age_bound
from cosim.predict.facts import SpringDamper
from cosim.predict.system import AnalyzedSystem
from cosim.schedule.parts import Link

if TYPE_CHECKING:
    from cosim.links.traces import BusDelays

#: Gaps in what arrives that are shorter than this on average are no more than a note, s.
GAP = 0.5
#: Delays drawn to count those that a buffer is too short for.
_DRAWS = 4000


def unbounded_delay(system: AnalyzedSystem) -> Iterator[Finding]:
    """Theorems 4 and 5 need delays with a bound: losses at random have none."""
    length = system.plan.ticks * system.plan.h
    for link in system.plan.links:
        bound = age_bound(link.table)
        table = link.table
        if not isinstance(table, DrawnTable) or not (isinf(bound) or bound > length):
            continue
        if isinstance(table.rule, PlayoutSemantics) and not table.law.loses_packets:
            continue  # a rule of its own
        gap = _gap(link)
        severity: Severity = "warning" if bound > length and gap > GAP else "note"
        until = "no bound" if isinf(bound) else f"a bound of {bound:.3g} s, longer than the run"
        often = f"; gaps are {gap:.2g} s long on average" if 0 < gap < inf else ""
        yield Finding(
            rule="bounded",
            severity=severity,
            where=f"links.{link.name}",
            number=bound,
            unit="s",
            reason=f"the age of the held sample has {until} (Theorems 4 and 5 require one){often}",
            advice="let the controller discard old samples (age and age_max)"
            if severity == "warning" else "",
        )  # fmt: skip


def _gap(link: Link) -> float:
    """Mean length of what is missing in a row, s; 0 without losses, inf where it is not known."""
    table = link.table
    assert isinstance(table, DrawnTable)
    if not table.law.loses_packets:
        return 0.0
    from cosim.links.losses import GilbertElliott, Independent, Lossy, ParetoBursts

    loss = table.law.loss if isinstance(table.law, Lossy) else None
    if isinstance(loss, Independent | GilbertElliott | ParetoBursts):
        return loss.burst * table.grid.n_s * table.grid.h
    return inf


def buffer(system: AnalyzedSystem) -> Iterator[Finding]:
    """A playout buffer shorter than the longest delay: samples that are too late are never used."""
    for link in system.plan.links:
        table = link.table
        if not isinstance(table, DrawnTable) or not isinstance(table.rule, PlayoutSemantics):
            continue
        law, b = table.law, table.rule.buffer
        if law.maximum <= b:
            continue
        drawn = law.stream(table.grid.sending_period, np.random.default_rng(0)).take(
            min(_DRAWS, law.limit(table.grid.sending_period) or _DRAWS)
        )
        late = float((drawn > b).mean())
        yield Finding(
            rule="buffer",
            severity="warning",
            where=f"links.{link.name}",
            number=late * 100,
            unit="%",
            reason=f"playout = {b:g} s, but delays are up to {law.maximum:.3g} s: about"
            f" {late * 100:.2g} % arrive too late, and the delay is not constant",
            advice=f"playout = {law.maximum:.3g}",
        )


def reordered_samples(system: AnalyzedSystem) -> Iterator[Finding]:
    """Rules that let an older sample follow a newer one."""
    for link in system.plan.links:
        table = link.table
        if not isinstance(table, DrawnTable) or is_constant(link):
            continue
        last = isinstance(table.rule, PacketSemantics) and table.rule.order == "last-arrival"
        if last or isinstance(table.rule, SignalSemantics) or _overtakes(table):
            name = table.rule.facts()["semantics"]
            mean = system.age(link).mean
            yield Finding(
                rule="backwards",
                severity="note",
                where=f"links.{link.name}",
                number=mean,
                unit="s",
                reason=f'semantics = "{name}" returns to older samples when a delay grows (mean age'
                f" {mean:.2g} s, up to {longest_delay(link):.3g} s)",
                advice='for a real network use "newest-stamp", which gives newer samples',
            )


def _overtakes(table: DrawnTable) -> bool:
    """True for a queue that samples may enter in another order than that of sending."""
    law = table.law
    later = law.maximum - law.minimum > float(table.grid.sending_period)
    return isinstance(table.rule, QueueSemantics) and later


def zero_minimum_delay(system: AnalyzedSystem) -> Iterator[Finding]:
    """A least delay of 0 orders components like a wire."""
    for link in system.plan.links:
        if link.table.minimum_delay_ticks == 0:
            yield Finding(
                rule="like-a-wire",
                severity="note",
                where=f"links.{link.name}",
                number=0.0,
                unit="s",
                reason="its minimum delay is 0: sender and receiver are ordered as for a wire",
            )


def longest_delay(link: Link) -> float:
    """No sample that newly is held was sent longer ago, s, apart from losses."""
    table = link.table
    if not isinstance(table, DrawnTable):
        return table.history * table.grid.n_s * table.grid.h
    if isinstance(table.rule, QueueSemantics):
        return table.rule.greatest(table.law, table.grid) * table.grid.h
    return table.rule.buffer if isinstance(table.rule, PlayoutSemantics) else table.law.maximum


def is_constant(link: Link) -> bool:
    """True if the sample that a link holds always has the same age."""
    table = link.table
    if not isinstance(table, DrawnTable):
        return False
    law = table.law
    if law.loses_packets:
        return False
    if isinstance(table.rule, PlayoutSemantics):
        return law.maximum <= table.rule.buffer
    if isinstance(table.rule, QueueSemantics) and table.rule.grows(table.grid):
        return table.rule.depth == 1 and law.minimum == law.maximum
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


def lost_frames(system: AnalyzedSystem) -> Iterator[Finding]:
    """Frames that did not arrive within the run."""
    for name, law in _on_buses(system):
        lost = int(law.known["lost"])
        if lost:
            yield Finding(
                rule="bus-loss",
                severity="warning",
                where=f"links.{name}",
                number=float(lost),
                unit="1",
                reason=f"{lost} of {law.known['frames']} frames {law.known['identifier']} on bus"
                f" {law.known['bus']} do not arrive before the run ends",
                advice="lower the load, raise the bit rate, or lengthen the transmit queue",
            )


def simulated_response(system: AnalyzedSystem) -> Iterator[Finding]:
    """The worst response time that was simulated, and the worst case of the analysis."""
    for name, law in _on_buses(system):
        known, bound = law.known, law.known["analysed_worst"]
        said = (
            f"at most {bound * 1e3:.4g} ms by analysis"
            if bound is not None
            else "without a bound by analysis (other traffic, errors, other queues, or overload)"
        )
        yield Finding(
            rule="bus-response",
            severity="note",
            where=f"links.{name}",
            number=law.maximum,
            unit="s",
            reason=f"frame {known['identifier']} on bus {known['bus']}, simulated ahead of the run"
            f" with {_data(known)} data: at most {law.maximum * 1e3:.4g} ms, {said}",
        )


def _data(known: Mapping[str, Any]) -> str:
    """The data of the frames: random also where the run has the values of signals instead."""
    return "zero" if known["data"] == "zeros" else "random"


def _on_buses(system: AnalyzedSystem) -> Iterator[tuple[str, BusDelays]]:
    if not system.scenario.buses:
        return
    from cosim.links.traces import BusDelays

    for link in system.plan.links:
        if isinstance(link.table, DrawnTable) and isinstance(link.table.law, BusDelays):
            yield link.name, link.table.law
