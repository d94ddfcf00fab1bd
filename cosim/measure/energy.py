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

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import TypeAlias

import numpy as np

from cosim.predict.facts import Array
from cosim.record.piecewise import PairwiseSum, RunningIntegral

#: Times (n,), s, and forces (n, m) of rows, in pieces that can be iterated over more than once.
Forces: TypeAlias = Iterable[tuple[Array, Array]]


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


def effort(force: Forces, span: tuple[float, float], window: float = 1.0) -> Effort:
    """The effort of a force over `span`, the times of the first and the last row, s."""
    since = span[1] - window * (1 + 1e-9)
    squares, lengths, peak = RunningIntegral(), RunningIntegral(), 0.0
    held = PairwiseSum(count := sum(int((t >= since).sum()) for t, _ in force))
    for t, f in force:
        length = np.sqrt((f**2).sum(axis=1))
        squares.add(length**2, t)
        lengths.add(length, t)
        held.add(length[t >= since])
        peak = float(np.abs(f).max(initial=peak))
    return Effort(
        norm=sqrt(squares.value),
        integral=lengths.value,
        peak=peak,
        holding=held.value / count,
        window=min(window, span[1] - span[0]),
    )


def net_power(ends: Sequence[tuple[Array, Array]]) -> Array:
    """The power into the first of `ends`, (torque, velocity) each (n, m), less the others, W.

    Its integral is E(t); (n,).
    """
    signs = [1.0, *(-1.0 for _ in ends[1:])]
    power = sum(
        sign * np.einsum("ij,ij->i", torque, rate)
        for sign, (torque, rate) in zip(signs, ends, strict=True)
    )
    return np.asarray(power)
