"""Several springs and dampers that hold one arm, as one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cosim.predict.facts import Hand


def combined_hand(hands: Sequence[Hand], m: int) -> Hand | None:
    """The hand that acts like all `hands` on an arm of `m` joints; None where none pulls.

    Stiffness and damping add up; the place is the mean, weighted by stiffness.
    """
    k, d, x = (
        np.array([np.broadcast_to(getattr(hand, name), (m,)) for hand in hands])
        for name in ("stiffness", "damping", "place")
    )
    stiffness = k.sum(axis=0)
    if not (stiffness > 0).all():
        return None
    place = (k * x).sum(axis=0) / stiffness
    return Hand(
        stiffness=tuple(stiffness.tolist()),
        damping=tuple(d.sum(axis=0).tolist()),
        place=tuple(place.tolist()),
    )
