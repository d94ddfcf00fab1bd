"""Ages of what links hold: mean, bound and distribution, drawn before a run.

Links of one kind have one distribution, so that it is drawn once, with the seed of one of them:
robots whose links are alike have the same numbers then.
"""

from __future__ import annotations

from collections.abc import Hashable
from math import gcd, inf, isinf, nan

import numpy as np

from cosim.base.convert import Struct
from cosim.base.errors import ScenarioError
from cosim.links.laws import Constant, Law
from cosim.links.semantics import (
    PacketSemantics,
    PlayoutSemantics,
    QueueSemantics,
    SignalSemantics,
)
from cosim.links.table import DrawnTable, TableSpec
from cosim.predict.facts import Array

#: Looks over which the mean age of a link is taken if its law does not give it, and the mean of
#: weights that no switching graph gives.
LOOKS = 8000

#: Values that stand for the distribution of the ages of a link.
QUANTILES = 48


class Age(Struct, frozen=True):
    """Age of the held sample, s: `mean`, and `bound` (inf: unbounded).

    `spread`: differences from the mean, s, equally likely; () if the age is constant or jumps by a
    base step. `least` and `most`: of the ages that were drawn.
    """

    mean: float = 0.0
    bound: float = 0.0
    spread: tuple[float, ...] = ()
    least: float = 0.0
    most: float = 0.0


def kind_of(table: TableSpec) -> Hashable:
    """Equal for links whose ages have the same distribution: one law, one rule, the same periods.

    A stored table is a kind of its own.
    """
    if isinstance(table, DrawnTable):
        return id(table.law), table.rule, table.grid
    return table.name


def age(table: TableSpec) -> Age:
    """Mean age of what a link holds once it holds something, and the bound its law declares."""
    ages = _ages(table)
    drawn = table if isinstance(table, DrawnTable) else None
    declared = drawn.law.mean if drawn and isinstance(drawn.rule, SignalSemantics) else None
    if not len(ages):
        return Age(nan if declared is None else declared, age_bound(table))
    middle = float(ages.mean())
    parts = quantiles(ages - middle, (np.arange(QUANTILES) + 0.5) / QUANTILES)
    spread = tuple((parts - parts.mean()).tolist()) if np.ptp(ages) > table.grid.h else ()
    mean = middle if declared is None else declared
    return Age(mean, age_bound(table), spread, float(ages.min()), float(ages.max()))


