"""Links: what their laws bound, lose and reorder."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf, isinf

import numpy as np

from cosim.checks.couplings import is_constant, longest_delay
from cosim.checks.finding import Finding, Severity
from cosim.links.losses import GilbertElliott, Independent, Lossy, ParetoBursts
from cosim.links.semantics import PacketSemantics, PlayoutSemantics, SignalSemantics
from cosim.links.table import DrawnTable
from cosim.predict.ages import age_bound
from cosim.predict.system import AnalyzedSystem
from cosim.schedule.parts import Link

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
        if last or isinstance(table.rule, SignalSemantics):
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
