"""Effort of the operator, and energy through the two ends of a teleoperator.

The passivity observer of a teleoperator with the hand's torque tau_1 on the master and the slave's
torque tau_2 on its environment is the energy that went in and has not come out::

    E(t) = ∫ (tau_1ᵀ dq_1 - tau_2ᵀ dq_2) dt

A passive system between the ends can return at most the energy it stored at the start, so E never
falls below the negative of that energy. A single robot has no second term.

Source: B. Hannaford, J.-H. Ryu, "Time-domain passivity control of haptic interfaces", IEEE Trans.
Robotics and Automation 18(1), 2002 (passivity observer).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from cosim.measure.manipulability import running_integral
from cosim.predict.facts import Array


@dataclass(frozen=True, slots=True)
class Effort:
    """The effort of a force: `norm` = ‖f‖₂, `integral` = ∫|f| dt, `peak` of an entry, `holding`.

    `holding`: mean of |f| over the last `window` s, the torque needed at the end.
    """

    norm: float
    integral: float
    peak: float
    holding: float
    window: float


def effort(t: Array, force: Array, window: float = 1.0) -> Effort:
    """The effort of `force` (n, m) over `t` (n,) s."""
    length = np.sqrt((force**2).sum(axis=1))
    tail = t >= t[-1] - window * (1 + 1e-9)
    return Effort(
        norm=sqrt(running_integral(length**2, t)[-1]),
        integral=float(running_integral(length, t)[-1]),
        peak=float(np.abs(force).max()),
        holding=float(length[tail].mean()),
        window=min(window, float(t[-1] - t[0])),
    )


def observer(t: Array, ends: Sequence[tuple[Array, Array]]) -> Array:
    """E(t), (n,), J: the first of `ends`, (torque, velocity) each (n, m), less the others."""
    return running_integral(net_power(ends), t)


def net_power(ends: Sequence[tuple[Array, Array]]) -> Array:
    """The power into the first of `ends`, as in :func:`observer`, less the others, (n,), W."""
    signs = [1.0, *(-1.0 for _ in ends[1:])]
    power = sum(
        sign * np.einsum("ij,ij->i", torque, rate)
        for sign, (torque, rate) in zip(signs, ends, strict=True)
    )
    return np.asarray(power)
