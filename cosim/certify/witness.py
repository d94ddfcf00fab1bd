"""Ages that an adversary chooses so that a motion of the linear loop grows.

It is computed with doubles: a witness, while a certificate is a proof.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cosim.certify.inequalities import Matrix
from cosim.certify.model import CutLoop
from cosim.linear.adversary import SampleChoices, attacks

Sequences = NDArray[np.int64]
#: Growth that counts, in each of the last parts of a motion.
_GROWS, _PARTS = 1.05, 4


def adversary(loop: CutLoop, steps: int = 4000, seed: int = 0) -> Sequences | None:
    """Ages, (steps, links), in samples, with which a motion grows, or None if none were found.

    None also of a loop that depends on itself at once.
    """
    if loop.feeds_through and any(x.least == 0 for x in loop.links):
        return None
    A, B, C, D = (
        np.array(x.floats()).reshape(len(x), x.width) for x in (loop.A, loop.B, loop.C, loop.D)
    )
    start = np.random.default_rng(seed).normal(size=len(A))
    least = np.array([x.least for x in loop.links])
    for attack in attacks((A, B, C, D), list(_choices(loop)), start, steps, loop.period):
        if _rises(attack.size):
            return np.asarray(np.stack(attack.chosen, axis=1) + least, np.int64)
    return None


def _choices(loop: CutLoop) -> Iterator[SampleChoices]:
    """The samples of all ages of each link."""
    first = sent = 0
    for link in loop.links:
        ages, numbers = np.arange(link.least, link.most + 1), np.arange(link.size)
        before = np.repeat(-(-ages // link.sends), link.size).reshape(-1, link.size)
        which = sent + (-ages % link.sends * link.size)[:, None] + numbers
        yield SampleChoices(first + numbers, which, before, link.sends if link.ordered else None)
        first += link.size
        sent += link.size * link.sends


def _rises(size: Matrix) -> bool:
    """True if the greatest size of each of the last parts is well above that of the one before."""
    parts = [part.max() for part in np.array_split(size, 2 * _PARTS)[_PARTS - 1 :]]
    return all(b > a + np.log(_GROWS) for a, b in pairwise(parts))
