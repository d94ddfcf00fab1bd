"""Ages that an adversary chooses so that a motion of the linear loop grows.

It is computed with doubles: a witness, while a certificate is a proof.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cosim.certify.inequalities import Matrix
from cosim.certify.model import CutLoop, LinkBounds
from cosim.linear.adversary import SampleChoices, attacks

Sequences = NDArray[np.int64]
#: Growth that counts, in each of the last parts of a motion.
_GROWS, _PARTS = 1.05, 4
#: Steps of a motion: at least, for each period of the greatest age, and at most.
_STEPS, _EACH, _MOST = 4000, 40, 24_000
#: Factors from inputs to states, up to which an attack takes seconds.
_FACTORS = 60_000
#: Ages to choose from at most, if the order of samples may change.
_AGES = 128


def adversary(loop: CutLoop, steps: int = _STEPS, seed: int = 0) -> Sequences | None:
    """Ages (k, links), samples, k >= `steps`, with which a motion grows; None: none was found.

    None also of a loop that depends on itself at once, of one that is too large, and of ages that
    need a motion too long.
    """
    steps = max(steps, _EACH * max(-(-x.most // x.sends) for x in loop.links))
    if len(loop.A) * loop.B.width > _FACTORS or steps > _MOST:
        return None
    if loop.feeds_through and any(x.least == 0 for x in loop.links):
        return None
    A, B, C, D = (
        np.array(x.floats()).reshape(len(x), x.width) for x in (loop.A, loop.B, loop.C, loop.D)
    )
    start = np.random.default_rng(seed).normal(size=len(A))
    ages = [_ages(x) for x in loop.links]
    for attack in attacks((A, B, C, D), list(_choices(loop, ages)), start, steps, loop.period):
        if _rises(attack.size):
            each = zip(ages, attack.chosen, strict=True)
            return np.stack([known[mine] for known, mine in each], axis=1)
    return None


def _ages(link: LinkBounds) -> Sequences:
    """The ages of a link that are tried."""
    every = np.arange(link.least, link.most + 1)
    if link.ordered or len(every) <= _AGES:
        return every
    return np.unique(np.linspace(link.least, link.most, _AGES).round()).astype(np.int64)


def _choices(loop: CutLoop, ages: Sequence[Sequences]) -> Iterator[SampleChoices]:
    """The samples of some ages of each link."""
    first = sent = 0
    for link, own in zip(loop.links, ages, strict=True):
        numbers = np.arange(link.size)
        before = np.repeat(-(-own // link.sends), link.size).reshape(-1, link.size)
        which = sent + (-own % link.sends * link.size)[:, None] + numbers
        yield SampleChoices(first + numbers, which, before, link.sends if link.ordered else None)
        first += link.size
        sent += link.size * link.sends


def _rises(size: Matrix) -> bool:
    """True if the greatest size of each of the last parts is well above that of the one before."""
    parts = [part.max() for part in np.array_split(size, 2 * _PARTS)[_PARTS - 1 :]]
    return all(b > a + np.log(_GROWS) for a, b in pairwise(parts))
