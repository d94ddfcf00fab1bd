"""Impedance felt by a hand: inertia, damping and stiffness that explain torque by motion.

    f = I ddq + D dq + S (q - q_0)

The fit is least squares, for each joint over each window of a run. It finds any relation between
force and motion: if a spring and damper of the operator computed the force from the motion, the fit
finds the operator (D, S < 0, no residual) instead of the robot. :func:`is_operator` detects this.

Source: own construction (linear least squares, :mod:`cosim.measure.least_squares`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from cosim.measure.least_squares import RunningFactor
from cosim.predict.facts import Array

#: A window in which the smallest direction of motion is less than this share of the largest tells
#: nothing: motions do not differ enough.
CONDITION = 1e-4
#: Times (n,), s, and force, response and velocity (n, m) of rows, in pieces.
Moved: TypeAlias = tuple[Array, Array, Array, Array]


@dataclass(frozen=True, slots=True)
class FeltImpedance:
    """Impedance felt at one joint from `start` to `stop`, s; SI; `residual`: share unexplained."""

    joint: int
    start: float
    stop: float
    inertia: float
    damping: float
    stiffness: float
    residual: float


def fit_impedance(
    rows: Iterable[Moved], span: tuple[float, float], window: float
) -> tuple[FeltImpedance, ...]:
    """Fit each joint over windows of `window` s that determine it.

    `span`: the times of the first and the last row, s.
    """
    starts = [span[0] + k * window for k in range(int((span[1] - span[0]) / window + 1e-9))]
    factors: dict[float, RunningFactor] = {}
    for t, *values in _accelerated(rows):
        for start in starts:
            first = int(np.searchsorted(t, start))
            last = int(np.searchsorted(t, start + window, side="right"))
            if first < last:
                x = np.stack([each[first:last] for each in values], axis=2)
                factors.setdefault(start, RunningFactor(*x.shape[1:])).add(x)
    return tuple(
        FeltImpedance(j, start, start + window, *fitted)
        for start, factor in factors.items()
        for j, S in enumerate(factor.centred)
        if (fitted := _fit(S, factor.count)) is not None
    )


def _accelerated(rows: Iterable[Moved]) -> Iterator[tuple[Array, ...]]:
    """Times (n,), s, acceleration, velocity, response and force (n, m) of the same rows.

    The acceleration is the derivative of the velocity as of :func:`numpy.gradient`.
    """
    held: tuple[Array, ...] = ()  # the last two rows
    begin = 0
    for each in rows:
        t, force, response, rate = (
            np.concatenate(pair) for pair in zip(held or [x[:0] for x in each], each, strict=True)
        )
        if len(t) > 1:
            ready, begin = slice(begin, -1), 1
            yield t[ready], _gradient(t, rate)[ready], rate[ready], response[ready], force[ready]
        held = t[-2:], force[-2:], response[-2:], rate[-2:]
    if held:
        t, force, response, rate = held
        yield t[-1:], _gradient(t, rate)[-1:], rate[-1:], response[-1:], force[-1:]


def _gradient(t: Array, x: Array) -> Array:
    """The derivative of `x` (n, m) at times `t` (n,), s, of second order, at the ends of first."""
    found = np.zeros_like(x)
    if len(t) < 2:
        return found
    dt = np.diff(t)[:, None]
    a, b = dt[:-1], dt[1:]
    found[1:-1] = -b / (a * (a + b)) * x[:-2] + (b - a) / (a * b) * x[1:-1]
    found[1:-1] += a / (b * (a + b)) * x[2:]
    found[0], found[-1] = (x[1] - x[0]) / dt[0], (x[-1] - x[-2]) / dt[-1]
    return found


def _fit(S: Array, count: int) -> tuple[float, float, float, float] | None:
    """(I, D, S, residual), or None where the motion does not tell them apart.

    `S` (4, 4): the factor of `count` rows of ddq, dq, q and f, less their means.
    """
    X, f = S[:, :3], S[:, 3]
    scale = np.sqrt((X**2).sum(axis=0) / count)
    size = float(np.sqrt((f**2).sum() / count))
    if count < 12 or not (scale > 0).all() or size <= 1e-12:
        return None
    U, sigma, Vt = np.linalg.svd(X / scale, full_matrices=False)
    if sigma[-1] < CONDITION * sigma[0]:
        return None
    coefficients = (Vt.T @ ((U.T @ f) / sigma)) / scale
    residual = float(np.sqrt(((f - X @ coefficients) ** 2).sum() / count)) / size
    inertia, damping, stiffness = (float(x) for x in coefficients)
    return inertia, damping, stiffness, residual


def is_operator(found: FeltImpedance) -> bool:
    """True if this is the operator's own spring and damper, seen from the robot."""
    return found.damping <= 0 and found.stiffness <= 0 and found.residual < 1e-3
