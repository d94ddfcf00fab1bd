"""Links at their receivers: queues that grow, and values of one sender that are not of one time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations
from math import ceil, isinf

import numpy as np

from cosim.base.names import listed
from cosim.base.random_numbers import generator
from cosim.checks import Finding
from cosim.links.laws import FloatArray, Law
from cosim.links.losses import Lossy
from cosim.links.semantics import QueueSemantics
from cosim.links.table import DrawnTable
from cosim.predict.ages import age_bound, age_range, steady_ages
from cosim.predict.system import AnalyzedSystem
from cosim.schedule.parts import Link

#: Delays drawn to see what a law loses, and if those of two links differ.
_DRAWS = 20_000


def growing_queue(system: AnalyzedSystem) -> Iterator[Finding]:
    """Queues in which samples wait although newer ones are there."""
    length = system.plan.ticks * system.plan.h
    for link in system.plan.links:
        table = link.table
        if not isinstance(table, DrawnTable) or not isinstance(table.rule, QueueSemantics):
            continue
        rule, grid, law = table.rule, table.grid, table.law
        share = _arriving(table)
        steady, rate = steady_ages(table), 1.0 - grid.n_s / (share * grid.n_r)
        fresh = steady_ages(DrawnTable(table.name, grid, law, QueueSemantics(1), table.seed))
        added = float(steady.mean() - fresh.mean())
        if rule.grows(grid, share) and added > 0:
            yield _grows(link, table, share, (rate, added), length)
        elif rule.take == "all" and added > 0:
            yield Finding(
                rule="queue",
                severity="warning",
                where=f"links.{link.name}",
                number=float(steady.mean()),
                unit="s",
                reason=f"more than {rule.depth} samples arrive between two looks, and the newest"
                f" are dropped: the age is {steady.mean():.3g} s on average instead of"
                f" {fresh.mean():.3g} s",
                advice='drop = "oldest", or a greater depth',
            )
        elif rule.take == "one" and rule.depth > 1 and grid.n_r == grid.n_s and share == 1:
            yield from _stays(link, table)


def _arriving(table: DrawnTable) -> float:
    """The share of samples that arrive in the long run."""
    law = table.law
    if not law.loses_packets:
        return 1.0
    if isinstance(law, Lossy):
        return 1.0 - law.loss.share
    return float(np.isfinite(_delays(table)).mean())


def _delays(table: DrawnTable) -> FloatArray:
    """Delays of the first samples, s, as the run draws them."""
    period = table.grid.sending_period
    drawn = table.law.stream(period, generator(table.seed, table.name))
    return drawn.take(min(_DRAWS, table.law.limit(period) or _DRAWS))


def _grows(
    link: Link, table: DrawnTable, share: float, growth: tuple[float, float], length: float
) -> Finding:
    """A receiver that takes fewer samples than arrive; `growth`: (s/s, s in the end)."""
    grid, law, rule = table.grid, table.law, table.rule
    assert isinstance(rule, QueueSemantics)
    depth, (rate, added) = rule.depth, growth
    sent, taken = float(grid.sending_period), float(grid.receiving_period)
    steady = steady_ages(table)
    mean = float(steady.mean()) + law.mean - law.minimum
    if rule.drop == "oldest":
        mean += (depth - 1) * sent * (1 / share - 1)
    full = added / (rate * share)
    exact = law.minimum == law.maximum and share == 1
    about, most = ("", steady.max()) if exact else ("about ", age_bound(table))
    until = f" (at most {most:.4g} s)" if not isinf(most) else ""
    if full < length:
        end = (
            f"until about {full:.3g} s; then its {depth} places are full, samples are dropped, and"
        )
        end += f" the age stays at {about}{mean:.4g} s{until}"
    else:
        fresh = float(steady.mean()) - added + law.mean - law.minimum
        mean = fresh + rate * (length - fresh)
        end = (
            f"to about {mean:.3g} s at the end of the run, when its {depth} places are not yet full"
        )
    arrive = f"{1 / sent:.4g}" if share == 1 else f"{share / sent:.4g} of {1 / sent:.4g}"
    return Finding(
        rule="queue",
        severity="warning",
        where=f"links.{link.name}",
        number=mean,
        unit="s",
        reason=f"{link.target.component} takes {1 / taken:.4g} samples a second from a queue in"
        f" which {arrive} arrive: their age grows by {rate:.3g} s per second {end}",
        advice=f'take = "all", or depth = 1, or a period of {link.target.component} of at most'
        f" {sent / share:.4g} s",
    )


def _stays(link: Link, table: DrawnTable) -> Iterator[Finding]:
    """A receiver that takes as many samples as arrive, so that what one delay adds remains."""
    law, grid = table.law, table.grid
    jitter = grid.ticks(law.maximum) - grid.ticks(law.minimum)
    if jitter < grid.n_s:
        return
    bound = age_bound(table)
    yield Finding(
        rule="queue",
        severity="note",
        where=f"links.{link.name}",
        number=bound,
        unit="s",
        reason=f"{link.target.component} takes as many samples from a queue as arrive: if a delay"
        f" of up to {law.maximum:.3g} s has made samples wait, they wait for the rest of the run"
        f" (age at most {bound:.3g} s)",
        advice='take = "all", or depth = 1',
    )


# ---- values of one time --------------------------------------------------------------------------


def skew(system: AnalyzedSystem) -> Iterator[Finding]:
    """Links of one sender to one receiver whose delays are drawn apart."""
    pairs: dict[tuple[str, str, int], list[Link]] = {}
    for link in system.plan.links:
        table = link.table
        if isinstance(table, DrawnTable) and _varies(table.law):
            ends = link.source.component, link.target.component, id(table.law)
            pairs.setdefault(ends, []).append(link)
    for (sender, receiver, _), links in pairs.items():
        apart = _apart(links)
        if len(apart) < 2:
            continue
        greatest = _greatest_skew(apart)
        h = links[0].table.grid.h
        differ = "without a bound" if isinf(greatest) else f"by up to {greatest * h:.3g} s"
        yield Finding(
            rule="skew",
            severity="warning",
            where=f"{sender}->{receiver}",
            number=greatest * h,
            unit="s",
            reason=f"{listed([x.name for x in links])} have no common channel: what"
            f" {receiver} holds of them was sent at times that differ {differ}",
            advice=f'channel = "{sender}->{receiver}" in each of these links: one packet carries'
            " them all",
        )


def _varies(law: Law) -> bool:
    """True if the delays of a law differ, or some packets are lost, but not on a simulated bus."""
    from cosim.links.traces import BusDelays

    varies = law.minimum < law.maximum or law.loses_packets
    return varies and not isinstance(law, BusDelays)


def _apart(links: Sequence[Link]) -> list[DrawnTable]:
    """A table of each channel of these links whose delays differ from those of the others."""
    tables = {x.table.name: x.table for x in links if isinstance(x.table, DrawnTable)}
    found: list[tuple[DrawnTable, FloatArray]] = []
    for table in tables.values() if len(tables) > 1 else ():
        T = _delays(table)
        if not any(np.array_equal(T, other, equal_nan=True) for _, other in found):
            found.append((table, T))
    return [table for table, _ in found]


def _greatest_skew(tables: Sequence[DrawnTable]) -> float:
    """The greatest difference of the times of two samples that are held at once, ticks."""
    n_s = tables[0].grid.n_s
    ranges = [age_range(table) for table in tables]
    return max(
        n_s * ceil((oldest - newest) / n_s) if not isinf(oldest) else oldest
        for (newest, _), (_, oldest) in permutations(ranges, 2)
    )
