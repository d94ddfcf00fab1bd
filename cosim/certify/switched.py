"""The loop with what is on its way as states: one matrix for each combination of ages.

States are those of the loop and, of each link, the samples sent 1, 2, ... `greatest` before. At
each step the ages select one matrix; a link of ordered samples lets an age grow by at most 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import prod

from cosim.certify.exact import Exact, above, beside
from cosim.certify.model import ClosedParts, LinkBounds, quotient

Ages = tuple[int, ...]


def n_modes(links: Sequence[LinkBounds]) -> int:
    """The number of combinations of ages."""
    return prod(x.most - x.least + 1 for x in links)


def modes(links: Sequence[LinkBounds]) -> list[Ages]:
    """All combinations of ages, samples."""
    return list(product(*(range(x.least, x.most + 1) for x in links)))


def follow(links: Sequence[LinkBounds], before: Ages, after: Ages) -> bool:
    """True if the ages `after` may come one step after `before`."""
    steps = zip(links, before, after, strict=True)
    return all(not link.ordered or b <= a + 1 for link, a, b in steps)


def switched(parts: ClosedParts, ages: Ages) -> Exact:
    """The matrix of one step with these ages, without the neutral directions."""
    n, m, places = len(parts.A), parts.B.width, parts.places()
    late = sum(x.most * x.size for x in parts.links)
    y = beside(parts.C, Exact.zeros(m, late))
    held, moved, rest, first = [], [], [parts.X], n
    for link, place, age in zip(parts.links, places, ages, strict=True):
        sent = [y.take(place)]
        for j in range(link.most):
            start = first + j * link.size
            sent.append(_unit(link.size, start, n + late))
            rest.append(parts.Y.take(place))
        moved += sent[:-1]
        held.append(sent[age])
        first += link.most * link.size
    after = beside(parts.A, Exact.zeros(n, late))
    if held:
        after = after + parts.B @ above(*held)
    full = above(after, *moved)
    return quotient(full, above(*rest), parts.pivots, 0, following=True).lowest()


def _unit(rows: int, first: int, width: int) -> Exact:
    return Exact.eye(width).take(range(first, first + rows))