def _ages(table: TableSpec) -> Array:
    """The ages of what a link holds at the looks of its receiver, (n,), s, once it has begun."""
    rows = LOOKS
    while rows:
        try:
            table.check(rows)
            break
        except ScenarioError:  # a stored table, or a trace, that is shorter
            rows //= 2
    held = table.stream().rows(rows) if rows else np.empty(0, np.int32)
    begun = held[np.argmax(held >= 0) :] if (held >= 0).any() else held[:0]
    if not len(begun):
        return np.empty(0)
    first = len(held) - len(begun)
    looks = table.grid.n_r * np.arange(first, len(held), dtype=np.int64)
    ages = (looks - table.grid.n_s * begun.astype(np.int64)) * table.grid.h
    return np.asarray(ages[min(len(ages) // 2, table.history * table.grid.n_s // table.grid.n_r) :])


def age_bound(table: TableSpec) -> float:
    """No sample that is held is older, s; inf where nothing may come for any time."""
    grid = table.grid
    slack = (grid.n_s + grid.n_r) * grid.h
    if not isinstance(table, DrawnTable):
        return table.history * grid.n_s * grid.h + slack
    law: Law = table.law
    longest = 0.0
    if law.loses_packets:
        from cosim.links.losses import Lossy

        if isinstance(law, Lossy):
            longest, law = law.loss.longest, law.delay
    oldest = law.maximum
    if isinstance(table.rule, PlayoutSemantics):
        if law.maximum > table.rule.buffer:
            return inf  # what comes later than the buffer is never played
        oldest = table.rule.buffer
    if isinstance(table.rule, PacketSemantics) and table.rule.order == "last-arrival":
        oldest += law.maximum - law.minimum  # a stale sample is held until the next one arrives
    if isinstance(table.rule, QueueSemantics):  # the last one taken is held until the next arrives
        oldest = table.rule.greatest(law, grid) * grid.h + law.maximum - law.minimum
    return inf if law.loses_packets else oldest + longest + slack


def steady_ages(table: DrawnTable) -> Array:
    """The ages at which a queue settles if all delays are the least one, s, at the looks of one
    cycle, (n,) in any order; exact for a constant delay.

    The newest sample that has arrived at look K is d + r old, r = (K - d) mod n_s. From a queue
    that more samples enter than leave, a look takes the last but depth - 1, of age
    d + r + (depth - 1) n_s, if the oldest are dropped. If the newest are dropped, the first sample
    after a look enters, and is taken depth looks later, at the age d + r - n_s + depth n_r. Of a
    queue of which all is taken and the newest are dropped, the last is the one that was sent
    depth - 1 samples after the first since the look before.
    """
    grid, rule = table.grid, table.rule
    assert isinstance(rule, QueueSemantics)
    d, n_s, n_r = grid.ticks(table.law.minimum), grid.n_s, grid.n_r
    r = (n_r * np.arange(n_s // gcd(n_s, n_r), dtype=np.int64) - d) % n_s
    ages = d + r
    if rule.drop == "newest" and rule.take == "all":
        before = (r - n_r) % n_s
        ages = np.maximum(ages, d + before - rule.depth * n_s + n_r)
    elif rule.grows(grid) and rule.drop == "newest":
        ages += rule.depth * n_r - n_s
    elif rule.grows(grid):
        ages += (rule.depth - 1) * n_s
    return np.asarray(ages * grid.h)


def age_range(table: DrawnTable) -> tuple[int, float]:
    """(m, M) in ticks: at tick K a receiver holds a sample no newer than floor((K - m)/n_s) and no
    older than floor((K - M)/n_s); M is inf where there is no such bound.
    """
    grid, law, rule, lost = table.grid, table.law, table.rule, 0.0
    if law.loses_packets:
        from cosim.links.losses import Lossy

        longest = law.loss.longest if isinstance(law, Lossy) else inf
        lost = inf if isinf(longest) else grid.ticks(longest) + grid.n_s
    least, most = rule.least(law, grid), float(grid.ticks(law.maximum))
    if isinstance(rule, SignalSemantics):  # of ceil((K - back)/n_s), for each T
        most = rule.greatest(law, grid) - grid.n_s + 1
        least = rule.greatest(Constant(law.minimum), grid) - grid.n_s + 1
    elif isinstance(rule, PlayoutSemantics):
        most = inf if law.maximum > rule.buffer else grid.ticks(rule.buffer)
    elif isinstance(rule, QueueSemantics):
        bound = age_bound(table)
        most = inf if isinf(bound) else grid.ticks(bound)
    elif isinstance(rule, PacketSemantics) and rule.order == "last-arrival":
        most += grid.ticks(law.maximum) - grid.ticks(law.minimum)
    return least, most + lost


def quantiles(values: Array, shares: Array) -> Array:
    """``np.quantile(values, shares)`` to the bit: of finite `values` (n,), n > 0, at `shares` (m,)
    from 0 to 1, (m,).

    NumPy imports ``numpy.ma`` for it, which takes as long as a whole check of a scenario.
    """
    place = shares * (len(values) - 1)
    ordered, low = np.sort(values), place.astype(np.intp)
    below, above = ordered[low], ordered[np.minimum(low + 1, len(values) - 1)]
    t, step = place - low, above - below
    return np.where(t < 0.5, below + step * t, above - step * (1 - t))
